"""Replay: (scene or FMU, trajectory) -> Replay, by an independent, fine-step simulation."""

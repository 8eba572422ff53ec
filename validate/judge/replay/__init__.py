"""Replay: (scene or FMU, trajectory) -> Replay, by an independent, fine-step simulation.

    replay(scene, build_fmu(scene), plan)

applies the plan's inputs - nothing else of the plan but its start - to the true continuous contact
dynamics: as reference by the Model Exchange FMU and CVODE, stopped at every gap event and jump of
the inputs, at two tolerances; as everyday run by the Co-Simulation FMU at two internal steps. What
these four say about each other is the replay's own error estimate.
"""

from validate.judge.replay.result import Difference, Event, Replay, ReplayError, ReplayOutcome

__all__ = ["Difference", "Event", "Replay", "ReplayError", "ReplayOutcome"]

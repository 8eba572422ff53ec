"""Replay a plan by an independent, fine-step simulation of a scene or FMU.

    replay(scene, build_fmu(scene), plan)

applies the plan's start and inputs to the true contact dynamics: Model Exchange with CVODE at two
tolerances, and Co-Simulation at two internal steps. Their differences estimate the error.
"""

from validate.judge.replay.result import Difference, Event, Replay, ReplayError, ReplayOutcome

__all__ = ["Difference", "Event", "Replay", "ReplayError", "ReplayOutcome"]

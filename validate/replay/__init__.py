"""Replay: (scene or FMU, trajectory) -> Replay, by an independent, fine-step simulation.

    replay(scene, build_fmu(scene), plan)

applies the plan's inputs - nothing else of the plan but its start - to the true continuous contact dynamics: as reference by the Model
Exchange FMU and CVODE, stopped at every gap event and jump of the inputs, at two tolerances; as everyday run by the Co-Simulation FMU at two
internal steps. What these four say about each other is the replay's own error estimate.
"""

from typing import TYPE_CHECKING

from validate.replay.result import Difference, Event, Replay, ReplayError, ReplayOutcome

if TYPE_CHECKING:
    from validate.replay.run import replay

__all__ = ["Difference", "Event", "Replay", "ReplayError", "ReplayOutcome", "replay"]


def __getattr__(name: str) -> object:
    # FMPy and numpy's friends are imported only by who simulates, not by who looks at results.
    if name == "replay":
        from validate.replay.run import replay

        return replay
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

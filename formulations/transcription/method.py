"""What the direct-transcription methods share: options, refusals, and how a session is opened. Pyomo is imported when one is."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from formulations.method import Method, Options, option

if TYPE_CHECKING:
    from formulations.transcription.session import TranscriptionSession
    from models.scene import Scene


@dataclass(frozen=True, kw_only=True)
class TranscriptionOptions(Options):
    tolerance: float = option(1e-8, "Ipopt's own stopping tolerance (tol)", lower=1e-12, upper=1e-2)
    max_iterations: int = option(3000, "most Ipopt iterations of a stage", lower=1, upper=10**9)
    plan_tolerance: float = option(
        1e-6,
        "solved only if start, goal, time step and bounds are met to this, unscaled and recomputed from the scene [m, rad, N ..]",
        lower=0.0,
        upper=1.0,
    )


# Ipopt's own 0.1 and 0.01 start a complementarity model so close to its bounds (no force, no separation) that it crawls along them: 428
# iterations to the first relaxed plan of the three carts, 78 from a start well inside.
@dataclass(frozen=True, kw_only=True)
class BarrierOptions(TranscriptionOptions):
    barrier_start: float = option(10.0, "Ipopt's mu_init of a start without a plan", lower=1e-9, upper=1e9)
    bound_push: float = option(1.0, "Ipopt's bound_push of a start without a plan", lower=1e-9, upper=1e9)


_Options = TypeVar("_Options", bound=TranscriptionOptions)


class TranscriptionMethod(Method[_Options]):
    """A method that hands a Pyomo model of the whole plan to Ipopt."""

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to plan."
        return None

    @abstractmethod
    def session(self, scene: Scene, options: _Options, opening: tuple[float, float]) -> TranscriptionSession:
        """A session; opening: wall and CPU clock when opening began, before Pyomo was imported."""

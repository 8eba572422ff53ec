"""What the direct-transcription methods share: options, refusals, and how a session is opened. Pyomo is imported when one is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING

from formulations.method import Method, OptionSpec

if TYPE_CHECKING:
    from formulations.transcription.session import TranscriptionSession
    from models.scene import Scene

OPTIONS = (
    OptionSpec(name="tolerance", default=1e-8, description="Ipopt's own stopping tolerance (tol)", lower=1e-12, upper=1e-2),
    OptionSpec(name="max_iterations", default=3000, description="most Ipopt iterations of a stage", lower=1, upper=10**9),
    OptionSpec(
        name="plan_tolerance",
        default=1e-6,
        description="solved only if start, goal, time step and bounds are met to this, unscaled and recomputed from the scene [m, rad, N ..]",
        lower=0.0,
        upper=1.0,
    ),
)

# Ipopt's own 0.1 and 0.01 start a complementarity model so close to its bounds (no force, no separation) that it crawls along them: 428
# iterations to the first relaxed plan of the three carts, 78 from a start well inside.
BARRIER_OPTIONS = (
    OptionSpec(name="barrier_start", default=10.0, description="Ipopt's mu_init of a start without a plan", lower=1e-9, upper=1e9),
    OptionSpec(name="bound_push", default=1.0, description="Ipopt's bound_push of a start without a plan", lower=1e-9, upper=1e9),
)


class TranscriptionMethod(Method):
    """A method that hands a Pyomo model of the whole plan to Ipopt."""

    options = OPTIONS

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to plan."
        return None

    @abstractmethod
    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> TranscriptionSession:
        """A session; options are filled in; opening: wall and CPU clock when opening began, before Pyomo was imported."""

"""Direct transcription with strict complementarity 0 <= lam, lam - k phi, and one of them zero: no relaxation is left in its plan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from formulations.method import Kind, OptionSpec
from formulations.transcription.method import BARRIER_OPTIONS, OPTIONS, TranscriptionMethod

if TYPE_CHECKING:
    from formulations.transcription.session import TranscriptionSession
    from models.scene import Scene


class StrictLCP(TranscriptionMethod):
    name = "strict_lcp"
    title = "Collocation with strict complementarity"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = (
        *OPTIONS,
        *BARRIER_OPTIONS,
        OptionSpec(
            name="attack_bound",
            default=1e-4,
            description="bound of lam (lam - k phi) at which the modes of the contacts are found; the plan itself has none",
            unit="N^2",
            lower=1e-8,
            upper=1.0,
        ),
        OptionSpec(
            name="attack_iterations",
            default=2000,
            description="most Ipopt iterations of the search for modes; where it is cut off, its modes are tried as they are",
            lower=1,
            upper=10**9,
        ),
        OptionSpec(
            name="mode_switches", default=20, description="most rounds of switching contacts to a cheaper mode", lower=0, upper=10**6
        ),
        OptionSpec(
            name="physics_tolerance",
            default=1e-3,
            description="solved only if the sum of abs(lam (lam - k phi)) is at most this",
            unit="N^2",
            lower=0.0,
        ),
        OptionSpec(name="terminal_tolerance", default=1e-8, description="solved only if the plan ends this near to its goal", lower=0.0),
        OptionSpec(
            name="replay_tolerance",
            default=1e-5,
            description="solved only if the plan's inputs end this near to the goal through the same time step with the true contact law",
            lower=0.0,
        ),
    )

    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> TranscriptionSession:
        from formulations.transcription.strict import StrictSession

        return StrictSession(self, scene, options, opening)


METHOD = StrictLCP()

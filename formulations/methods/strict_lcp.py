"""Direct transcription with strict complementarity 0 <= lam, lam - k phi, and one of them zero: no relaxation is left in its plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from formulations.method import Kind, option
from formulations.transcription.method import BarrierOptions, TranscriptionMethod

if TYPE_CHECKING:
    from formulations.transcription.session import TranscriptionSession
    from models.scene import Scene


@dataclass(frozen=True, kw_only=True)
class StrictLCPOptions(BarrierOptions):
    attack_bound: float = option(
        1e-4,
        "bound of lam (lam - k phi) at which the modes of the contacts are found; the plan itself has none",
        unit="N^2",
        lower=1e-8,
        upper=1.0,
    )
    attack_iterations: int = option(
        2000, "most Ipopt iterations of the search for modes; where it is cut off, its modes are tried as they are", lower=1, upper=10**9
    )
    mode_switches: int = option(20, "most rounds of switching contacts to a cheaper mode", lower=0, upper=10**6)
    physics_tolerance: float = option(1e-3, "solved only if the sum of abs(lam (lam - k phi)) is at most this", unit="N^2", lower=0.0)
    terminal_tolerance: float = option(1e-8, "solved only if the plan ends this near to its goal", lower=0.0)
    replay_tolerance: float = option(
        1e-5, "solved only if the plan's inputs end this near to the goal through the same time step with the true contact law", lower=0.0
    )


class StrictLCP(TranscriptionMethod[StrictLCPOptions]):
    name = "strict_lcp"
    title = "Collocation with strict complementarity"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = StrictLCPOptions

    def session(self, scene: Scene, options: StrictLCPOptions, opening: tuple[float, float]) -> TranscriptionSession:
        from formulations.transcription.strict import StrictSession

        return StrictSession(self, scene, options, opening)


METHOD = StrictLCP()

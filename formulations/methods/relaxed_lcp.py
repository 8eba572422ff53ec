"""Direct transcription with relaxed complementarity lam (lam - k phi) <= eps [N^2], Pyomo's own relaxation, tightened by its bound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from formulations.method import Kind, option
from formulations.transcription.method import BarrierOptions, TranscriptionMethod

if TYPE_CHECKING:
    from formulations.transcription.session import TranscriptionSession
    from models.scene import Scene


@dataclass(frozen=True, kw_only=True)
class RelaxedLCPOptions(BarrierOptions):
    duals_from: float = option(
        1e-4,
        "a stage at this eps or below also takes the multipliers of the stage before it; larger eps move the plan too much",
        unit="N^2",
        lower=0.0,
        upper=1.0,
    )


class RelaxedLCP(TranscriptionMethod[RelaxedLCPOptions]):
    name = "relaxed_lcp"
    title = "Collocation with relaxed complementarity"
    kind = Kind.INDIRECT
    needs_eps = True
    options = RelaxedLCPOptions

    def session(self, scene: Scene, options: RelaxedLCPOptions, opening: tuple[float, float]) -> TranscriptionSession:
        from formulations.transcription.relaxed import RelaxedSession

        return RelaxedSession(self, scene, options, opening)


METHOD = RelaxedLCP()

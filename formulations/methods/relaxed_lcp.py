"""Direct transcription with relaxed complementarity lam (lam - k phi) <= eps [N^2], Pyomo's own relaxation, tightened by its bound."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from formulations.method import Kind, OptionSpec
from formulations.transcription.method import BARRIER_OPTIONS, OPTIONS, TranscriptionMethod

if TYPE_CHECKING:
    from formulations.transcription.session import TranscriptionSession
    from models.scene import Scene


class RelaxedLCP(TranscriptionMethod):
    name = "relaxed_lcp"
    title = "Collocation with relaxed complementarity"
    kind = Kind.INDIRECT
    needs_eps = True
    options = (
        *OPTIONS,
        *BARRIER_OPTIONS,
        OptionSpec(
            name="duals_from",
            default=1e-4,
            description="a stage at this eps or below also takes the multipliers of the stage before it; larger eps move the plan too much",
            unit="N^2",
            lower=0.0,
            upper=1.0,
        ),
    )

    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> TranscriptionSession:
        from formulations.transcription.relaxed import RelaxedSession

        return RelaxedSession(self, scene, options, opening)


METHOD = RelaxedLCP()

"""Direct transcription with softplus contact: smooth forces that act at a distance, tightened by their sharpness |ln eps|."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from formulations.method import Kind, OptionSpec
from formulations.transcription.method import OPTIONS, TranscriptionMethod

if TYPE_CHECKING:
    from formulations.transcription.session import TranscriptionSession
    from models.scene import Scene


class SoftplusDC(TranscriptionMethod):
    name = "softplus_dc"
    title = "Collocation with softplus contact"
    kind = Kind.INDIRECT
    needs_eps = True
    options = (
        *OPTIONS,
        OptionSpec(
            name="duals_from",
            default=1e-4,
            description="a stage at this eps or below also takes the multipliers of the stage before it; larger eps move the plan too much",
            lower=0.0,
            upper=1.0,
        ),
    )

    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> TranscriptionSession:
        from formulations.transcription.softplus import SoftplusSession

        return SoftplusSession(self, scene, options, opening)


METHOD = SoftplusDC()

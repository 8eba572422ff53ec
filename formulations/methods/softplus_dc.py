"""Direct transcription with softplus contact: smooth forces that act at a distance, tightened by their sharpness |ln eps|."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from formulations.method import Kind, option
from formulations.transcription.method import TranscriptionMethod, TranscriptionOptions

if TYPE_CHECKING:
    from formulations.transcription.session import TranscriptionSession
    from models.scene import Scene


@dataclass(frozen=True, kw_only=True)
class SoftplusDCOptions(TranscriptionOptions):
    duals_from: float = option(
        1e-4,
        "a stage at this eps or below also takes the multipliers of the stage before it; larger eps move the plan too much",
        lower=0.0,
        upper=1.0,
    )


class SoftplusDC(TranscriptionMethod[SoftplusDCOptions]):
    name = "softplus_dc"
    title = "Collocation with softplus contact"
    kind = Kind.INDIRECT
    needs_eps = True
    options = SoftplusDCOptions

    def session(self, scene: Scene, options: SoftplusDCOptions, opening: tuple[float, float]) -> TranscriptionSession:
        from formulations.transcription.softplus import SoftplusSession

        return SoftplusSession(self, scene, options, opening)


METHOD = SoftplusDC()

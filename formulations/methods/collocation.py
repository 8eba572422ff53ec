"""Exact contact on a coarse grid: collocation of order 2 to 5 instead of semi-implicit Euler, contact modes by a softplus homotopy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from formulations.method import Kind, Method, Session, option
from formulations.transcription.method import TranscriptionOptions

if TYPE_CHECKING:
    from models.scene import Scene


@dataclass(frozen=True, kw_only=True)
class CollocationOptions(TranscriptionOptions):
    scheme: str = option(
        "radau_iia_2",
        "the time step: Radau IIA with two stages (order 3) or three (order 5), or the implicit midpoint (order 2, keeps energy)",
        choices=("radau_iia_2", "radau_iia_3", "implicit_midpoint"),
    )
    integrate_cost: bool = option(
        False, "minimise the scheme's quadrature of the running cost instead of its sum over the starts of the steps, the task's own"
    )
    first_sharpness: float = option(
        7.0, "sharpness of the first softplus stage, |ln eps|: b times the length that the scene counts it in", lower=1e-3, upper=700.0
    )
    last_sharpness: float = option(448.0, "sharpness from which on the modes of the contacts are read off", lower=1e-3, upper=700.0)
    sharpness_growth: float = option(2.0, "factor between two stages", lower=1.01, upper=1e3)
    homotopy_tolerance: float = option(1e-6, "Ipopt's tol in the softplus stages", lower=1e-12, upper=1e-2)


class Collocation(Method[CollocationOptions]):
    name = "collocation"
    title = "Exact contact by collocation of higher order"
    kind = Kind.DIRECT
    needs_eps = False
    options = CollocationOptions

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to plan."
        from formulations.transcription.collocation import why_not

        return why_not(scene)

    def session(self, scene: Scene, options: CollocationOptions, opening: tuple[float, float]) -> Session:
        from formulations.contact_modes.collocation import CollocationSession

        return CollocationSession(self, scene, options, opening)


METHOD = Collocation()

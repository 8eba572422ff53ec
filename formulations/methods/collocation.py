"""Exact contact on a coarse grid: collocation of order 2 to 5 instead of semi-implicit Euler, contact modes by a softplus homotopy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from formulations.method import Kind, Method, OptionSpec, Session
from formulations.transcription.method import OPTIONS
from formulations.windows.homotopy_options import FIRST_SHARPNESS, HOMOTOPY_TOLERANCE, SHARPNESS_GROWTH

if TYPE_CHECKING:
    from models.scene import Scene


class Collocation(Method):
    name = "collocation"
    title = "Exact contact by collocation of higher order"
    kind = Kind.DIRECT
    needs_eps = False
    options = (
        *OPTIONS,
        OptionSpec(
            name="scheme",
            default="radau_iia_2",
            description="the time step: Radau IIA with two stages (order 3) or three (order 5), or the implicit midpoint (order 2, keeps energy)",
            choices=("radau_iia_2", "radau_iia_3", "implicit_midpoint"),
        ),
        OptionSpec(
            name="integrate_cost",
            default=False,
            description="minimise the scheme's quadrature of the running cost instead of its sum over the starts of the steps, the task's own",
            choices=(True, False),
        ),
        FIRST_SHARPNESS,
        OptionSpec(
            name="last_sharpness",
            default=448.0,
            description="sharpness from which on the modes of the contacts are read off",
            lower=1e-3,
            upper=700.0,
        ),
        SHARPNESS_GROWTH,
        HOMOTOPY_TOLERANCE,
    )

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to plan."
        from formulations.transcription.collocation import why_not

        return why_not(scene)

    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> Session:
        from formulations.windows.stage_modes import CollocationSession

        return CollocationSession(self, scene, options, opening)


METHOD = Collocation()

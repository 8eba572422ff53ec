"""Least cost against how far from the goal a plan may end: the exact contact problem within balls around the goal, swept warm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from formulations.method import Kind, Method, OptionSpec, Session

if TYPE_CHECKING:
    from models.scene import Scene


class MpccFront(Method):
    name = "mpcc_front"
    title = "Exact contact, least cost within each terminal tolerance"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = (
        OptionSpec(
            name="tolerances",
            default=(0.0, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2),
            description="largest norms of (q, v)[T] - goal; the plan handed on is that of the smallest",
        ),
        OptionSpec(
            name="work",
            default=6.0,
            description="most work of a solve, as of mpcc; nearly all go on from the plan of the one before, the three that do not may do mpcc's first_work more",
            unit="millions",
            lower=0.0,
        ),
        OptionSpec(name="search", default=True, description="search for cheaper contact windows at each tolerance", choices=(True, False)),
        OptionSpec(name="seed", default=0, description="of random starts, tried where the first guess leads nowhere", lower=0, upper=10**9),
    )

    def accepts(self, scene: Scene) -> str | None:
        from formulations.windows.applies import why_not

        if not scene.task.has_goal:
            return f"scene {scene.name} leaves its end free, so there is no terminal error to trade for cost."
        return why_not(scene)

    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> Session:
        from formulations.windows.front_session import FrontSession

        return FrontSession(self, scene, options, opening)


METHOD = MpccFront()

"""Least cost against how far from the goal a plan may end: the exact contact problem within balls around the goal, swept warm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from formulations.method import Kind, Method, Options, Session, option

if TYPE_CHECKING:
    from models.scene import Scene


@dataclass(frozen=True, kw_only=True)
class MpccFrontOptions(Options):
    tolerances: tuple[float, ...] = option(
        (0.0, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2), "largest norms of (q, v)[T] - goal; the plan handed on is that of the smallest"
    )
    work: float = option(
        6.0,
        "most work of a solve, as of mpcc; nearly all go on from the plan of the one before, the three that do not may do mpcc's first_work more",
        unit="millions",
        lower=0.0,
    )
    search: bool = option(True, "search for cheaper contact windows at each tolerance")
    seed: int = option(0, "of random starts, tried where the first guess leads nowhere", lower=0, upper=10**9)


class MpccFront(Method[MpccFrontOptions]):
    name = "mpcc_front"
    title = "Exact contact, least cost within each terminal tolerance"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = MpccFrontOptions

    def accepts(self, scene: Scene) -> str | None:
        from formulations.contact_modes.applies import why_not

        if not scene.task.has_goal:
            return f"scene {scene.name} leaves its end free, so there is no terminal error to trade for cost."
        return why_not(scene)

    def session(self, scene: Scene, options: MpccFrontOptions, opening: tuple[float, float]) -> Session:
        from formulations.contact_modes.front import FrontSession

        return FrontSession(self, scene, options, opening)


METHOD = MpccFront()

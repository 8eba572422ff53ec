"""What the two multiple shooting methods share: options, refusals, and how a session is opened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from formulations.method import Method, Options, Session, option
from models.contact_law import ContactLaw

if TYPE_CHECKING:
    from models.scene import Scene


@dataclass(frozen=True, kw_only=True)
class MultipleShootingOptions(Options):
    goal_weight: float = option(
        1e4,
        "first weight of half the squared miss of the goal, beside the cost; multipliers take over what it leaves",
        lower=1e-6,
        upper=1e9,
    )
    goal_tolerance: float = option(1e-6, "solved only if the plan ends this near to its goal, in (q, v)", lower=1e-12)
    gap_tolerance: float = option(
        1e-9, "solved only if every step ends this near to the next node; below it the plan is one simulation", lower=1e-14, upper=1e-3
    )
    tolerance: float = option(
        1e-6, "relative decrease of cost and goal term still promised by the subproblem that counts as none", lower=1e-12, upper=1.0
    )
    max_iterations: int = option(300, "most linear-quadratic subproblems", lower=1, upper=10**9)
    guess: str = option(
        "line", "the nodes without a warm start: on the line from start to goal, or all at the start", choices=("line", "start")
    )


class MultipleShootingMethod(Method[MultipleShootingOptions]):
    """Multiple shooting under one contact law."""

    law: ContactLaw
    options = MultipleShootingOptions

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to shoot with."
        return None

    def session(self, scene: Scene, options: MultipleShootingOptions, opening: tuple[float, float]) -> Session:
        from formulations.multiple_shooting.session import MultipleShootingSession

        return MultipleShootingSession(self, scene, options, opening)

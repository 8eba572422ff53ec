"""What the two multiple shooting methods share: options, refusals, and how a session is opened."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from formulations.method import Method, OptionSpec, Session
from models.contact_law import ContactLaw

if TYPE_CHECKING:
    from models.scene import Scene

OPTIONS = (
    OptionSpec(
        name="goal_weight",
        default=1e4,
        description="first weight of half the squared miss of the goal, beside the cost; multipliers take over what it leaves",
        lower=1e-6,
        upper=1e9,
    ),
    OptionSpec(
        name="goal_tolerance", default=1e-6, description="solved only if the plan ends this near to its goal, in (q, v)", lower=1e-12
    ),
    OptionSpec(
        name="gap_tolerance",
        default=1e-9,
        description="solved only if every step ends this near to the next node; below it the plan is one simulation",
        lower=1e-14,
        upper=1e-3,
    ),
    OptionSpec(
        name="tolerance",
        default=1e-6,
        description="relative decrease of cost and goal term still promised by the subproblem that counts as none",
        lower=1e-12,
        upper=1.0,
    ),
    OptionSpec(name="max_iterations", default=300, description="most linear-quadratic subproblems", lower=1, upper=10**9),
    OptionSpec(
        name="guess",
        default="line",
        description="the nodes without a warm start: on the line from start to goal, or all at the start",
        choices=("line", "start"),
    ),
)


class MultipleShootingMethod(Method):
    """Multiple shooting under one contact law."""

    law: ContactLaw
    options = OPTIONS

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to shoot with."
        return None

    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> Session:
        from formulations.multiple_shooting.session import MultipleShootingSession

        return MultipleShootingSession(self, scene, options, opening)

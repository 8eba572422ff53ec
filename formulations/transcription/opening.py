"""A cold start of softplus contact that loses its way, and how it is begun again: with the goal let go first.

The paper's first guess holds the start, and the goal is a constraint far from it. Where bodies can be driven past each other, the first steps do
that, the contact no longer answers to any input, and the multipliers of the goal grow without bound: two fingers that lift a disc had none below
1e10 after 90 iterations, and no plan after 3000. The same model with the goal as a penalty,

    cost + w sum over the state of ((x_T - goal) / nominal)^2,      w the cost of the first guess, at least 1, and heavier as needed

keeps them near the size of the cost, and takes 42 iterations; from its plan the goal itself takes 17. What Ipopt calls infeasible from the first
guess is begun again in the same way: on the cart and pole it ended 0.06 short after 179 iterations, and this way has a plan in 85 more.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyomo.environ as pyo

from formulations.ipopt import Iteration
from formulations.solution import Outcome
from formulations.transcription.build import build_model
from formulations.transcription.contact_laws import ContactLaw
from formulations.transcription.goal import release_goal
from formulations.transcription.plans import read_plan
from formulations.transcription.reach import Patience
from formulations.transcription.workbench import Account, Workbench
from models.scene import Scene
from models.trajectory import Trajectory

# Dual infeasibility past which a cold start is begun again. Of the scenes of the bank, those that were solved within 150 iterations stayed
# below 5e10, those that took hundreds, or had no plan, went to 6e13 and beyond.
_RUNAWAY = 1e12
_ITERATIONS = 300  # of a solve with the goal let go; 29 to 51 were needed
# The penalty grows until the squared miss is below this (in squares of the nominals): there the goal itself is a small step. A cost that is zero at
# the first guess says nothing of how heavy the goal must be.
_NEAR, _HEAVIER, _WEIGHTS = 0.1, 100.0, 3


class Watch(Patience):
    """Ipopt callback: also stops a solve whose multipliers run away. `has_lost_goal`: that is why it was stopped."""

    def __init__(self) -> None:
        super().__init__()
        self.has_lost_goal = False

    def __call__(self, line: Iteration) -> bool:
        self.has_lost_goal = line.inf_du > _RUNAWAY
        return super().__call__(line) and not self.has_lost_goal


def plan_with_goal_released(scene: Scene, eps: float, account: Account, options: Mapping[str, Any]) -> Trajectory | None:
    """The plan of the softplus model at eps with the goal as a penalty; None where that is not solved either."""
    model: Any = build_model(scene, ContactLaw.SOFTPLUS, eps=eps)
    nominal = {coordinate.name: coordinate.nominal for coordinate in scene.coordinates}
    missed = sum(((state - goal) / nominal[name]) ** 2 for state, goal, name in release_goal(model))
    model.parameter_weight = pyo.Param(initialize=max(1.0, abs(pyo.value(model.expression_cost))), mutable=True)
    model.objective_cost.deactivate()
    model.objective_near = pyo.Objective(expr=model.expression_cost + model.parameter_weight * missed)
    bench = Workbench(model)
    for _ in range(_WEIGHTS):
        most = min(options["max_iter"], account.iterations + _ITERATIONS)
        result = bench.run(account, {**options, "max_iter": most})
        if result.outcome is not Outcome.SOLVED:
            return None
        if pyo.value(missed) <= _NEAR or account.is_over:
            break
        model.parameter_weight.value *= _HEAVIER
    return read_plan(model)

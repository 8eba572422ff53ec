"""How near to its goal a scene comes at all, and how a solve that loses its goal is begun again.

`nearest` is asked where Ipopt finds no plan, before the word `infeasible` is used:

    minimise  sum over the state of ((x_T - goal) / nominal)^2   subject to start, time step, contact and input bounds

Every input within its bounds is a feasible point of this problem, so it needs no restoration, on which Ipopt can spend its whole time limit
where complementarity meets a goal out of reach (three carts, inputs bounded by 0.3 N, T = 500: none after 1600 iterations, 0.42 m found here in
280). Contact is softplus, sharpened in steps from a length as wide as the scene to one where the force at a distance no longer matters.
The answer is local, like Ipopt's own; where it says that the goal can be reached, it has a plan to start from.

`plan_with_goal_released` begins a cold start of softplus contact again, with the goal let go first. The paper's first guess holds the start, and the
goal is a constraint far from it. Where bodies can be driven past each other, the first steps do that, the contact no longer answers to any input, and
the multipliers of the goal grow without bound: two fingers that lift a disc had none below 1e10 after 90 iterations, and no plan after 3000. The same
model with the goal as a penalty,

    cost + w sum over the state of ((x_T - goal) / nominal)^2,      w the cost of the first guess, at least 1, and heavier as needed

keeps them near the size of the cost, and takes 42 iterations; from its plan the goal itself takes 17. What Ipopt calls infeasible from the first
guess is begun again in the same way: on the cart and pole it ended 0.06 short after 179 iterations, and this way has a plan in 85 more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyomo.environ as pyo

from formulations.ipopt import Iteration, compile_model, load, solve
from formulations.solution import Outcome
from formulations.transcription.build import build_model, read_plan, release_goal
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.contact import ContactFormulation
from formulations.transcription.method import SolveBudget
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scene.goal import goal_state, miss
from models.trajectory import Trajectory

# Sharpness b of the first solve in units of 1/L (L: the largest gap or penetration at start and goal), the factor between two, and the last:
# there the force at a closed gap is k L / 550, and what is found no longer moves (0.420, 0.421 m in the example above).
_FIRST, _FACTOR, _LAST = 3.0, 2.0, 384.0
# Out of reach is what misses by more than this, in units of the coordinate's nominal: feasible scenes were missed by up to 6e-3 where one of
# the solves below was cut off, by 6e-4 where none was.
_OUT_OF_REACH = 1e-2
_ITERATIONS = 300  # of one solve; 6 to 121 were needed
# Consecutive restoration iterations after which a solve is stopped to ask here. Solves that found a plan spent at most 2.
_MOST_RESTORATIONS = 100
# Dual infeasibility past which a cold start is begun again. Of the scenes of the bank, those that were solved within 150 iterations stayed
# below 5e10, those that took hundreds, or had no plan, went to 6e13 and beyond.
_RUNAWAY = 1e12
_RELEASED_ITERATIONS = 300  # of a solve with the goal let go; 29 to 51 were needed
# The penalty grows until the squared miss is below this (in squares of the nominals): there the goal itself is a small step. A cost that is zero at
# the first guess says nothing of how heavy the goal must be.
_NEAR, _HEAVIER, _WEIGHTS = 0.1, 100.0, 3


class RestorationMonitor:
    """Ipopt callback: stops a solve that stays in restoration. `is_out`: it did."""

    def __init__(self) -> None:
        self.is_out = False
        self._restoring = 0

    def __call__(self, line: Iteration) -> bool:
        """Whether Ipopt shall go on."""
        self._restoring = self._restoring + 1 if line.restoration else 0
        self.is_out = self._restoring >= _MOST_RESTORATIONS
        return not self.is_out


class GoalMonitor(RestorationMonitor):
    """Ipopt callback: also stops a solve whose multipliers run away. `has_lost_goal`: that is why it was stopped."""

    def __init__(self) -> None:
        super().__init__()
        self.has_lost_goal = False

    def __call__(self, line: Iteration) -> bool:
        """Whether Ipopt shall go on."""
        self.has_lost_goal = line.inf_du > _RUNAWAY
        return super().__call__(line) and not self.has_lost_goal


def plan_with_goal_released(scene: Scene, eps: float, budget: SolveBudget, options: Mapping[str, Any]) -> Trajectory | None:
    """The plan of the softplus model at eps with the goal as a penalty; None where that is not solved either."""
    model: Any = build_model(scene, ContactFormulation.SOFTPLUS, eps=eps)
    missed = _let_goal_go(model, scene)
    model.parameter_weight = pyo.Param(initialize=max(1.0, abs(pyo.value(model.expression_cost))), mutable=True)
    model.objective_near = pyo.Objective(expr=model.expression_cost + model.parameter_weight * missed)
    compiled = CompiledModel(model)
    for _ in range(_WEIGHTS):
        most = min(options["max_iter"], budget.iterations + _RELEASED_ITERATIONS)
        result = compiled.run(budget, {**options, "max_iter": most})
        if result.outcome is not Outcome.SOLVED:
            return None
        if pyo.value(missed) <= _NEAR or budget.is_over:
            break
        model.parameter_weight.value *= _HEAVIER
    return read_plan(model)


@dataclass(frozen=True, kw_only=True)
class Nearest:
    """The plan that comes nearest to the goal, and by how much it misses.

    is_solved: the search converged; miss: largest miss in units of the coordinates' nominals; words: the same, of the component that
    misses most.
    """

    plan: Trajectory
    is_solved: bool
    miss: float
    words: str

    @property
    def is_out_of_reach(self) -> bool:
        """Whether the search converged and misses by more than solves that were cut off do."""
        return self.is_solved and self.miss > _OUT_OF_REACH


def nearest(scene: Scene, budget: SolveBudget, max_iterations: int, sharpest: float = math.inf) -> Nearest:
    """The plan that comes nearest to the goal, by softplus contact that is sharpened.

    Parameters
    ----------
    scene : with a goal
    budget : what the search may spend
    max_iterations : of all solves in the budget
    sharpest : b [1/m] of the last solve, where contact is not to be sharper than that
    """
    model: Any = build_model(scene, ContactFormulation.SOFTPLUS, eps=0.5)
    model.objective_miss = pyo.Objective(expr=_let_goal_go(model, scene))  # a free end leaves nothing but the constraints to be met
    problem = compile_model(model)
    is_solved = False
    for b in _sharpnesses(scene, sharpest):
        if scene.nc:
            model.parameter_sharpness.value = b
            problem.refresh()
        most = int(min(_ITERATIONS, max(0, max_iterations - budget.iterations), budget.iterations_left(problem)))
        result = solve(problem, options={"max_iter": most}, time_limit=budget.remaining)
        budget.add(result, problem)
        is_solved = result.outcome is Outcome.SOLVED
        if not np.all(np.isfinite(result.x)):
            break
        load(problem, result)
        if budget.is_over:
            is_solved = False
            break
    return _measured(scene, read_plan(model), is_solved)


def _let_goal_go(model: Any, scene: Scene) -> Any:
    """The squared miss of the goal, which is no constraint any more, in squares of the nominals; the cost is no objective any more."""
    model.objective_cost.deactivate()
    nominal = {coordinate.name: coordinate.nominal for coordinate in scene.coordinates}
    return sum(((state - goal) / nominal[name]) ** 2 for state, goal, name in release_goal(model))


def _sharpnesses(scene: Scene, sharpest: float) -> list[float]:
    if not scene.nc:
        return [1.0]
    start, goal = np.array(scene.task.start[: scene.nq]), goal_state(scene.task)[: scene.nq]
    ends = np.array([start, np.where(np.isnan(goal), start, goal)])
    length = max(float(np.abs(load_kernel(scene).penetration(ends)).max()), max(contact.nominal for contact in scene.contacts))
    last = min(sharpest, _LAST / length)
    values = []
    b = _FIRST / length
    while b < last:
        values.append(b)
        b *= _FACTOR
    return [*values, last]


def _measured(scene: Scene, plan: Trajectory, is_solved: bool) -> Nearest:
    error = np.abs(miss(plan.end, goal_state(scene.task)))
    nominal = np.tile([coordinate.nominal for coordinate in scene.coordinates], 2)
    worst = int((error / nominal).argmax())
    coordinate = scene.coordinates[worst % scene.nq]
    name, unit = (coordinate.name, coordinate.unit) if worst < scene.nq else (coordinate.velocity_name, coordinate.velocity_unit)
    return Nearest(plan=plan, is_solved=is_solved, miss=float(error[worst] / nominal[worst]), words=f"{name} by {error[worst]:.3g} {unit}")

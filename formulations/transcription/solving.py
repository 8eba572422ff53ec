"""The model of one scene and contact law: build, load a start, solve, read and check the plan.

    solver = PlanSolver(scene, ContactFormulation.SOFTPLUS, options, clock)
    budget = solver.begin(1e-3, None, time_limit)  # the model holds the first guess
    result = solver.solve_at(1e-3, None, budget, rules, options, from_plan)
    solution = solver.solution(name, budget, result, residuals_of, plan_limits=.., promises=..)

A solve without progress is stopped and restarted from the plan that ends closest to the goal
(`nearest`). `FixedModes` solves the problem with decided pairs exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pyomo.environ as pyo

from formulations.ipopt import IpoptResult, Iteration
from formulations.method import Clock
from formulations.solution import Outcome, Solution, beyond, checked, ended
from formulations.transcription.build import build_model, keep_within_depth, release_goal
from formulations.transcription.compiled import CompiledModel, size_on_paper
from formulations.transcription.contact import (
    ContactFormulation,
    hold_modes,
    pressed_columns,
    release_modes,
    set_relaxation,
    sides,
)
from formulations.transcription.method import SolveBudget, StageRules, TranscriptionOptions
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scene.goal import goal_state, miss
from models.trajectory import Trajectory

# First sharpness b of `nearest`, in units of 1/L (L: largest gap or penetration at start and goal).
_FIRST = 3.0
# Factor between two sharpnesses.
_FACTOR = 2.0
# Last sharpness: the force at a closed gap is k L / 550, and the result converged (0.420, 0.421 m
# in the example of `nearest`).
_LAST = 384.0
# A larger error (in nominals of the coordinate) is out of reach. Feasible scenes had errors up to
# 6e-3 if a solve was cut off, else 6e-4.
_OUT_OF_REACH = 1e-2
# Iteration limit of one solve of `nearest`; 6 to 121 were needed.
_ITERATIONS = 300
# Consecutive restoration iterations that stop a solve; successful solves used at most 2.
_MOST_RESTORATIONS = 100
# Dual infeasibility that restarts a cold start. Scenes of the bank solved within 150 iterations
# stayed below 5e10; slow or failed ones exceeded 6e13.
_RUNAWAY = 1e12
# Iteration limit with a released goal; 29 to 51 were needed.
_RELEASED_ITERATIONS = 300
# The penalty grows until the squared error (in squared nominals) is below this: the goal is then a
# small step away.
_NEAR_ENOUGH = 0.1
# Factor of the penalty weight; the first guess may have zero cost.
_HEAVIER = 100.0
# Number of weights tried.
_WEIGHTS = 3


class Monitor:
    """Ipopt callback that stops a solve in long restoration (`is_out`) or with runaway multipliers.

    The latter (`has_lost_goal`) only with watches_goal.
    """

    def __init__(self, *, watches_goal: bool = False) -> None:
        self.is_out = self.has_lost_goal = False
        self._watches_goal, self._restoring = watches_goal, 0

    def __call__(self, line: Iteration) -> bool:
        """Return whether Ipopt continues."""
        self._restoring = self._restoring + 1 if line.restoration else 0
        self.is_out = self._restoring >= _MOST_RESTORATIONS
        self.has_lost_goal = self._watches_goal and line.inf_du > _RUNAWAY
        return not (self.is_out or self.has_lost_goal)


def plan_with_goal_released(
    scene: Scene, eps: float, budget: SolveBudget, options: Mapping[str, Any]
) -> Trajectory | None:
    """Return the plan of the softplus model at eps with the goal as a penalty, or None.

        cost + w sum over the state of ((x_T - goal) / nominal)^2,
            w the cost of the first guess, at least 1, and larger if needed

    From the paper's first guess the goal is a distant constraint. The first steps may drive bodies
    past each other. Contact then depends on no input and the multipliers of the goal diverge. Two
    fingers that lift a disc had no plan after 3000 iterations. The penalty takes 42, the goal from
    there 17. The same applies to local infeasibility: the cart and pole ended 0.06 short after 179
    iterations, and has a plan after 85 more.
    """
    model: Any = build_model(scene, ContactFormulation.SOFTPLUS, eps=eps)
    missed = _let_goal_go(model, scene)
    model.parameter_weight = pyo.Param(
        initialize=max(1.0, abs(pyo.value(model.expression_cost))), mutable=True
    )
    model.objective_near = pyo.Objective(
        expr=model.expression_cost + model.parameter_weight * missed
    )
    compiled = CompiledModel(model)
    for _ in range(_WEIGHTS):
        most = min(options["max_iter"], budget.iterations + _RELEASED_ITERATIONS)
        result = compiled.run(budget, {**options, "max_iter": most})
        if result.outcome is not Outcome.SOLVED:
            return None
        if pyo.value(missed) <= _NEAR_ENOUGH or budget.is_over:
            break
        model.parameter_weight.value *= _HEAVIER
    return compiled.read()


@dataclass(frozen=True, kw_only=True)
class Nearest:
    """The plan that ends closest to the goal.

    is_solved: the search converged
    miss: largest error in nominals of the coordinates
    words: the same, of the worst component, as text
    """

    plan: Trajectory
    is_solved: bool
    miss: float
    words: str

    @property
    def is_out_of_reach(self) -> bool:
        """Return whether the search converged with an error above that of interrupted solves."""
        return self.is_solved and self.miss > _OUT_OF_REACH


def no_plan(scene: Scene) -> str:
    """Return the first clause of a message about a missing plan."""
    task = scene.task
    return f"no plan of {task.steps} steps of {task.step:g} s was found that reaches the goal within the bounds"


def out_of_reach(scene: Scene, closest: Nearest) -> str:
    """Return a sentence on how far the closest plan ends from the goal."""
    return f"{no_plan(scene)}: the nearest that was found misses {closest.words}."


def nearest(
    scene: Scene, budget: SolveBudget, max_iterations: int, sharpest: float = math.inf
) -> Nearest:
    """Return the plan that ends closest to the goal, by softplus contact of rising sharpness.

        minimise  sum over the state of ((x_T - goal) / nominal)^2
            subject to start, time step, contact and input bounds

    All inputs within bounds are feasible, so Ipopt needs no restoration. Restoration can take the
    whole time limit if the goal is out of reach. Three carts with inputs bounded by 0.3 N, T = 500
    had no result after 1600 iterations, here 0.42 m in 280. The result is local. max_iterations
    counts all solves in the budget; sharpest is the largest b [1/m].
    """
    model: Any = build_model(scene, ContactFormulation.SOFTPLUS, eps=0.5)
    # A free end leaves only the constraints.
    model.objective_miss = pyo.Objective(expr=_let_goal_go(model, scene))
    compiled, is_solved = CompiledModel(model), False
    for b in _sharpnesses(scene, sharpest):
        if scene.nc:
            model.parameter_sharpness.value = b
        result = compiled.run(
            budget, {"max_iter": min(budget.iterations + _ITERATIONS, max_iterations)}
        )
        is_solved = result.outcome is Outcome.SOLVED and not budget.is_over
        if budget.is_over or not np.all(np.isfinite(result.x)):
            break
    return _measured(scene, compiled.read(), is_solved)


def _let_goal_go(model: Any, scene: Scene) -> Any:
    """Remove the goal's constraints and the cost; return the squared error in squared nominals."""
    model.objective_cost.deactivate()
    nominal = {coordinate.name: coordinate.nominal for coordinate in scene.coordinates}
    return sum(((state - goal) / nominal[name]) ** 2 for state, goal, name in release_goal(model))


def _sharpnesses(scene: Scene, sharpest: float) -> list[float]:
    if not scene.nc:
        return [1.0]
    start, goal = np.array(scene.task.start[: scene.nq]), goal_state(scene.task)[: scene.nq]
    ends = np.array([start, np.where(np.isnan(goal), start, goal)])
    length = max(
        float(np.abs(load_kernel(scene).penetration(ends)).max()),
        max(contact.nominal for contact in scene.contacts),
    )
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
    name, unit = (
        (coordinate.name, coordinate.unit)
        if worst < scene.nq
        else (coordinate.velocity_name, coordinate.velocity_unit)
    )
    return Nearest(
        plan=plan,
        is_solved=is_solved,
        miss=float(error[worst] / nominal[worst]),
        words=f"{name} by {error[worst]:.3g} {unit}",
    )


# Iteration limit with fixed modes: those with a plan are solved in 6 to 20 iterations.
_MODE_ITERATIONS = 100
# The start is close to the plan. Ipopt's default barrier (0.1) would push it away from every bound.
# Two fingers that lift a disc end in restoration; with this barrier they need 23 iterations.
_NEAR = {"mu_init": 1e-4, "bound_push": 1e-6, "bound_frac": 1e-6}
# A pair with both forces [N] below this is undecided; well above Ipopt's 1e-8, far below any force
# that moves a cart.
_UNDECIDED = 1e-5
# Smallest gain per newton for which an undecided pair is switched.
_WANTING = 1e-5


class FixedModes(CompiledModel):
    """The problem of a model with fixed modes; `most_switches` limits the rounds of switching."""

    def __init__(self, model: Any, options: Mapping[str, Any], most_switches: int) -> None:
        super().__init__(model)
        self._options, self._most_switches = {**options, **_NEAR}, most_switches

    def solve(self, budget: SolveBudget, closed: np.ndarray) -> IpoptResult:
        """Solve with these modes, switch pairs whose other mode is cheaper, and solve again.

        closed (steps, nc + 2 nf + springs + switches) [-] is as in `hold_modes`. The last solved
        plan is left in the model. Raises ValueError for modes of another shape.
        """
        hold_modes(self.model, closed)
        best = self._near(budget)
        for _ in range(self._most_switches):
            if best.outcome is not Outcome.SOLVED or budget.is_over:
                return best
            switch = self._cheaper_modes(budget, best, closed)
            if not switch.any():
                return best
            plan, closed = self.read(), closed ^ switch
            hold_modes(self.model, closed)
            switched = self._near(budget)
            if switched.outcome is not Outcome.SOLVED or switched.objective >= best.objective:
                self.load(plan)  # no gain beyond rounding: keep the previous plan
                return best
            best = switched
        return best

    def _near(self, budget: SolveBudget) -> IpoptResult:
        most = min(self._options["max_iter"], budget.iterations + _MODE_ITERATIONS)
        return self.run(budget, {**self._options, "max_iter": most})

    def _cheaper_modes(
        self, budget: SolveBudget, result: IpoptResult, closed: np.ndarray
    ) -> np.ndarray:
        """Return undecided pairs (steps, nc + 2 nf) whose fixed force has a negative multiplier."""
        both = self.ends(
            budget, result, [variable for couple in sides(self.model) for variable in couple]
        )
        (lam, separation), (of_lam, of_separation) = (numbers.reshape(-1, 2).T for numbers in both)
        held = np.where(closed.ravel(), of_separation, of_lam)
        switch = ((np.maximum(lam, separation) < _UNDECIDED) & (held < -_WANTING)).reshape(
            closed.shape
        )
        for contact, forward in pressed_columns(
            self.model
        ):  # friction without pressure has no mode
            switch[:, forward : forward + 2] &= closed[:, contact : contact + 1]
        return switch


IpoptOptions = Mapping[str, Any]


@dataclass(frozen=True)
class SolvedModel:
    """A solved stage: eps, plan, and Ipopt's result."""

    eps: float
    plan: Trajectory
    result: IpoptResult


class PlanSolver(CompiledModel):
    """The model of a scene under one contact law, and its solves.

    last: the last stage, None if it was not solved
    clock: of the opening
    depth_share: penetrations stay below this share of the depths; None: they are not bounded
    """

    def __init__(
        self,
        scene: Scene,
        contact: ContactFormulation,
        options: TranscriptionOptions,
        clock: Clock,
        depth_share: float | None = None,
    ) -> None:
        super().__init__(None)
        self._depth_share = depth_share
        self._scene, self._contact, self._options = scene, contact, options
        self.residuals = PlanResiduals(scene)
        self.last: SolvedModel | None = None
        self._nearest: dict[float, Nearest] = {}
        self._begun = 0  # iterations of the budget before this solve
        self._clock = clock

    def begin(self, eps: float, start: Trajectory | None, time_limit: float) -> SolveBudget:
        """Begin a stage: load the start and return the budget."""
        budget, self._begun = SolveBudget(time_limit, self._clock.pay()), 0
        with budget.building():
            self.prepare(eps, start)
        return budget

    def prepare(self, eps: float, start: Trajectory | None) -> None:
        """Build the model at first use, at this eps, and load the start.

        Raises TrajectoryError for a plan of another grid.
        """
        if self.model is None:
            self.model = build_model(self._scene, self._contact, eps=eps)
            if self._depth_share is not None:
                keep_within_depth(self.model, self._scene, self._depth_share)
        self.load(start)

    def set_relaxation(self, eps: float) -> None:
        """Set the sharpness of softplus contact, or the bound of complementarity."""
        set_relaxation(self.model, eps)

    def release_modes(self) -> None:
        """Free the pairs again."""
        release_modes(self.model)

    def with_fixed_modes(self, most_switches: int) -> FixedModes:
        """Return the model with fixed modes, compiled separately."""
        return FixedModes(self.model, self._options.ipopt(), most_switches)

    @property
    def is_softplus(self) -> bool:
        """Return whether forces act at a distance."""
        return self._contact is ContactFormulation.SOFTPLUS

    @property
    def unknowns(self) -> int:
        """Return the number of unknowns, counted by hand."""
        return size_on_paper(self._scene, self._contact).unknowns

    def solve_at(
        self,
        eps: float,
        start: Trajectory | None,
        budget: SolveBudget,
        rules: StageRules,
        options: IpoptOptions,
        from_plan: IpoptOptions,
    ) -> IpoptResult:
        """Solve the loaded model at this eps, with the previous multipliers if the rules allow.

        options, from_plan: Ipopt's for this start, and for a plan
        """
        self._begun = budget.iterations
        if self._scene.nl:
            self.set_relaxation(eps)
        previous = self.solved_before(start) if start is not None and rules.takes_duals else None
        before = None if previous is None else previous.result
        releases = (
            start is None and self.is_softplus and self._scene.nc > 0 and self._scene.task.has_goal
        )
        release_at = eps if releases else None
        result = self.attempt(
            budget,
            options,
            from_plan=from_plan,
            sharpest=rules.sharpest,
            after=before,
            release_at=release_at,
        )
        if result.outcome is not Outcome.SOLVED and before is not None and not budget.is_over:
            self.load(start)  # multipliers of another eps can mislead: retry with the plan only
            result = self.attempt(budget, options, from_plan=from_plan, sharpest=rules.sharpest)
        self.last = (
            SolvedModel(eps, self.read(), result) if result.outcome is Outcome.SOLVED else None
        )
        return result

    def solved_before(self, plan: Trajectory) -> SolvedModel | None:
        """Return the last solved stage if this is its plan."""
        solved = self.last
        if solved is None:
            return None
        same = all(
            np.array_equal(getattr(solved.plan, name), getattr(plan, name))
            for name in ("q", "v", "u", "lam")
        )
        return solved if same else None

    def attempt(
        self,
        budget: SolveBudget,
        options: IpoptOptions,
        *,
        from_plan: IpoptOptions,
        sharpest: float = np.inf,
        after: IpoptResult | None = None,
        release_at: float | None = None,
    ) -> IpoptResult:
        """Solve the stage.

        Without progress restart from a plan that reaches the goal, if there is one.

        from_plan: Ipopt's options for a start from a plan
        sharpest: as in `StageRules`
        release_at: eps of softplus contact at which the goal may be released, or None
        """
        monitor = Monitor(watches_goal=release_at is not None)
        result = self.run(budget, options, after, callback=monitor)
        is_lost = release_at is not None and (
            monitor.has_lost_goal or result.outcome is Outcome.INFEASIBLE
        )
        if release_at is not None and is_lost and not budget.is_over:
            plan = plan_with_goal_released(self._scene, release_at, budget, options)
            if plan is not None:
                self.load(plan)
                monitor = Monitor()
                result = self.run(budget, options, callback=monitor)
                is_lost = False
        if budget.is_over or not (
            is_lost or monitor.is_out or result.outcome is Outcome.INFEASIBLE
        ):
            return result
        closest = self._nearest_plan(budget, sharpest)
        if closest.is_out_of_reach:
            return replace(
                result, outcome=Outcome.INFEASIBLE, message=out_of_reach(self._scene, closest)
            )
        if closest.is_solved:
            self.load(closest.plan)
            options = {**options, **from_plan}
        elif is_lost:
            self.load(None)
        elif not monitor.is_out:
            shortfall = f"Ipopt ended where the constraints cannot be met any better, {result.residuals.constraint_violation:.3g} short"
            return replace(result, message=f"{no_plan(self._scene)}: {shortfall}.")
        restarted = self.run(budget, options)
        if restarted.outcome is Outcome.INFEASIBLE and closest.is_solved:
            message = f"{restarted.message}. The goal can be reached nearly (with softened contact: {closest.words}), but no plan was found from there."
            return replace(restarted, outcome=Outcome.STALLED, message=message)
        return restarted

    def _nearest_plan(self, budget: SolveBudget, sharpest: float) -> Nearest:
        closest = self._nearest.get(sharpest)
        if closest is None or not closest.is_solved:
            closest = self._nearest[sharpest] = nearest(
                self._scene, budget, self._begun + self._options.max_iterations, sharpest
            )
        return closest

    def solution(
        self,
        method: str,
        budget: SolveBudget,
        result: IpoptResult,
        residuals_of: Callable[[Trajectory], dict[str, float]],
        *,
        plan_limits: Mapping[str, float],
        promises: Mapping[str, float],
    ) -> Solution:
        """Return the checked plan of the model.

        Residuals above `promises`: not SOLVED; above `plan_limits`: no plan.
        """
        outcome, message = result.outcome, ended(result.message)
        plan, residuals, cost = None, {}, None
        if outcome.has_answer:
            plan = self.read()
            residuals, cost = residuals_of(plan), self.residuals.cost(plan)
            if outcome is not Outcome.SOLVED and beyond(plan_limits, residuals):
                plan, cost = None, None
                message = f"{message} The last iterate does not meet its own equations: it is not a plan, and cannot start one."
            outcome, message = checked(outcome, message, residuals, promises)
            residuals["dual_infeasibility"] = result.residuals.dual_infeasibility
        solution = Solution(
            method=method,
            outcome=outcome,
            message=message,
            trajectory=plan,
            cost=cost,
            residuals=residuals,
            options=asdict(self._options),
            size=self.size,
            paper_size=size_on_paper(self._scene, self._contact),
        )
        return budget.spent_on(solution)

"""The model of one scene under one contact law: built once, loaded with a start, solved, its plan read and checked.

    solver = PlanSolver(scene, ContactFormulation.SOFTPLUS, options, clock)
    budget = solver.begin(1e-3, None, time_limit)  # the model holds the first guess
    result = solver.solve_at(1e-3, None, budget, rules, options, from_plan)
    solution = solver.solution(name, budget, result, residuals_of, plan_limits=.., promises=..)

A solve that leads nowhere is stopped, and what comes nearest to the goal is asked for (`nearest`)
before it is tried once more.

With its contact modes fixed (`FixedModes`) every pair is decided, and what is left is solved
exactly: closed means lam = k phi, open lam = 0. Pairs at lam = 0 = lam - k phi whose multiplier
says that the other mode is cheaper are switched, and the problem is solved again.

How near to its goal a scene comes at all, and how a solve that loses its goal is begun again.

`nearest` is asked where Ipopt finds no plan, before the word `infeasible` is used:

    minimise  sum over the state of ((x_T - goal) / nominal)^2
        subject to start, time step, contact and input bounds

Every input within its bounds is a feasible point of this problem, so it needs no restoration, on
which Ipopt can spend its whole time limit where complementarity meets a goal out of reach (three
carts, inputs bounded by 0.3 N, T = 500: none after 1600 iterations, 0.42 m found here in 280).
Contact is softplus, sharpened in steps from a length as wide as the scene to one where the force at
a distance no longer matters. The answer is local, like Ipopt's own; where it says that the goal can
be reached, it has a plan to start from.

`plan_with_goal_released` begins a cold start of softplus contact again, with the goal let go first.
The paper's first guess holds the start, and the goal is a constraint far from it. Where bodies can
be driven past each other, the first steps do that, the contact no longer answers to any input, and
the multipliers of the goal grow without bound: two fingers that lift a disc had none below 1e10
after 90 iterations, and no plan after 3000. The same model with the goal as a penalty,

    cost + w sum over the state of ((x_T - goal) / nominal)^2,
        w the cost of the first guess, at least 1, and heavier as needed

keeps them near the size of the cost, and takes 42 iterations; from its plan the goal itself takes
17. What Ipopt calls infeasible from the first guess is begun again in the same way: on the cart and
pole it ended 0.06 short after 179 iterations, and this way has a plan in 85 more.
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
from formulations.transcription.build import build_model, release_goal
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

# Sharpness b of the first solve in units of 1/L (L: the largest gap or penetration at start and
# goal), the factor between two, and the last: there the force at a closed gap is k L / 550, and
# what is found no longer moves (0.420, 0.421 m in the example above).
_FIRST = 3.0
_FACTOR = 2.0
_LAST = 384.0
# Out of reach is what misses by more than this, in units of the coordinate's nominal: feasible
# scenes were missed by up to 6e-3 where one of the solves below was cut off, by 6e-4 where none
# was.
_OUT_OF_REACH = 1e-2
_ITERATIONS = 300  # of one solve; 6 to 121 were needed
# Consecutive restoration iterations after which a solve is stopped to ask here. Solves that found a
# plan spent at most 2.
_MOST_RESTORATIONS = 100
# Dual infeasibility past which a cold start is begun again. Of the scenes of the bank, those that
# were solved within 150 iterations stayed below 5e10, those that took hundreds, or had no plan,
# went to 6e13 and beyond.
_RUNAWAY = 1e12
_RELEASED_ITERATIONS = 300  # of a solve with the goal let go; 29 to 51 were needed
# The penalty grows until the squared miss is below this (in squares of the nominals): there the
# goal itself is a small step. A cost that is zero at the first guess says nothing of how heavy the
# goal must be.
_NEAR_ENOUGH = 0.1
_HEAVIER = 100.0
_WEIGHTS = 3


class Monitor:
    """Ipopt callback: stops a solve that stays in restoration (`is_out`), or, where its goal is watched, one whose multipliers run away (`has_lost_goal`)."""

    def __init__(self, *, watches_goal: bool = False) -> None:
        self.is_out = self.has_lost_goal = False
        self._watches_goal, self._restoring = watches_goal, 0

    def __call__(self, line: Iteration) -> bool:
        """Whether Ipopt shall go on."""
        self._restoring = self._restoring + 1 if line.restoration else 0
        self.is_out = self._restoring >= _MOST_RESTORATIONS
        self.has_lost_goal = self._watches_goal and line.inf_du > _RUNAWAY
        return not (self.is_out or self.has_lost_goal)


def plan_with_goal_released(
    scene: Scene, eps: float, budget: SolveBudget, options: Mapping[str, Any]
) -> Trajectory | None:
    """The plan of the softplus model at eps with the goal as a penalty.

    None where that is not solved either.
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
    """The plan that comes nearest to the goal, and by how much it misses.

    is_solved: the search converged; miss: largest miss in units of the coordinates' nominals;
        words: the same, of the component that
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


def no_plan(scene: Scene) -> str:
    """What is said of a scene before why: no plan was found."""
    task = scene.task
    return f"no plan of {task.steps} steps of {task.step:g} s was found that reaches the goal within the bounds"


def out_of_reach(scene: Scene, found: Nearest) -> str:
    """The same, and by how much the nearest plan misses the goal."""
    return f"{no_plan(scene)}: the nearest that was found misses {found.words}."


def nearest(
    scene: Scene, budget: SolveBudget, max_iterations: int, sharpest: float = math.inf
) -> Nearest:
    """The plan that comes nearest to the goal, by softplus contact that is sharpened.

    Parameters
    ----------
    scene : with a goal
    budget : what the search may spend
    max_iterations : of all solves in the budget
    sharpest : b [1/m] of the last solve, where contact is not to be sharper than that
    """
    model: Any = build_model(scene, ContactFormulation.SOFTPLUS, eps=0.5)
    model.objective_miss = pyo.Objective(
        expr=_let_goal_go(model, scene)
    )  # a free end leaves nothing but the constraints to be met
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
    """The squared miss of the goal, which is no constraint any more, in squares of the nominals.

    The cost is no objective any more.
    """
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


# Modes that have a plan are solved in 6 to 20 iterations; more are spent only on proving that there
# is none.
_MODE_ITERATIONS = 100
# They start from a plan that is nearly theirs: Ipopt's own barrier (0.1) first pushes it away from
# every bound, so far that two fingers that lift a disc end in restoration; with this one they need
# 23 iterations.
_NEAR = {"mu_init": 1e-4, "bound_push": 1e-6, "bound_frac": 1e-6}
# A pair counts as undecided where both forces are below this [N], and as wanting the other mode
# where that would lower the cost by more than this a newton: both well above Ipopt's 1e-8 and far
# below any force that moves a cart.
_UNDECIDED = 1e-5
_WANTING = 1e-5


class FixedModes(CompiledModel):
    """The problem without complementarity of a built model, translated at its first use. options: Ipopt's; most_switches: rounds of switching."""

    def __init__(self, model: Any, options: Mapping[str, Any], most_switches: int) -> None:
        super().__init__(model)
        self._options, self._most_switches = {**options, **_NEAR}, most_switches

    def solve(self, budget: SolveBudget, closed: np.ndarray) -> IpoptResult:
        """The last solved problem, its plan left in the model.

        Parameters
        ----------
        budget : what the stage may spend
        closed : (steps, nc + 2 nf + springs + switches) as in `hold_modes` [-]

        Raises
        ------
        ValueError
            For modes of another shape.
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
            again = self._near(budget)
            if again.outcome is not Outcome.SOLVED or again.objective >= best.objective:
                self.load(plan)  # no gain beyond rounding: keep what was there
                return best
            best = again
        return best

    def _near(self, budget: SolveBudget) -> IpoptResult:
        most = min(self._options["max_iter"], budget.iterations + _MODE_ITERATIONS)
        return self.run(budget, {**self._options, "max_iter": most})

    def _cheaper_modes(
        self, budget: SolveBudget, result: IpoptResult, closed: np.ndarray
    ) -> np.ndarray:
        """Pairs (steps, nc + 2 nf) at lam = 0 = v that would lower the cost in the other mode: the force held at zero there has a negative multiplier."""
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
        ):  # a friction that nothing presses has no mode to switch
            switch[:, forward : forward + 2] &= closed[:, contact : contact + 1]
        return switch


IpoptOptions = Mapping[str, Any]


@dataclass(frozen=True)
class SolvedModel:
    """A stage that was solved: at which eps, its plan, and what Ipopt knew of it."""

    eps: float
    plan: Trajectory
    result: IpoptResult


class PlanSolver(CompiledModel):
    """See the module docstring. last: the stage solved last, None where the last stage was not solved; clock: of the opening."""

    def __init__(
        self, scene: Scene, contact: ContactFormulation, options: TranscriptionOptions, clock: Clock
    ) -> None:
        super().__init__(None)
        self._scene, self._contact, self._options = scene, contact, options
        self.residuals = PlanResiduals(scene)
        self.last: SolvedModel | None = None
        self._nearest: dict[float, Nearest] = {}
        self._begun = 0  # iterations of the budget before this solve
        self._clock = clock

    # -- the model and what it holds
    #   ----------------------------------------------------------------------------------------------

    def begin(self, eps: float, start: Trajectory | None, time_limit: float) -> SolveBudget:
        """A stage begins: its budget, and the model with its start."""
        budget, self._begun = SolveBudget(time_limit, self._clock.pay()), 0
        with budget.building():
            self.prepare(eps, start)
        return budget

    def prepare(self, eps: float, start: Trajectory | None) -> None:
        """Build the model at its first use, at this eps, and load the start.

        Raises
        ------
        TrajectoryError
            for a plan of another grid
        """
        if self.model is None:
            self.model = build_model(self._scene, self._contact, eps=eps)
        self.load(start)

    def set_relaxation(self, eps: float) -> None:
        """Move the relaxation: the sharpness of softplus contact, the bound of complementarity."""
        set_relaxation(self.model, eps)

    def release_modes(self) -> None:
        """Complementarity is a choice again."""
        release_modes(self.model)

    def with_fixed_modes(self, most_switches: int) -> FixedModes:
        """The model without complementarity, of a translation of its own."""
        return FixedModes(self.model, self._options.ipopt(), most_switches)

    @property
    def is_softplus(self) -> bool:
        """Whether forces act at a distance."""
        return self._contact is ContactFormulation.SOFTPLUS

    @property
    def unknowns(self) -> int:
        """Of the model, counted by hand."""
        return size_on_paper(self._scene, self._contact).unknowns

    # -- solving
    #   ------------------------------------------------------------------------------------------------------------------

    def solve_at(
        self,
        eps: float,
        start: Trajectory | None,
        budget: SolveBudget,
        rules: StageRules,
        options: IpoptOptions,
        from_plan: IpoptOptions,
    ) -> IpoptResult:
        """Solve at this eps the model, which holds the start already.

        With the multipliers of the stage before where the rules say so.

        options, from_plan: Ipopt's for this start, and for a plan.
        """
        self._begun = budget.iterations
        if self._scene.nl:
            self.set_relaxation(eps)
        known = self.solved_before(start) if start is not None and rules.takes_duals else None
        before = None if known is None else known.result
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
            self.load(start)  # multipliers of another eps can mislead: the plan alone, then
            result = self.attempt(budget, options, from_plan=from_plan, sharpest=rules.sharpest)
        self.last = (
            SolvedModel(eps, self.read(), result) if result.outcome is Outcome.SOLVED else None
        )
        return result

    def solved_before(self, plan: Trajectory) -> SolvedModel | None:
        """The stage solved last, if this is its plan."""
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

        If the solve makes no progress, find out whether the goal can be reached at all, and go on from a
        plan that reaches it.

        from_plan: Ipopt's options where it goes on from a plan; sharpest: as in `StageRules`;
        release_at: eps of softplus contact at which the goal may be let go, None where it may not.
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
        found = self._nearest_plan(budget, sharpest)
        if found.is_out_of_reach:
            return replace(
                result, outcome=Outcome.INFEASIBLE, message=out_of_reach(self._scene, found)
            )
        if found.is_solved:
            self.load(found.plan)
            options = {**options, **from_plan}
        elif is_lost:
            self.load(None)
        elif not monitor.is_out:
            shortfall = f"Ipopt ended where the constraints cannot be met any better, {result.residuals.constraint_violation:.3g} short"
            return replace(result, message=f"{no_plan(self._scene)}: {shortfall}.")
        again = self.run(budget, options)
        if again.outcome is Outcome.INFEASIBLE and found.is_solved:
            message = f"{again.message}. The goal can be reached nearly (with softened contact: {found.words}), but no plan was found from there."
            return replace(again, outcome=Outcome.STALLED, message=message)
        return again

    def _nearest_plan(self, budget: SolveBudget, sharpest: float) -> Nearest:
        """Searched once for each sharpness; searched again if it was cut off."""
        found = self._nearest.get(sharpest)
        if found is None or not found.is_solved:
            found = self._nearest[sharpest] = nearest(
                self._scene, budget, self._begun + self._options.max_iterations, sharpest
            )
        return found

    # -- what is handed back
    #   ------------------------------------------------------------------------------------------------------

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
        """The plan that the model holds, checked: with residuals beyond `promises` it is not SOLVED, beyond `plan_limits` it is no plan."""
        outcome, message = result.outcome, ended(result.message)
        plan, residuals, cost = None, {}, None
        if outcome.has_answer:
            plan = self.read()
            residuals, cost = residuals_of(plan), self.residuals.cost(plan)
            if outcome is not Outcome.SOLVED and beyond(plan_limits, residuals):
                plan, cost = None, None
                message = f"{message} The last iterate does not meet its own equations: it is no plan, and starts none."
            outcome, message = checked(outcome, message, residuals, promises)
            residuals["dual_infeasibility"] = result.residuals.dual_infeasibility
        found = Solution(
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
        return budget.spent_on(found)

"""A transcription method opened on a scene: the model is built once, its relaxation moved by a mutable Param, Ipopt started warm.

A cold start of softplus contact that loses its way, and how it is begun again: with the goal let go first.

The paper's first guess holds the start, and the goal is a constraint far from it. Where bodies can be driven past each other, the first steps do
that, the contact no longer answers to any input, and the multipliers of the goal grow without bound: two fingers that lift a disc had none below
1e10 after 90 iterations, and no plan after 3000. The same model with the goal as a penalty,

    cost + w sum over the state of ((x_T - goal) / nominal)^2,      w the cost of the first guess, at least 1, and heavier as needed

keeps them near the size of the cost, and takes 42 iterations; from its plan the goal itself takes 17. What Ipopt calls infeasible from the first
guess is begun again in the same way: on the cart and pole it ended 0.06 short after 179 iterations, and this way has a plan in 85 more.

What the methods share that are solved for ever smaller eps: a stage gets a bounded amount of work, what it leaves is handed on only if it is a
plan, and where contact is softer and there was no plan, none is looked for.

A stage that leads from a plan of this session to none is solved half way before, at the geometric mean of the two eps. Iterations of softplus contact
from 1e-3 to 1e-5, directly and by 1e-4: transport 983 without a plan and 190 with one, hopper_planar 292 without and 166 with one.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from time import perf_counter, process_time
from typing import Any, cast

import numpy as np
import pyomo.environ as pyo

from formulations.ipopt import IpoptResult, Iteration, Start
from formulations.method import Method, OptionError, Session
from formulations.solution import Outcome, Solution
from formulations.transcription.build import build_model
from formulations.transcription.contact import ContactLaw, tighten
from formulations.transcription.feasibility import Nearest, Patience, nearest
from formulations.transcription.method import BarrierOptions, TranscriptionOptions
from formulations.transcription.residuals import PlanResiduals
from formulations.transcription.workbench import (
    Account,
    Workbench,
    load_first_guess,
    load_plan,
    primal_dual,
    read_plan,
    release_goal,
    size_on_paper,
)
from models.errors import TrajectoryError
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


@dataclass(frozen=True)
class Solved:
    """A stage that was solved: at which eps, its plan, and what Ipopt knew of it."""

    eps: float | None
    plan: Trajectory
    result: IpoptResult


@dataclass(frozen=True, kw_only=True)
class Ending:
    """How a stage ended, before its plan was checked."""

    outcome: Outcome
    message: str
    dual_infeasibility: float


class TranscriptionSession(Session):
    """See the module docstring. A subclass says which contact law, which Ipopt options, and what it promises of a plan."""

    contact: ContactLaw

    def __init__(self, method: Method, scene: Scene, options: TranscriptionOptions, opening: tuple[float, float]) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._residuals = PlanResiduals(scene)
        self._bench: Workbench | None = None
        self._last: Solved | None = None
        self._nearest: dict[float, Nearest] = {}
        self._opening = (perf_counter() - opening[0], process_time() - opening[1])

    # -- what a subclass decides ------------------------------------------------------------------------------------------------

    def first_eps(self, eps: float | None) -> float:
        """The relaxation the model is built with."""
        return cast(float, eps)

    def common_options(self) -> dict[str, Any]:
        """Ipopt options of every run."""
        return {"tol": self._options.tolerance, "max_iter": self._options.max_iterations}

    def cold_options(self) -> dict[str, Any]:
        """Ipopt options of a start without a plan."""
        return {}

    def is_plan(self, residuals: Mapping[str, float], eps: float | None) -> bool:
        """Whether a last iterate that was not solved is worth handing on."""
        return True

    def watch(self, warm_start: Trajectory | None) -> Patience:
        """What stops the first solve of a stage before its limits do."""
        return Patience()

    def takes_duals(self, eps: float | None) -> bool:
        """Whether a stage at eps that follows another of this session starts with its multipliers too."""
        return False

    def sharpest(self, eps: float | None) -> float:
        """Sharpness b of softplus contact that goes as far from the true law as the method's own contact at eps does."""
        return math.inf

    def certificate(self, plan: Trajectory, eps: float | None) -> dict[str, float]:
        """Residuals of the plan by name."""
        return self._residuals.of(plan)

    def promises(self, eps: float | None) -> dict[str, float]:
        """Largest residuals with which the outcome may be SOLVED."""
        limit = self._options.plan_tolerance
        return dict.fromkeys(("dynamics_defect", "start_error", "terminal_error", "input_bound_excess", "velocity_bound_excess"), limit)

    # -- one stage --------------------------------------------------------------------------------------------------------------

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        self._method.check_eps(eps)
        if not time_limit > 0.0:
            raise OptionError(f"method {self._method.name}: the time limit is {time_limit!r}, but must be a positive number of seconds.")
        account, self._opening = Account(time_limit, self._opening), (0.0, 0.0)
        begin = perf_counter()
        bench = self.bench(eps)
        if warm_start is not None:
            load_plan(bench.model, warm_start)
            warm_start = self.start_used(warm_start)
        if warm_start is None:
            load_first_guess(bench.model)
        account.build += perf_counter() - begin
        ending = self.run(bench, account, eps, warm_start)
        return self._solution(bench, account, eps, ending)

    def bench(self, eps: float | None) -> Workbench:
        """The model, built at its first use."""
        if self._bench is None:
            self._bench = Workbench(build_model(self._scene, self.contact, eps=self.first_eps(eps)))
        return self._bench

    def run(self, bench: Workbench, account: Account, eps: float | None, warm_start: Trajectory | None) -> Ending:
        """Solve the model, which holds the warm start or the first guess already."""
        if self._scene.nl:
            tighten(bench.model, cast(float, eps))
        start = self._start_with_duals(eps, warm_start)
        result = self.attempt(bench, account, eps, self.ipopt_options(warm_start), start, watch=self.watch(warm_start))
        if result.outcome is not Outcome.SOLVED and start is not None and not account.is_over:
            load_plan(bench.model, cast(Trajectory, warm_start))  # multipliers of another eps can mislead: the plan alone, then
            result = self.attempt(bench, account, eps, self.ipopt_options(warm_start))
        self._last = None
        if result.outcome is Outcome.SOLVED:
            self._last = Solved(eps, read_plan(bench.model), result)
        return self.ending(result)

    def attempt(
        self,
        bench: Workbench,
        account: Account,
        eps: float | None,
        options: dict[str, Any],
        start: Start | None = None,
        *,
        share: float = 1.0,
        watch: Patience | None = None,
    ) -> IpoptResult:
        """Solve; where that leads nowhere, find out whether the goal can be reached at all, and go on from a plan that reaches it."""
        patience = watch or Patience()
        result = bench.run(account, options, start, share=share, callback=patience)
        is_lost = isinstance(patience, Watch) and (patience.has_lost_goal or result.outcome is Outcome.INFEASIBLE)
        if is_lost and not account.is_over:
            plan = plan_with_goal_released(self._scene, cast(float, eps), account, options)
            if plan is not None:
                load_plan(bench.model, plan)
                patience = Patience()
                result = bench.run(account, options, share=share, callback=patience)
                is_lost = False
        if account.is_over or not (is_lost or patience.is_out or result.outcome is Outcome.INFEASIBLE):
            return result
        found = self._nearest_plan(account, self.sharpest(eps))
        if found.is_out_of_reach:
            message = f"{self._no_plan()}: the nearest that was found misses {found.words}."
            return replace(result, outcome=Outcome.INFEASIBLE, message=message)
        if found.is_solved:
            load_plan(bench.model, found.plan)
            options = {**options, **self.ipopt_options(found.plan)}
        elif is_lost:
            load_first_guess(bench.model)
        elif not patience.is_out:
            shortfall = f"Ipopt ended where the constraints cannot be met any better, {result.residuals.constraint_violation:.3g} short"
            return replace(result, message=f"{self._no_plan()}: {shortfall}.")
        again = bench.run(account, options, share=share)
        if again.outcome is Outcome.INFEASIBLE and found.is_solved:
            message = (
                f"{again.message}. The goal can be reached nearly (with softened contact: {found.words}), but no plan was found from there."
            )
            return replace(again, outcome=Outcome.STALLED, message=message)
        return again

    def _nearest_plan(self, account: Account, sharpest: float) -> Nearest:
        """Searched once for each sharpness; searched again if it was cut off."""
        found = self._nearest.get(sharpest)
        if found is None or not found.is_solved:
            found = self._nearest[sharpest] = nearest(self._scene, account, self._options.max_iterations, sharpest)
        return found

    def _no_plan(self) -> str:
        task = self._scene.task
        return f"no plan of {task.steps} steps of {task.step:g} s was found that reaches the goal within the bounds"

    def ending(self, result: IpoptResult) -> Ending:
        message = (
            result.message if not result.message or result.message.endswith(".") else f"{result.message}."
        )  # more may be said after it
        return Ending(outcome=result.outcome, message=message, dual_infeasibility=result.residuals.dual_infeasibility)

    def ipopt_options(self, warm_start: Trajectory | None) -> dict[str, Any]:
        return {**self.common_options(), **({} if warm_start is not None else self.cold_options())}

    def _start_with_duals(self, eps: float | None, warm_start: Trajectory | None) -> Start | None:
        if warm_start is None or not self.takes_duals(eps):
            return None
        solved = self._solved_before(warm_start)
        return None if solved is None else primal_dual(solved.result)

    def _solved_before(self, plan: Trajectory) -> Solved | None:
        """The last solved stage of this session, if this is its plan."""
        solved = self._last
        if solved is None:
            return None
        same = all(np.array_equal(getattr(solved.plan, name), getattr(plan, name)) for name in ("q", "v", "u", "lam"))
        return solved if same else None

    def _solution(self, bench: Workbench, account: Account, eps: float | None, ending: Ending) -> Solution:
        outcome, message = ending.outcome, ending.message
        plan, residuals, cost = None, {}, None
        if outcome.has_answer:
            try:
                plan = read_plan(bench.model)
            except TrajectoryError:  # a value that is not finite: no plan
                outcome, message = Outcome.EVALUATION_ERROR, f"the last iterate holds values that are not finite numbers ({message})"
        if plan is not None:
            residuals = self.certificate(plan, eps)
            cost = self._residuals.cost(plan)
            if outcome is not Outcome.SOLVED and not self.is_plan(residuals, eps):
                plan, cost = None, None
                message = f"{message} The last iterate does not meet its own equations: it is no plan, and starts none."
            missed = {name: limit for name, limit in self.promises(eps).items() if not residuals.get(name, 0.0) <= limit}
            if outcome is Outcome.SOLVED and missed:
                worst = ", ".join(f"{name} is {residuals[name]:.3g} (limit {limit:g})" for name, limit in missed.items())
                outcome, message = Outcome.STALLED, f"{message} Checked on the plan itself, {worst}."
            if np.isfinite(ending.dual_infeasibility):
                residuals["dual_infeasibility"] = ending.dual_infeasibility
        return Solution(
            method=self._method.name,
            outcome=outcome,
            message=message,
            trajectory=plan,
            cost=cost,
            iterations=account.iterations,
            seconds=account.seconds(),
            residuals={name: value for name, value in residuals.items() if np.isfinite(value)},
            options=asdict(self._options),
            solver=account.solver,
            history={name: tuple(values) for name, values in account.history.items()},
            size=bench.size,
            paper_size=size_on_paper(self._scene, self.contact),
        )


def cold_barrier(options: BarrierOptions) -> dict[str, Any]:
    """Ipopt options of a complementarity model without a plan to start from."""
    return {"mu_init": options.barrier_start, "bound_push": options.bound_push, "bound_frac": min(0.5, options.bound_push)}


@dataclass(frozen=True)
class Work:
    """Most iterations of a solve, times the size of its model, and the fewest iterations it may have however large the model."""

    most: float
    fewest: int

    def iterations(self, size: int) -> int:
        return max(self.fewest, int(self.most / size))


@dataclass(frozen=True)
class _Failure:
    """A stage that gave no plan, and what it had started from."""

    eps: float
    start: Trajectory | None
    outcome: Outcome


class TightenedSession(TranscriptionSession):
    """See the module docstring."""

    _failure: _Failure | None = None
    _size, _spent = 0, 0

    def size(self, bench: Workbench, account: Account) -> int:
        """Of the model, as `work` counts it: unknowns by hand."""
        return size_on_paper(self._scene, self.contact).unknowns

    @abstractmethod
    def work(self, warm_start: Trajectory | None) -> Work | None:
        """None: as many iterations as the method's option says."""

    @abstractmethod
    def is_vain(self, failed: Outcome, start: Trajectory | None) -> Outcome | None:
        """How a stage ends, untried, whose start led to `failed` at a larger eps; None: it is tried all the same."""

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        failure = self._failure
        if failure is not None and warm_start is failure.start and cast(float, eps) < failure.eps:
            self._method.check_eps(eps)
            outcome = self.is_vain(failure.outcome, warm_start)
            if outcome is not None:
                message = f"Not tried: from this start there was no plan at eps = {failure.eps:g} either, where contact is softer."
                return Solution(method=self._method.name, outcome=outcome, message=message, options=asdict(self._options))
        found = super().solve(eps=eps, warm_start=warm_start, time_limit=time_limit)
        if found.trajectory is None and found.outcome is not Outcome.TIME_LIMIT:
            self._failure = _Failure(cast(float, eps), warm_start, found.outcome)
        return found

    def run(self, bench: Workbench, account: Account, eps: float | None, warm_start: Trajectory | None) -> Ending:
        known = None if warm_start is None else self._solved_before(warm_start)
        accounts: list[Account] = []
        ending = self._apart(bench, account, eps, warm_start, accounts)
        may_go_on = not account.is_over and self._spent < self._options.max_iterations
        if known is not None and may_go_on and ending.outcome is not Outcome.SOLVED and self._left(bench, eps) is None:
            between = math.sqrt(cast(float, known.eps) * cast(float, eps))
            load_plan(bench.model, known.plan)
            if self._apart(bench, account, between, known.plan, accounts).outcome is Outcome.SOLVED:
                ending = self._apart(bench, account, eps, read_plan(bench.model), accounts)
                ending = replace(ending, message=f"{ending.message} It went by eps = {between:g}: directly there was no plan.".lstrip())
        for own in reversed(accounts):
            account.include(own)
        self._spent = 0
        return ending

    def _apart(self, bench: Workbench, account: Account, eps: float | None, plan: Trajectory | None, accounts: list[Account]) -> Ending:
        """A solve with an account of its own, because iterations are limited for each."""
        self._size = self.size(bench, account)
        own = Account(account.remaining)
        accounts.append(own)
        ending = super().run(bench, own, eps, plan)
        self._spent += own.iterations
        return ending

    def _left(self, bench: Workbench, eps: float | None) -> Trajectory | None:
        """What a solve at eps left in the model, if that is a plan."""
        try:
            plan = read_plan(bench.model)
        except TrajectoryError:
            return None
        return plan if self.is_plan(self.certificate(plan, eps), eps) else None

    def common_options(self) -> dict[str, Any]:
        options = super().common_options()
        return {**options, "max_iter": max(0, options["max_iter"] - self._spent)}

    def ipopt_options(self, warm_start: Trajectory | None) -> dict[str, Any]:
        options, work = super().ipopt_options(warm_start), self.work(warm_start)
        if work is None:
            return options
        return {**options, "max_iter": min(options["max_iter"], work.iterations(self._size))}

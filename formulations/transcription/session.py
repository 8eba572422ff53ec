"""A transcription method opened on a scene: the model is built once, its relaxation moved by a mutable Param, Ipopt started warm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from time import perf_counter, process_time
from typing import Any, cast

import numpy as np

from formulations.ipopt import IpoptResult, Start
from formulations.method import Method, OptionError, Session
from formulations.solution import Outcome, Solution
from formulations.transcription.build import build_model
from formulations.transcription.contact_laws import ContactLaw, tighten
from formulations.transcription.method import BarrierOptions, TranscriptionOptions
from formulations.transcription.opening import Watch, plan_with_goal_released
from formulations.transcription.plans import load_first_guess, load_plan, read_plan
from formulations.transcription.reach import Nearest, Patience, nearest
from formulations.transcription.residuals import PlanResiduals
from formulations.transcription.size import size_on_paper
from formulations.transcription.workbench import Account, Workbench, primal_dual
from models.errors import TrajectoryError
from models.scene import Scene
from models.trajectory import Trajectory


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

"""Exact contact on a coarse grid: collocation of order 2 to 5 instead of semi-implicit Euler, contact modes by a softplus homotopy.

    softplus homotopy -> which contact is closed at which stage -> lam = k phi or lam = 0 there, solved

Modes are read off the last stages of the homotopy, the sharpest first; where none has a plan, from a relaxed complementarity that starts at the
sharpest (`contact_modes.collocation`).

Contacts open and close within steps, not at nodes. What that costs is bounded: residual `switch_error` (models.collocation).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from time import perf_counter, process_time
from typing import TYPE_CHECKING

import numpy as np

from formulations.method import Kind, Method, Session, option, without_inputs
from formulations.solution import ModelSize, Outcome, Solution
from formulations.transcription.account import SolveBudget
from formulations.transcription.method import TranscriptionOptions, why_not_collocated
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import load_kernel
from models.collocation import switch_error
from models.errors import TrajectoryError
from models.scene import Scene
from models.schemes import Scheme, tableau
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.contact_modes.collocation import StageModes
    from formulations.transcription.workbench import Workbench

# Stages of the homotopy whose modes are tried.
_TRIED = 3


@dataclass(frozen=True, kw_only=True)
class CollocationOptions(TranscriptionOptions):
    scheme: str = option(
        "radau_iia_2",
        "the time step: Radau IIA with two stages (order 3) or three (order 5), or the implicit midpoint (order 2, keeps energy)",
        choices=("radau_iia_2", "radau_iia_3", "implicit_midpoint"),
    )
    integrate_cost: bool = option(
        False, "minimise the scheme's quadrature of the running cost instead of its sum over the starts of the steps, the task's own"
    )
    first_sharpness: float = option(
        7.0, "sharpness of the first softplus stage, |ln eps|: b times the length that the scene counts it in", lower=1e-3, upper=700.0
    )
    last_sharpness: float = option(448.0, "sharpness from which on the modes of the contacts are read off", lower=1e-3, upper=700.0)
    sharpness_growth: float = option(2.0, "factor between two stages", lower=1.01, upper=1e3)
    homotopy_tolerance: float = option(1e-6, "Ipopt's tol in the softplus stages", lower=1e-12, upper=1e-2)


class CollocationSession(Session):
    """The models are built at the first solve, and serve those after it."""

    def __init__(self, method: Collocation, scene: Scene, options: CollocationOptions, opening: tuple[float, float]) -> None:
        from formulations.contact_modes import collocation  # imports Pyomo and Ipopt: 1 s that planning a campaign does without

        self._method, self._scene, self._options = method, scene, options
        self._kernel, self._residuals = load_kernel(scene), PlanResiduals(scene)
        self._problem = collocation.StageProblem(
            scene,
            Scheme(options.scheme),
            (options.first_sharpness, options.last_sharpness, options.sharpness_growth),
            integrate_cost=options.integrate_cost,
            tolerance=options.tolerance,
            homotopy_tolerance=options.homotopy_tolerance,
            most_iterations=options.max_iterations,
        )
        self._opening = (perf_counter() - opening[0], process_time() - opening[1])

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        self._method.check_stage(eps, time_limit)
        account, self._opening = SolveBudget(time_limit, self._opening), (0.0, 0.0)
        begin, problem = perf_counter(), self._problem
        problem.prepare(warm_start)
        account.build += perf_counter() - begin
        guesses, outcome, message = self._softened(account, warm_start)
        if not self._scene.nc:
            return self._solution(account, problem.homotopy.bench, outcome, message)
        if not guesses:
            return self._solution(account, None, outcome, message)
        for guess in guesses:
            result = problem.with_modes(account, guess)
            if result.outcome is Outcome.SOLVED or account.is_over:
                break
        else:
            result = problem.from_relaxed(account, guesses[0])
        if result.outcome is Outcome.SOLVED:
            message = f"Modes of the stages were read off, the rest solved by Ipopt: {result.message}"
            return self._solution(account, problem.exact(account), Outcome.SOLVED, message)
        if account.is_over:
            return self._solution(account, None, Outcome.TIME_LIMIT, "no modes of the stages with a plan were found in the time given.")
        message = "no modes of the stages that were tried have a plan; a finer grid, or another start, may."
        return self._solution(account, None, Outcome.STALLED, message)

    def _softened(self, account: SolveBudget, start: Trajectory | None) -> tuple[list[StageModes], Outcome, str]:
        """The last stages of the homotopy, the sharpest first; where its first stage has no plan, from the plan that comes nearest to the goal."""
        guesses: list[StageModes] = []
        outcome, message = self._problem.soften(account, start, guesses.append)
        if not guesses and outcome is not Outcome.SOLVED and not account.is_over:
            found = self._problem.nearest(account, self._options.first_sharpness / self._scene.length)
            if found.is_out_of_reach:
                task = self._scene.task
                words = f"no plan of {task.steps} steps of {task.step:g} s was found that reaches the goal within the bounds: the nearest misses {found.words}."
                return [], Outcome.INFEASIBLE, words
            if found.is_solved:
                outcome, message = self._problem.soften(account, found.plan, guesses.append)
        return guesses[: -_TRIED - 1 : -1], outcome, message

    def _solution(self, account: SolveBudget, bench: Workbench | None, outcome: Outcome, message: str) -> Solution:
        plan, cost, residuals = None, None, {}
        if bench is not None and outcome.has_answer:
            try:
                plan = bench.read()
            except TrajectoryError:  # a value that is not finite: no plan
                outcome = Outcome.EVALUATION_ERROR
        if plan is not None:
            cost = self._residuals.cost(plan)
            residuals = {**self._residuals.of(plan), "switch_error": switch_error(self._kernel, plan)}
            promises = self._options.promises()
            missed = {name: residuals[name] for name, limit in promises.items() if not residuals.get(name, 0.0) <= limit}
            if missed and outcome is Outcome.SOLVED:
                worst = ", ".join(f"{name} is {value:.3g}" for name, value in missed.items())
                outcome, message = (
                    Outcome.STALLED,
                    f"{message} Checked on the plan itself, {worst} (limit {self._options.plan_tolerance:g}).",
                )
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
            size=None if bench is None else bench.size,
            paper_size=None if bench is None else self._paper_size(),
        )

    def _paper_size(self) -> ModelSize:
        """Unknowns and equations of the model with its modes by hand: nodes, inputs, stages that are no node, forces and separation forces; ends,
        stages, nodes that are no stage, separation forces."""
        scene, table = self._scene, tableau(Scheme(self._options.scheme))
        steps, given = scene.task.steps, sum(value is not None for value in scene.task.goal)
        own, ends = (table.stages - 1, 0) if table.is_stiffly_accurate else (table.stages, 1)
        return ModelSize(
            unknowns=2 * scene.nq * (steps + 1) + (scene.nu + 2 * scene.nq * own + 2 * scene.nc * table.stages) * steps,
            equations=2 * scene.nq + given + (2 * scene.nq * (table.stages + ends) + scene.nc * table.stages) * steps,
        )


class Collocation(Method[CollocationOptions]):
    name = "collocation"
    title = "Exact contact by collocation of higher order"
    kind = Kind.DIRECT
    needs_eps = False
    options = CollocationOptions

    def accepts(self, scene: Scene) -> str | None:
        return without_inputs(scene, "plan") or why_not_collocated(scene)

    def session(self, scene: Scene, options: CollocationOptions, opening: tuple[float, float]) -> Session:
        return CollocationSession(self, scene, options, opening)


METHOD = Collocation()

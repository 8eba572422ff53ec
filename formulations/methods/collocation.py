"""Exact contact on a coarse grid: collocation of order 2 to 5 instead of semi-implicit Euler, contact modes by a softplus homotopy.

    softplus homotopy -> which contact is closed at which stage -> lam = k phi or lam = 0 there, solved

Modes are read off the last stages of the homotopy, the sharpest first; where none has a plan, from a relaxed complementarity that starts at the
sharpest (`contact_modes.collocation`).

Contacts open and close within steps, not at nodes. What that costs is bounded: residual `switch_error` (models.collocation).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from formulations.method import Clock, Kind, Method, Session, option, without_inputs
from formulations.solution import ModelSize, Outcome, Solution, checked
from formulations.transcription.method import SolveBudget, TranscriptionOptions, why_not_collocated
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import load_kernel
from models.collocation import switch_error
from models.errors import TrajectoryError
from models.scene import Scene
from models.schemes import Scheme, tableau
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.contact_modes.collocation import StageModes
    from formulations.transcription.compiled import CompiledModel

# Stages of the homotopy whose modes are tried.
_TRIED = 3


@dataclass(frozen=True, kw_only=True)
class CollocationOptions(TranscriptionOptions):
    """Options of `collocation`."""

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

    def __init__(self, method: Collocation, scene: Scene, options: CollocationOptions, clock: Clock) -> None:
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
        self._clock = clock
        clock.stop()

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        """Find a plan of collocated steps; the models are built at the first solve. Raises TrajectoryError for a plan of another grid."""
        self._method.check_stage(eps, time_limit)
        budget = SolveBudget(time_limit, self._clock.pay())
        begin, problem = perf_counter(), self._problem
        problem.prepare(warm_start)
        budget.build += perf_counter() - begin
        guesses, outcome, message = self._softened(budget, warm_start)
        if not self._scene.nc:
            return self._solution(budget, problem.homotopy.compiled, outcome, message)
        if not guesses:
            return self._solution(budget, None, outcome, message)
        for guess in guesses:
            result = problem.with_modes(budget, guess)
            if result.outcome is Outcome.SOLVED or budget.is_over:
                break
        else:
            result = problem.from_relaxed(budget, guesses[0])
        if result.outcome is Outcome.SOLVED:
            message = f"Modes of the stages were read off, the rest solved by Ipopt: {result.message}"
            return self._solution(budget, problem.exact(budget), Outcome.SOLVED, message)
        if budget.is_over:
            return self._solution(budget, None, Outcome.TIME_LIMIT, "no feasible modes of the stages were found within the time limit.")
        message = "no modes of the stages that were tried have a plan; a finer grid, or another start, may."
        return self._solution(budget, None, Outcome.STALLED, message)

    def _softened(self, budget: SolveBudget, start: Trajectory | None) -> tuple[list[StageModes], Outcome, str]:
        """The last stages of the homotopy, the sharpest first; where its first stage has no plan, from the plan that comes nearest to the goal."""
        guesses: list[StageModes] = []
        outcome, message = self._problem.soften(budget, start, guesses.append)
        if not guesses and outcome is not Outcome.SOLVED and not budget.is_over:
            found = self._problem.nearest(budget, self._options.first_sharpness / self._scene.length)
            if found.is_out_of_reach:
                task = self._scene.task
                words = f"no plan of {task.steps} steps of {task.step:g} s was found that reaches the goal within the bounds: the nearest misses {found.words}."
                return [], Outcome.INFEASIBLE, words
            if found.is_solved:
                outcome, message = self._problem.soften(budget, found.plan, guesses.append)
        return guesses[: -_TRIED - 1 : -1], outcome, message

    def _solution(self, budget: SolveBudget, compiled: CompiledModel | None, outcome: Outcome, message: str) -> Solution:
        plan, cost, residuals = None, None, {}
        if compiled is not None and outcome.has_answer:
            try:
                plan = compiled.read()
            except TrajectoryError:  # a value that is not finite: no plan
                outcome = Outcome.EVALUATION_ERROR
        if plan is not None:
            cost = self._residuals.cost(plan)
            residuals = {**self._residuals.of(plan), "switch_error": switch_error(self._kernel, plan)}
            outcome, message = checked(outcome, message, residuals, self._options.promises())
        return Solution(
            method=self._method.name,
            outcome=outcome,
            message=message,
            trajectory=plan,
            cost=cost,
            iterations=budget.iterations,
            seconds=budget.seconds(),
            residuals={name: value for name, value in residuals.items() if np.isfinite(value)},
            options=asdict(self._options),
            solver=budget.solver,
            history={name: tuple(values) for name, values in budget.history.items()},
            size=None if compiled is None else compiled.size,
            paper_size=None if compiled is None else self._paper_size(),
        )

    def _paper_size(self) -> ModelSize:
        """Unknowns and equations of the model with its modes, counted by hand.

        Nodes, inputs, stages that are no node, forces and separation forces; ends, stages, nodes that are no stage, separation forces.
        """
        scene, table = self._scene, tableau(Scheme(self._options.scheme))
        steps, given = scene.task.steps, sum(value is not None for value in scene.task.goal)
        own, ends = (table.stages - 1, 0) if table.is_stiffly_accurate else (table.stages, 1)
        return ModelSize(
            unknowns=2 * scene.nq * (steps + 1) + (scene.nu + 2 * scene.nq * own + 2 * scene.nc * table.stages) * steps,
            equations=2 * scene.nq + given + (2 * scene.nq * (table.stages + ends) + scene.nc * table.stages) * steps,
        )


class Collocation(Method[CollocationOptions]):
    """Exact contact at the stages of steps of order 2 to 5."""

    name = "collocation"
    title = "Exact contact by collocation of higher order"
    kind = Kind.DIRECT
    needs_eps = False
    options = CollocationOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes without inputs, with friction or with damped contacts."""
        return without_inputs(scene, "plan") or why_not_collocated(scene)

    def session(self, scene: Scene, options: CollocationOptions, clock: Clock) -> Session:
        """Open a session, whose models are built at its first solve."""
        return CollocationSession(self, scene, options, clock)


METHOD = Collocation()

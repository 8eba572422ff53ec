"""`collocation` opened on a scene: softplus homotopy on the stages of the scheme, modes of the stages read off, what is left solved exactly.

    softplus homotopy -> which contact is closed at which stage -> lam = k phi or lam = 0 there, solved

With the modes fixed no complementarity is left, for a linear scene a convex QP, and the true contact law holds at every stage. Modes are read
off the last stages of the homotopy, the sharpest first; where none has a plan, from a relaxed complementarity that starts at the sharpest.

Contacts open and close within steps, not at nodes. What that costs is bounded: residual `switch_error` (models.collocation).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from formulations.contact_modes.nonlinear import PATIENCE, SoftplusHomotopy, schedule
from formulations.ipopt import IpoptResult
from formulations.ipopt.linear_solver import band_options
from formulations.method import Method, OptionError, Session
from formulations.solution import ModelSize, Outcome, Solution
from formulations.transcription.build import build_model
from formulations.transcription.collocation import settle_forces, stage_penetration
from formulations.transcription.contact import ContactLaw, hold_modes, release_modes, tighten
from formulations.transcription.feasibility import nearest
from formulations.transcription.residuals import PlanResiduals
from formulations.transcription.workbench import Account, Workbench, load_plan, read_plan, read_values, write_values
from models.codegen.kernel import load_kernel
from models.collocation import switch_error
from models.errors import TrajectoryError
from models.scene import Scene
from models.schemes import Scheme, tableau
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.methods.collocation import CollocationOptions

# Stages of the homotopy whose modes are tried.
_TRIED = 3
# Modes that have a plan are solved in 5 to 60 iterations; more are spent only on proving that there is none.
_MODE_ITERATIONS = 150
# They start from a plan that is nearly theirs: Ipopt's own barrier (0.1) first pushes it away from every bound.
_NEAR = {"mu_init": 1e-4, "bound_push": 1e-6, "bound_frac": 1e-6, "bound_relax_factor": 0.0}
# Bound of lam (lam - k phi) of the relaxed complementarity [N^2].
_RELAXED = 1e-4
_VARIABLES = ("q", "v", "u", "stage_q", "stage_v")


@dataclass(frozen=True)
class _Guess:
    """Values of a plan's variables, stages included, and its modes (steps, s * nc)."""

    values: dict[str, np.ndarray]
    closed: np.ndarray

    @classmethod
    def of(cls, model: Any) -> _Guess:
        found = {name: variable for name in _VARIABLES if (variable := model.component(f"variable_{name}")) is not None}
        return cls({name: read_values(variable) for name, variable in found.items()}, stage_penetration(model) > 0.0)


class CollocationSession(Session):
    """See the module docstring."""

    def __init__(self, method: Method, scene: Scene, options: CollocationOptions, opening: tuple[float, float]) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._kernel, self._residuals = load_kernel(scene), PlanResiduals(scene)
        self._scheme = Scheme(options.scheme)
        self._homotopy: SoftplusHomotopy | None = None
        self._exact: Workbench | None = None
        self._opening = (perf_counter() - opening[0], process_time() - opening[1])

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        self._method.check_eps(eps)
        if not time_limit > 0.0:
            raise OptionError(f"method {self._method.name}: the time limit is {time_limit!r}, but must be a positive number of seconds.")
        account, self._opening = Account(time_limit, self._opening), (0.0, 0.0)
        begin, own = perf_counter(), self._options
        if self._homotopy is None:
            sharpnesses = schedule(own.first_sharpness, own.last_sharpness, own.sharpness_growth)
            self._homotopy = SoftplusHomotopy(self._scene, 0.0, sharpnesses, scheme=self._scheme, integrate_cost=own.integrate_cost)
        softplus = self._homotopy.bench
        if warm_start is not None:
            load_plan(softplus.model, warm_start)  # refuses a plan of another grid
        account.build += perf_counter() - begin
        guesses, outcome, message = self._softened(account, warm_start)
        if not self._scene.nc:
            return self._solution(account, softplus, outcome, message)
        if not guesses:
            return self._solution(account, None, outcome, message)
        for guess in guesses:
            result = self._with_modes(account, guess)
            if result.outcome is Outcome.SOLVED or account.is_over:
                break
        else:
            result = self._from_relaxed(account, guesses[0])
        if result.outcome is Outcome.SOLVED:
            return self._solution(
                account, self._exact, Outcome.SOLVED, f"Modes of the stages were read off, the rest solved by Ipopt: {result.message}"
            )
        if account.is_over:
            return self._solution(account, None, Outcome.TIME_LIMIT, "no modes of the stages with a plan were found in the time given.")
        return self._solution(
            account, None, Outcome.STALLED, "no modes of the stages that were tried have a plan; a finer grid, or another start, may."
        )

    # -- the steps --------------------------------------------------------------------------------------------------------------

    def _softened(self, account: Account, start: Trajectory | None) -> tuple[list[_Guess], Outcome, str]:
        """The last stages of the homotopy, the sharpest first; where its first stage has no plan, from the plan that comes nearest to the goal."""
        homotopy = cast(SoftplusHomotopy, self._homotopy)
        options = {
            "tol": self._options.homotopy_tolerance,
            "max_iter": self._options.max_iterations,
            **band_options(),
        }
        guesses: list[_Guess] = []

        def keep(_: Trajectory) -> None:
            if self._scene.nc:
                guesses.insert(0, _Guess.of(homotopy.bench.model))

        outcome, message = homotopy.run(account, options, start, keep, PATIENCE)
        if not guesses and outcome is not Outcome.SOLVED and not account.is_over:
            sharpest = self._options.first_sharpness / self._scene.length
            found = nearest(self._scene, account, self._options.max_iterations, sharpest)
            if found.is_out_of_reach:
                task = self._scene.task
                words = f"no plan of {task.steps} steps of {task.step:g} s was found that reaches the goal within the bounds: the nearest misses {found.words}."
                return guesses, Outcome.INFEASIBLE, words
            if found.is_solved:
                outcome, message = homotopy.run(account, options, found.plan, keep, PATIENCE)
        return guesses[:_TRIED], outcome, message

    def _bench(self, account: Account) -> Workbench:
        if self._exact is None:
            begin = perf_counter()
            model = build_model(
                self._scene, ContactLaw.COMPLEMENTARITY, eps=0.0, scheme=self._scheme, integrate_cost=self._options.integrate_cost
            )
            account.build += perf_counter() - begin
            self._exact = Workbench(model)
        return self._exact

    def _load(self, bench: Workbench, guess: _Guess) -> None:
        for name, values in guess.values.items():
            write_values(bench.model.component(f"variable_{name}"), values)
        settle_forces(bench.model)

    def _with_modes(self, account: Account, guess: _Guess) -> IpoptResult:
        """What is left once the stages of a guess are open or closed as it says."""
        bench = self._bench(account)
        self._load(bench, guess)
        hold_modes(bench.model, guess.closed)
        options = {"tol": self._options.tolerance, **band_options(), **_NEAR}
        return bench.run(account, {**options, "max_iter": account.iterations + _MODE_ITERATIONS})

    def _from_relaxed(self, account: Account, guess: _Guess) -> IpoptResult:
        bench = self._bench(account)
        self._load(bench, guess)
        release_modes(bench.model)
        tighten(bench.model, _RELAXED)
        options = {"tol": self._options.homotopy_tolerance, **band_options(), **_NEAR, "mu_init": 1e-2}
        relaxed = Workbench(bench.model)  # translated anew: the products are rows again
        result = relaxed.run(account, {**options, "max_iter": account.iterations + self._options.max_iterations})
        if not result.solved:
            return result
        return self._with_modes(account, _Guess.of(bench.model))

    # -- what is handed back ----------------------------------------------------------------------------------------------------

    def _solution(self, account: Account, bench: Workbench | None, outcome: Outcome, message: str) -> Solution:
        plan, cost, residuals = None, None, {}
        if bench is not None and outcome.has_answer:
            try:
                plan = read_plan(bench.model)
            except TrajectoryError:  # a value that is not finite: no plan
                outcome = Outcome.EVALUATION_ERROR
        if plan is not None:
            cost = self._residuals.cost(plan)
            residuals = {**self._residuals.of(plan), "switch_error": switch_error(self._kernel, plan)}
            missed = {name: residuals[name] for name in _PROMISED if not residuals.get(name, 0.0) <= self._options.plan_tolerance}
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
        scene, table = self._scene, tableau(self._scheme)
        steps, given = scene.task.steps, sum(value is not None for value in scene.task.goal)
        own, ends = (table.stages - 1, 0) if table.is_stiffly_accurate else (table.stages, 1)
        return ModelSize(
            unknowns=2 * scene.nq * (steps + 1) + (scene.nu + 2 * scene.nq * own + 2 * scene.nc * table.stages) * steps,
            equations=2 * scene.nq + given + (2 * scene.nq * (table.stages + ends) + scene.nc * table.stages) * steps,
        )


_PROMISED = ("dynamics_defect", "start_error", "terminal_error", "input_bound_excess", "velocity_bound_excess")

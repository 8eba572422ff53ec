"""The session of `collocation`: fix the modes of a softplus homotopy at every stage of the steps.

The rest has no complementarity (a convex QP for a linear scene), and the true contact law holds at
every stage: lam = k phi or lam = 0.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from formulations.contact_modes.method import CollocationOptions
from formulations.contact_modes.nonlinear import STAGE_ITERATIONS, SoftplusHomotopy, schedule
from formulations.ipopt import IpoptResult
from formulations.ipopt.linear_solver import band_options
from formulations.method import Clock, Method, Session
from formulations.solution import ModelSize, Outcome, Solution, checked
from formulations.transcription.build import build_model, read_values, write_values
from formulations.transcription.collocation import settle_forces, stage_penetration
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.contact import (
    ContactFormulation,
    hold_modes,
    release_modes,
    set_relaxation,
)
from formulations.transcription.method import SolveBudget
from formulations.transcription.residuals import PlanResiduals
from formulations.transcription.solving import nearest, out_of_reach
from models.codegen.kernel import load_kernel
from models.collocation import switch_error
from models.errors import TrajectoryError
from models.scene import Scene
from models.schemes import Scheme, tableau
from models.trajectory import Trajectory

# Number of homotopy stages whose modes are tried.
_TRIED = 3
# Modes with a plan are solved in 5 to 60 iterations.
_MODE_ITERATIONS = 150
# The start is close to the plan: Ipopt's default barrier (0.1) would push it away from every bound.
_NEAR = {"mu_init": 1e-4, "bound_push": 1e-6, "bound_frac": 1e-6, "bound_relax_factor": 0.0}
# Bound of lam (lam - k phi) [N^2] of the relaxed complementarity.
_RELAXED = 1e-4
_VARIABLES = ("q", "v", "u", "stage_q", "stage_v")


@dataclass(frozen=True)
class StageModes:
    """Values of a plan's variables including stages, and its modes closed (steps, s * nc)."""

    values: dict[str, np.ndarray]
    closed: np.ndarray

    @classmethod
    def of(cls, model: Any) -> StageModes:
        """Read values and modes from a solved model."""
        return cls(
            {name: read_values(model.component(f"variable_{name}")) for name in _VARIABLES},
            stage_penetration(model) > 0.0,
        )


class CollocationSession(Session):
    """The session of `collocation`; it builds its models at the first solve."""

    def __init__(
        self, method: Method, scene: Scene, options: CollocationOptions, clock: Clock
    ) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._scheme = Scheme(options.scheme)
        self._kernel, self._residuals = load_kernel(scene), PlanResiduals(scene)
        self._clock = clock

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Find a plan of collocated steps. Raises TrajectoryError for a plan of another grid."""
        self._method.check_stage(eps, time_limit)
        budget = SolveBudget(time_limit, self._clock.pay())
        guesses, outcome, message = self._softened(budget, warm_start)
        if not self._scene.nc:
            return self._solution(budget, self._homotopy.compiled, outcome, message)
        if not guesses:
            return self._solution(budget, None, outcome, message)
        for guess in guesses:
            result = self._with_modes(budget, guess)
            if result.outcome is Outcome.SOLVED or budget.is_over:
                break
        else:
            result = self._from_relaxed(budget, guesses[0])
        if result.outcome is Outcome.SOLVED:
            message = (
                f"Modes of the stages were read off, the rest solved by Ipopt: {result.message}"
            )
            return self._solution(budget, self._exact, Outcome.SOLVED, message)
        if budget.is_over:
            return self._solution(
                budget,
                None,
                Outcome.TIME_LIMIT,
                "no feasible modes of the stages were found within the time limit.",
            )
        message = "no modes of the stages that were tried have a plan; a finer grid, or another start, may."
        return self._solution(budget, None, Outcome.STALLED, message)

    @cached_property
    def _homotopy(self) -> SoftplusHomotopy:
        own = self._options
        sharpnesses = schedule(own.first_sharpness, own.last_sharpness, own.sharpness_growth)
        return SoftplusHomotopy(
            self._scene, sharpnesses, scheme=self._scheme, integrate_cost=own.integrate_cost
        )

    @cached_property
    def _exact(self) -> CompiledModel:
        form, integrated = ContactFormulation.COMPLEMENTARITY, self._options.integrate_cost
        return CompiledModel(
            build_model(self._scene, form, eps=0.0, scheme=self._scheme, integrate_cost=integrated)
        )

    def _softened(
        self, budget: SolveBudget, start: Trajectory | None
    ) -> tuple[list[StageModes], Outcome, str]:
        """Return the last stages of the homotopy, sharpest first.

        If its first stage fails, restart from the plan that ends closest to the goal.
        """
        guesses: list[StageModes] = []
        with budget.building():
            homotopy = self._homotopy

        def keep(_: Trajectory) -> None:
            if self._scene.nc:
                guesses.append(StageModes.of(homotopy.compiled.model))

        options = {
            "tol": self._options.homotopy_tolerance,
            "max_iter": self._options.max_iterations,
            **band_options(),
        }
        outcome, message = homotopy.run(budget, options, start, keep, STAGE_ITERATIONS)
        if not guesses and outcome is not Outcome.SOLVED and not budget.is_over:
            closest = nearest(
                self._scene,
                budget,
                self._options.max_iterations,
                self._options.first_sharpness / self._scene.length,
            )
            if closest.is_out_of_reach:
                return [], Outcome.INFEASIBLE, out_of_reach(self._scene, closest)
            if closest.is_solved:
                outcome, message = homotopy.run(
                    budget, options, closest.plan, keep, STAGE_ITERATIONS
                )
        return guesses[: -_TRIED - 1 : -1], outcome, message

    def _with_modes(self, budget: SolveBudget, guess: StageModes) -> IpoptResult:
        with budget.building():
            compiled = self._exact
        _load(compiled, guess)
        hold_modes(compiled.model, guess.closed)
        options = {"tol": self._options.tolerance, **band_options(), **_NEAR}
        return compiled.run(budget, {**options, "max_iter": budget.iterations + _MODE_ITERATIONS})

    def _from_relaxed(self, budget: SolveBudget, guess: StageModes) -> IpoptResult:
        compiled = self._exact
        _load(compiled, guess)
        release_modes(compiled.model)
        set_relaxation(compiled.model, _RELAXED)
        options = {
            "tol": self._options.homotopy_tolerance,
            **band_options(),
            **_NEAR,
            "mu_init": 1e-2,
        }
        relaxed = CompiledModel(
            compiled.model
        )  # compiled again, because the products are rows again
        result = relaxed.run(
            budget, {**options, "max_iter": budget.iterations + self._options.max_iterations}
        )
        return self._with_modes(budget, StageModes.of(compiled.model)) if result.solved else result

    def _solution(
        self, budget: SolveBudget, compiled: CompiledModel | None, outcome: Outcome, message: str
    ) -> Solution:
        plan, cost, residuals = None, None, {}
        if compiled is not None and outcome.has_answer:
            try:
                plan = compiled.read()
            except TrajectoryError:  # a non-finite value
                outcome = Outcome.EVALUATION_ERROR
        if plan is not None:
            cost = self._residuals.cost(plan)
            residuals = {
                **self._residuals.of(plan),
                "switch_error": switch_error(self._kernel, plan),
            }
            outcome, message = checked(outcome, message, residuals, self._options.promises())
        solution = Solution(
            method=self._method.name,
            outcome=outcome,
            message=message,
            trajectory=plan,
            cost=cost,
            residuals=residuals,
            options=asdict(self._options),
            size=None if compiled is None else compiled.size,
            paper_size=None if compiled is None else self._paper_size(),
        )
        return budget.spent_on(solution)

    def _paper_size(self) -> ModelSize:
        """Count unknowns and equations of the model with fixed modes, by hand.

        Nodes, inputs, the first stage, forces and separation forces; ends, stages, nodes that are
        no stage, separation forces.
        """
        scene, table = self._scene, tableau(self._scheme)
        steps, ends_given = scene.task.steps, sum(value is not None for value in scene.task.goal)
        ends = 0 if table.is_stiffly_accurate else 1
        return ModelSize(
            unknowns=2 * scene.nq * (steps + 1)
            + (scene.nu + 2 * scene.nq + 2 * scene.nc * table.stages) * steps,
            equations=2 * scene.nq
            + ends_given
            + (2 * scene.nq * (table.stages + ends) + scene.nc * table.stages) * steps,
        )


def _load(compiled: CompiledModel, guess: StageModes) -> None:
    for name, values in guess.values.items():
        write_values(compiled.model.component(f"variable_{name}"), values)
    settle_forces(compiled.model)

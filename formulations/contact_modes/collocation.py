"""The stages of a collocation scheme: modes read off a softplus homotopy, which contact is closed at which stage, and the problem with these modes.

With the modes fixed no complementarity is left, for a linear scene a convex QP, and the true contact law holds at every stage: lam = k phi or lam = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from formulations.contact_modes.nonlinear import STAGE_ITERATIONS, SoftplusHomotopy, schedule
from formulations.ipopt import IpoptResult
from formulations.ipopt.linear_solver import band_options
from formulations.solution import Outcome
from formulations.transcription.build import build_model, load_plan, read_values, write_values
from formulations.transcription.collocation import settle_forces, stage_penetration
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.contact import ContactFormulation, hold_modes, release_modes, set_relaxation
from formulations.transcription.feasibility import Nearest, nearest
from formulations.transcription.method import SolveBudget
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory

# Modes that have a plan are solved in 5 to 60 iterations; more are spent only on proving that there is none.
_MODE_ITERATIONS = 150
# They start from a plan that is nearly theirs: Ipopt's own barrier (0.1) first pushes it away from every bound.
_NEAR = {"mu_init": 1e-4, "bound_push": 1e-6, "bound_frac": 1e-6, "bound_relax_factor": 0.0}
# Bound of lam (lam - k phi) of the relaxed complementarity [N^2].
_RELAXED = 1e-4
_VARIABLES = ("q", "v", "u", "stage_q", "stage_v")


@dataclass(frozen=True)
class StageModes:
    """Values of a plan's variables, stages included, and its modes closed (steps, s * nc)."""

    values: dict[str, np.ndarray]
    closed: np.ndarray

    @classmethod
    def of(cls, model: Any) -> StageModes:
        """Read them off a solved model."""
        found = {name: variable for name in _VARIABLES if (variable := model.component(f"variable_{name}")) is not None}
        return cls({name: read_values(variable) for name, variable in found.items()}, stage_penetration(model) > 0.0)


class StageProblem:
    """The models of one scene under one scheme: softplus contact, and complementarity.

    sharpnesses: of the homotopy, |ln eps|; tolerance: Ipopt's tol; homotopy_tolerance: the same in the homotopy; most_iterations: of a solve.
    """

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme,
        sharpnesses: tuple[float, float, float],
        *,
        integrate_cost: bool,
        tolerance: float,
        homotopy_tolerance: float,
        most_iterations: int,
    ) -> None:
        self._scene, self._scheme, self._integrate_cost = scene, scheme, integrate_cost
        self._tolerance, self._homotopy_tolerance, self._most_iterations = tolerance, homotopy_tolerance, most_iterations
        self._sharpnesses = schedule(*sharpnesses)
        self._homotopy: SoftplusHomotopy | None = None
        self._exact: CompiledModel | None = None

    @property
    def homotopy(self) -> SoftplusHomotopy:
        """The softplus model, built at its first use; it holds the last stage's plan."""
        if self._homotopy is None:
            self._homotopy = SoftplusHomotopy(self._scene, 0.0, self._sharpnesses, scheme=self._scheme, integrate_cost=self._integrate_cost)
        return self._homotopy

    def prepare(self, start: Trajectory | None) -> None:
        """Build the softplus model at its first use, and load the start. Raises TrajectoryError for a plan of another grid."""
        compiled = self.homotopy.compiled
        if start is not None:
            load_plan(compiled.model, start)

    def soften(self, budget: SolveBudget, start: Trajectory | None, keep: Callable[[StageModes], None]) -> tuple[Outcome, str]:
        """Run the homotopy from this start; how it ended. keep: called with the modes of every stage that was solved, where there are contacts."""

        def solved(_: Trajectory) -> None:
            if self._scene.nc:
                keep(StageModes.of(self.homotopy.compiled.model))

        options = {"tol": self._homotopy_tolerance, "max_iter": self._most_iterations, **band_options()}
        return self.homotopy.run(budget, options, start, solved, STAGE_ITERATIONS)

    def nearest(self, budget: SolveBudget, sharpest: float) -> Nearest:
        """Find the plan that comes nearest to the goal, with contact no sharper than this."""
        return nearest(self._scene, budget, self._most_iterations, sharpest)

    def exact(self, budget: SolveBudget) -> CompiledModel:
        """Give the model with complementarity, built at its first use."""
        if self._exact is None:
            begin = perf_counter()
            model = build_model(
                self._scene, ContactFormulation.COMPLEMENTARITY, eps=0.0, scheme=self._scheme, integrate_cost=self._integrate_cost
            )
            budget.build += perf_counter() - begin
            self._exact = CompiledModel(model)
        return self._exact

    def with_modes(self, budget: SolveBudget, guess: StageModes) -> IpoptResult:
        """Solve what is left once the stages of a guess are open or closed as it says."""
        compiled = self.exact(budget)
        _load(compiled, guess)
        hold_modes(compiled.model, guess.closed)
        options = {"tol": self._tolerance, **band_options(), **_NEAR}
        return compiled.run(budget, {**options, "max_iter": budget.iterations + _MODE_ITERATIONS})

    def from_relaxed(self, budget: SolveBudget, guess: StageModes) -> IpoptResult:
        """Do the same with the modes of a relaxed complementarity that starts at the guess."""
        compiled = self.exact(budget)
        _load(compiled, guess)
        release_modes(compiled.model)
        set_relaxation(compiled.model, _RELAXED)
        options = {"tol": self._homotopy_tolerance, **band_options(), **_NEAR, "mu_init": 1e-2}
        relaxed = CompiledModel(compiled.model)  # translated anew: the products are rows again
        result = relaxed.run(budget, {**options, "max_iter": budget.iterations + self._most_iterations})
        return self.with_modes(budget, StageModes.of(compiled.model)) if result.solved else result


def _load(compiled: CompiledModel, guess: StageModes) -> None:
    for name, values in guess.values.items():
        write_values(compiled.model.component(f"variable_{name}"), values)
    settle_forces(compiled.model)

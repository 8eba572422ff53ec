"""Solve the planning problem of any scene with fixed contact modes by Ipopt, to a local optimum.

`SoftplusHomotopy` finds first modes with sharpness b L = 7, 14, .., 448 (L: the scene's length, so
that units do not matter). A touching pair has the force k ln 2 / b. If the inputs cannot hold this
force, k starts at a hundredth, a fiftieth, .. of its value. k reaches its value with the last
stage.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from formulations.contact_modes.linear import is_linear, linear_scene
from formulations.contact_modes.quadratic import ModesAnswer, ModesProblem
from formulations.ipopt import IpoptResult
from formulations.solution import Outcome
from formulations.transcription.build import build_model, read_plan
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.contact import ContactFormulation, hold_modes, set_relaxation
from formulations.transcription.method import SolveBudget
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import Kernel
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory

# Sharpness b L from which a stage reuses multipliers: earlier the plan still moves too far (three
# carts: 64 iterations; 140 if from the second stage on, 75 without).
_DUALS_FROM = 100.0
# Largest softplus force of touching bodies, as a share of the strongest input: 3 N of 10 N for the
# three carts, k = 30 and b = 7.
_TOUCH = 0.3
# Iteration limit of a stage after a first plan: successful ones took up to 83 (chains of 2 to 5
# carts); longer ones are lost in restoration.
STAGE_ITERATIONS = 200
# Force and separation of a touching pair [N]; Ipopt keeps them to 1e-8.
_BIACTIVE = 1e-6
# Iteration limit of a neighbour of a plan: it needs 5 to 20.
_NEIGHBOUR_ITERATIONS = 50


class SoftplusHomotopy:
    """The softplus model of one scene, built once.

    schedule: b L of its stages
    scheme, integrate_cost: as in `build_model`
    compiled: the model, which holds the plan of the last stage
    """

    def __init__(
        self,
        scene: Scene,
        schedule: tuple[float, ...],
        *,
        scheme: Scheme = Scheme.SEMI_IMPLICIT_EULER,
        integrate_cost: bool = False,
    ) -> None:
        model = build_model(
            scene,
            ContactFormulation.SOFTPLUS,
            eps=_eps(schedule[0]),
            scheme=scheme,
            integrate_cost=integrate_cost,
        )
        self._stiffness = _own_stiffness(scene)
        self._stages = (
            tuple(_stages(scene, schedule, bool(self._stiffness)))
            if scene.nc
            else ((schedule[0], 1.0),)
        )
        self.compiled = CompiledModel(model)

    def run(
        self,
        budget: SolveBudget,
        options: Mapping[str, Any],
        start: Trajectory | None,
        keep: Callable[[Trajectory], None],
        most_iterations: int = 10**9,
    ) -> tuple[Outcome, str]:
        """Solve stage by stage; return outcome and message of the last one.

        keep: called with the plan of every solved stage
        most_iterations: limit of a stage after a first plan
        """
        model = self.compiled.model
        self.compiled.load(start)
        plan, before = None, None
        outcome, message = Outcome.FAILED, ""
        # Iterations of earlier runs do not count.
        options = {**options, "max_iter": budget.iterations + options["max_iter"]}
        for sharpness, share in self._stages:
            if len(self._stages) > 1:
                set_relaxation(model, _eps(sharpness))
            for name, value in self._stiffness.items():
                model.parameter_scene[name] = share * value
            warm = before if sharpness >= _DUALS_FROM else None
            allowed = (
                options
                if plan is None
                else {
                    **options,
                    "max_iter": min(options["max_iter"], budget.iterations + most_iterations),
                }
            )
            result = self.compiled.run(budget, allowed, warm)
            if not result.solved and warm is not None and plan is not None and not budget.is_over:
                self.compiled.load(plan)
                result = self.compiled.run(budget, allowed)
            outcome, message = result.outcome, result.message
            if not result.solved:
                break
            before, plan = result, read_plan(model)
            keep(plan)
        return outcome, message


def schedule(first: float, last: float, growth: float) -> tuple[float, ...]:
    """Return b L of the stages, from first to last by a constant factor."""
    count = int(np.floor(np.log(max(last / first, 1.0)) / np.log(growth) + 1e-9)) + 1
    return tuple(first * growth**index for index in range(count))


def _own_stiffness(scene: Scene) -> dict[str, float]:
    """Return the parameters that are only stiffnesses; empty unless each contact has one."""
    symbols = {contact.stiffness for contact in scene.contacts}
    parameters = {parameter.symbol: parameter for parameter in scene.parameters}
    physics = [
        scene.kinetic_energy,
        scene.potential_energy,
        *scene.forces,
        scene.task.running_cost,
        scene.task.final_cost,
    ]
    elsewhere = set().union(
        *(
            sp.sympify(e).free_symbols
            for e in (*physics, *(contact.penetration for contact in scene.contacts))
        )
    )
    if not all(symbol in parameters and symbol not in elsewhere for symbol in symbols):
        return {}
    return {
        parameters[symbol].name: parameters[symbol].value
        for symbol in parameters
        if symbol in symbols
    }


def _stages(
    scene: Scene, schedule: tuple[float, ...], may_soften: bool
) -> Iterator[tuple[float, float]]:
    stiffest = max(
        float(sp.sympify(contact.stiffness).subs(scene.parameter_values))
        for contact in scene.contacts
    )
    strongest = max(max(abs(item.lower), abs(item.upper)) for item in scene.inputs)
    share = 1.0
    for sharpness in schedule:
        touch = stiffest * scene.length * np.log(2.0) / sharpness
        share = min(1.0, _TOUCH * strongest / touch) if may_soften else 1.0
        yield sharpness, share
    while share < 1.0:
        share = min(1.0, 2.0 * share)
        yield schedule[-1], share


def _eps(sharpness: float) -> float:
    return float(np.exp(-sharpness))


@dataclass(frozen=True, kw_only=True, eq=False)
class NonlinearAnswer(ModesAnswer):
    """A local optimum for fixed modes, with its plan."""

    plan: Trajectory


class NonlinearModes:
    """One model with modes fixed by bounds; the first solve starts from the plan `guess`."""

    def __init__(self, scene: Scene, kernel: Kernel) -> None:
        self._scene, self._kernel = scene, kernel
        # This bound has no effect: fixing modes switches the products off.
        model = build_model(
            scene, ContactFormulation.COMPLEMENTARITY, eps=1.0 if scene.nc else None
        )
        self._compiled, self._residuals = CompiledModel(model), PlanResiduals(scene)

    def begin(self, budget: SolveBudget, options: Mapping[str, Any]) -> NonlinearModes:
        """Begin a search in a state that does not depend on earlier searches."""
        self._budget, self._options = budget, {**options, "bound_relax_factor": 0.0}
        self.guess: Trajectory | None = None
        self.solves, self.unsolved = 0, 0
        return self

    def solve(
        self, closed: np.ndarray, near: NonlinearAnswer | None = None, below: float = np.inf
    ) -> NonlinearAnswer | None:
        """Return an optimum for these modes that costs less than `below`, or None.

        closed is (steps, nc) [-]; the solve starts from the plan of `near`, the answer of similar
        modes. Raises ValueError for modes of another shape.
        """
        model, scene = self._compiled.model, self._scene
        guess = self.guess if near is None else near.plan
        closed = np.array(closed, dtype=bool)
        if scene.nc:
            closed[0] = self._kernel.penetration(np.array([scene.task.start[: scene.nq]]))[0] > 0.0
        self._compiled.load(guess)
        if scene.nc:
            hold_modes(model, closed)
        self.solves += 1
        most = (
            self._options["max_iter"]
            if near is None
            else min(self._options["max_iter"], _NEIGHBOUR_ITERATIONS)
        )
        result = self._compiled.run(
            self._budget, {**self._options, "max_iter": self._budget.iterations + most}
        )
        if not result.solved:
            self.unsolved += 1
            return None
        plan = read_plan(model)
        cost = self._residuals.cost(plan)
        if not cost < below:
            return None
        of_force, of_separation = self._multipliers(result)
        phi = self._kernel.penetration(plan.q[:-1])
        biactive = (plan.lam <= _BIACTIVE) & (
            plan.lam - self._kernel.stiffness() * phi <= _BIACTIVE
        )
        biactive[:1] = False  # the start decides these
        return NonlinearAnswer(
            closed=closed,
            u=plan.u,
            plan=plan,
            phi=phi,
            cost=cost,
            of_force=of_force,
            of_separation=of_separation,
            biactive=biactive,
            dual_infeasibility=result.residuals.dual_infeasibility,
        )

    def _multipliers(self, result: IpoptResult) -> np.ndarray:
        """Return the multipliers (2, steps, nc) of lam >= 0 and v = lam - k phi >= 0."""
        if not self._scene.nc:
            return np.zeros((2, self._scene.task.steps, 0))
        model = self._compiled.model
        separations = [pair.v for pair in model.complementarity_contact.values()]
        _, slope = self._compiled.ends(
            self._budget, result, [*model.variable_lam.values(), *separations]
        )
        return slope.reshape(2, -1, self._scene.nc)


class SceneModels:
    """The models of one scene."""

    def __init__(self, scene: Scene, kernel: Kernel) -> None:
        self.scene, self.kernel = scene, kernel
        self._homotopies: dict[tuple[float, ...], SoftplusHomotopy] = {}
        self.is_linear = is_linear(scene)

    def homotopy(self, schedule: tuple[float, ...]) -> SoftplusHomotopy:
        """Return the softplus homotopy with this schedule."""
        if schedule not in self._homotopies:
            self._homotopies[schedule] = SoftplusHomotopy(self.scene, schedule)
        return self._homotopies[schedule]

    def modes(
        self, budget: SolveBudget, options: Mapping[str, Any]
    ) -> ModesProblem | NonlinearModes:
        """Return the problem with fixed modes.

        Budget and options are for Ipopt (nonlinear scenes).
        """
        return self._linear if self.is_linear else self._nonlinear.begin(budget, options)

    @cached_property
    def _linear(self) -> ModesProblem:
        return ModesProblem(linear_scene(self.scene))

    @cached_property
    def _nonlinear(self) -> NonlinearModes:
        return NonlinearModes(self.scene, self.kernel)

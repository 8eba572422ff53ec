"""Scene -> Proof: the cheapest exact plan found, and a cost below which no plan exists.

    proof = prove(scene, incumbent=mpcc.trajectory, time_limit=200.0)
    proof.cost, proof.bound, proof.gap, proof.seconds, proof.nodes

The plan is never SCIP's own: its contact modes are taken, the convex program with these modes is
solved exactly (`contact_modes.quadratic`), its inputs are rolled out through the true contact law,
and its residuals recomputed. The bound is the least of SCIP's and of the ceiling under which the
big-M hold. It is true up to floating point: Clarabel's bounds are lowered by 1e-6, SCIP works to
its 1e-6 of feasibility and 1e-9 of optimality.

The solver of the extra `[global]`; where it is missing one sentence says so.

The exact planning problem of a linear scene as a mixed-integer quadratic program in Pyomo, with one
binary variable a pair.

    model = build_miqp(scene, bounds)
    pyo.SolverFactory("scip_direct").solve(model)          # or Gurobi, or whatever Pyomo knows

    lam <= k h+ b,   lam - k phi <= -k l- (1 - b),   lam >= 0,   lam - k phi >= 0,   b in {0, 1}

on top of the plain model of `build_model` (same names). `mpec.simple_disjunction` and a big-M
transformation make two binaries a pair and one M for all; `python -m benchmarks proof
--disjunction` says what that costs.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from enum import Enum
from time import perf_counter, process_time
from typing import Any

import clarabel
import numpy as np
import pyomo.environ as pyo
from pyomo.contrib.solver.common.factory import SolverFactory

from formulations.contact_modes.goal import correct_end
from formulations.contact_modes.linear import linear_scene, why_not_linear
from formulations.contact_modes.quadratic import ModesProblem
from formulations.grids import plan_of
from formulations.proof.bounds import PairBounds, pair_bounds
from formulations.solution import Bound, Outcome
from formulations.transcription.build import build_model
from formulations.transcription.contact import ContactFormulation, ModelError, SceneExpressions
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import load_kernel
from models.dynamics import derive
from models.errors import MachineError, SceneError
from models.scene import Scene
from models.scene.goal import distance, goal_state
from models.trajectory import Trajectory


def missing_solver() -> str | None:
    """None, or the sentence that says what is not installed and how to install it."""
    if importlib.util.find_spec("pyscipopt") is not None:
        return None
    return "a proof needs pyscipopt (SCIP, for mixed-integer programs); install with: pip install pyscipopt."


def build_miqp(scene: Scene, bounds: PairBounds) -> pyo.ConcreteModel:
    """The scene's exact problem as a mixed-integer quadratic program; see the module docstring.

    The objective is `variable_cost`, at least the cost and at most the ceiling of the bounds.

    Raises
    ------
    ModelError
        for bounds that are infinite: they are the big-M
    """
    if not bounds.is_finite:
        raise ModelError(
            f"scene {scene.name}: a penetration has no finite bound, so there is no big-M; bound the inputs or give a ceiling."
        )
    model: Any = build_model(scene, ContactFormulation.COMPLEMENTARITY)
    model.objective_cost.deactivate()
    model.variable_cost = pyo.Var(bounds=(None, bounds.ceiling))
    model.constraint_cost = pyo.Constraint(expr=model.variable_cost >= model.expression_cost)
    model.objective_bound = pyo.Objective(expr=model.variable_cost)
    if scene.nc:
        _add_pairs(model, scene, bounds)
    return model


def _add_pairs(model: Any, scene: Scene, bounds: PairBounds) -> None:
    law = SceneExpressions(derive(scene))
    p = list(model.parameter_scene.values()) if scene.parameters else []
    k = [float(pyo.value(entry)) for entry in law.stiffness(p)]
    model.complementarity_contact.deactivate()
    model.variable_closed = pyo.Var(model.set_steps, model.set_contacts, domain=pyo.Binary)
    model.constraint_pair = pyo.ConstraintList()
    for t in model.set_steps:
        phi = law.penetration([model.variable_q[t, name] for name in model.set_coordinates], p)
        for i, name in enumerate(model.set_contacts):
            force, closed = model.variable_lam[t, name], model.variable_closed[t, name]
            low, high = (
                k[i] * min(float(bounds.lower[t, i]), 0.0),
                k[i] * max(float(bounds.upper[t, i]), 0.0),
            )
            force.setub(high)
            if bounds.decided[t, i]:
                closed.fix(1 if bounds.lower[t, i] >= 0.0 and bounds.upper[t, i] > 0.0 else 0)
            separation = force - k[i] * phi[i]
            model.constraint_pair.add(force <= high * closed)
            model.constraint_pair.add(separation >= 0.0)
            model.constraint_pair.add(separation <= -low * (1 - closed))


# relative, below which a plan counts as proved optimal: SCIP keeps the quadratic cost row to 1e-6
# of its size
GAP = 1e-5
# relative: by so much plans may be dearer than the one known, so that rounding does not cut it off
_CEILING = 1e-5
_SCOUTING = 0.1  # part of the time given to SCIP for a first plan, where none is known
EXACT = 1e-8  # largest residual [m, rad, N, ..] of a plan that counts


class ProofStatus(Enum):
    """The value is a sentence for the user."""

    OPTIMAL = "Proved: no plan is cheaper."
    BOUND = "Not proved in the time given; the bound says how much cheaper a plan could be at most."
    INFEASIBLE = "Proved: no plan meets the constraints."
    NOTHING = "Neither a plan nor a bound was found in the time given."


_OUTCOMES = {
    ProofStatus.OPTIMAL: Outcome.SOLVED,
    ProofStatus.BOUND: Outcome.TIME_LIMIT,
    ProofStatus.INFEASIBLE: Outcome.INFEASIBLE,
    ProofStatus.NOTHING: Outcome.TIME_LIMIT,
}


@dataclass(frozen=True, kw_only=True)
class Proof:
    """What is proved of a scene.

    plan, cost: the cheapest exact plan known (None: none); bound: no plan costs less (inf: there is
        none at all); gap: (cost - bound)/cost, None without
    a plan; seconds: wall; cpu: CPU seconds; nodes: of SCIP's tree; binaries: pairs that bounds
        alone did not decide; solver: names and versions; trouble:
    what SCIP said where it broke off
    """

    status: ProofStatus
    plan: Trajectory | None
    cost: float | None
    bound: float
    seconds: float
    cpu: float
    nodes: int
    binaries: int
    pairs: int
    solver: str
    trouble: str = ""

    @property
    def gap(self) -> float | None:
        """Cost above the bound, relative to the cost; None without a plan."""
        return (
            None
            if self.cost is None
            else max(0.0, (self.cost - self.bound) / max(abs(self.cost), 1e-12))
        )

    @property
    def outcome(self) -> Outcome:
        """The status as an outcome."""
        return _OUTCOMES[self.status]

    @property
    def known_bound(self) -> Bound | None:
        """The bound, where there is one."""
        if not np.isfinite(self.bound):
            return None
        return Bound(
            value=self.bound,
            gap=self.gap,
            proved=self.status is ProofStatus.OPTIMAL,
            decisions=self.pairs,
            open_decisions=self.binaries,
            nodes=self.nodes,
        )

    @property
    def sentence(self) -> str:
        """Status, decisions, nodes and bound in words."""
        words = f"{self.status.value}{self.trouble} {self.pairs} contact decisions, {self.binaries} of them left open by bounds, {self.nodes} nodes"
        return f"{words}, bound {self.bound:.10g}." if np.isfinite(self.bound) else f"{words}."


def prove(scene: Scene, *, incumbent: Trajectory | None = None, time_limit: float = 600.0) -> Proof:
    """The cheapest exact plan found, and a cost below which no plan exists.

    See the module docstring.

    Parameters
    ----------
    scene : a linear scene
    incumbent : a plan whose modes are tried first
    time_limit : wall time [s]

    Raises
    ------
    SceneError
        for scenes that are not linear (`why_no_proof`)
    MachineError
        where SCIP is not installed
    """
    reason = why_no_proof(scene)
    if reason is not None:
        raise SceneError(reason)
    missing = missing_solver()  # known before anything is built
    if missing is not None:
        raise MachineError(missing)
    return _Prover(scene, time_limit).run(incumbent)


class _Prover:
    def __init__(self, scene: Scene, time_limit: float) -> None:
        self._scene, self._linear = scene, linear_scene(scene)
        self._modes, self._kernel, self._residuals = (
            ModesProblem(self._linear),
            load_kernel(scene),
            PlanResiduals(scene),
        )
        self._begin, self._cpu, self._limit = perf_counter(), process_time(), time_limit
        self._plan: Trajectory | None = None
        self._cost = np.inf
        self._nodes, self._solver, self._trouble = 0, "", ""

    @property
    def _left(self) -> float:
        return self._limit - (perf_counter() - self._begin)

    def run(self, incumbent: Trajectory | None) -> Proof:
        if incumbent is not None:
            self.adopt(self._kernel.penetration(incumbent.q[:-1]) > 0.0)
        bounds = self._bounds()
        if np.isfinite(self._cost):
            return self._proof(bounds, self._branch(bounds, self._left))
        bound = self._branch(
            bounds, _SCOUTING * self._left
        )  # any plan will do: with its cost the bounds are much tighter
        if np.isfinite(self._cost) and bound < self._cost * (1.0 - GAP) and self._left > 0.0:
            bounds = self._bounds()
            bound = max(bound, self._branch(bounds, self._left))
        elif not np.isfinite(self._cost) and not np.isposinf(bound) and self._left > 0.0:
            bound = max(bound, self._branch(bounds, self._left))
        return self._proof(bounds, bound)

    def _bounds(self) -> PairBounds:
        return pair_bounds(
            self._scene, self._linear, self._ceiling, is_over=lambda: self._left <= 0.0
        )

    @property
    def _ceiling(self) -> float:
        return (
            self._cost + _CEILING * max(abs(self._cost), 1e-3)
            if np.isfinite(self._cost)
            else np.inf
        )

    def adopt(self, closed: np.ndarray) -> None:
        """Keep the optimum of these modes, closed (steps, nc) [-], if it is exact and cheaper than what is known.

        Raises nothing: modes without a plan are passed over.
        """
        answer = self._modes.solve(closed)
        plan = None if answer is None else _exact_plan(self._scene, answer.u)
        if plan is not None and self._residuals.cost(plan) < self._cost:
            self._plan, self._cost = plan, self._residuals.cost(plan)

    def _branch(self, bounds: PairBounds, seconds: float) -> float:
        """SCIP on what the bounds leave open; the bound."""
        if bounds.is_empty:
            return self._of_nothing_left(bounds)
        if bounds.decided.all():  # one choice of modes is left: its optimum is the answer
            closed = bounds.lower >= 0.0
            self.adopt(closed)
            answer = self._modes.solve(closed)
            return bounds.ceiling if answer is None else min(answer.cost, bounds.ceiling)
        if not bounds.is_finite or self._left <= 0.0:
            return -np.inf
        model: Any = build_miqp(self._scene, bounds)
        try:
            result = scip(model, seconds)
        except Exception as error:  # noqa: BLE001 - what goes wrong inside SCIP comes as a bare Exception; nothing is proved then
            self._trouble = f" {error}"
            return -np.inf
        self._solver, self._nodes = (
            f"SCIP {'.'.join(map(str, result.solver_version))}",
            self._nodes + int(result.extra_info["NNodes"]),
        )
        if result.incumbent_objective is not None:
            result.solution_loader.load_vars()
            closed = [
                [(model.variable_closed[t, c].value or 0.0) > 0.5 for c in model.set_contacts]
                for t in model.set_steps
            ]
            self.adopt(np.array(closed))
        if "infeasible" in result.termination_condition.name.lower():
            return self._of_nothing_left(bounds)
        return min(float(result.objective_bound), bounds.ceiling)

    def _of_nothing_left(self, bounds: PairBounds) -> float:
        """The bound where a solver says that no plan costs less than the ceiling: no proof if it has thereby lost the plan that is known."""
        if np.isfinite(self._cost):
            self._trouble = (
                " A solver found no plan at all where there is one, which is its rounding."
            )
            return -np.inf
        return bounds.ceiling

    def _proof(self, bounds: PairBounds, bound: float) -> Proof:
        status = ProofStatus.BOUND
        if self._plan is not None:
            bound = min(bound, self._cost)  # the ceiling lies a little above the plan that is known
            if bound >= self._cost - GAP * max(abs(self._cost), 1.0):
                status = ProofStatus.OPTIMAL
        elif np.isposinf(bound):
            status = ProofStatus.INFEASIBLE
        elif np.isneginf(bound):
            status = ProofStatus.NOTHING
        return Proof(
            status=status,
            plan=self._plan,
            cost=None if self._plan is None else self._cost,
            bound=bound,
            seconds=perf_counter() - self._begin,
            cpu=process_time() - self._cpu,
            nodes=self._nodes,
            binaries=int((~bounds.decided[1:]).sum()),
            pairs=int(bounds.decided[1:].size),
            solver=", ".join(filter(None, (self._solver, f"Clarabel {clarabel.__version__}"))),
            trouble=self._trouble,
        )


def why_no_proof(scene: Scene) -> str | None:
    """None, or the reason why the scene's problem is no mixed-integer quadratic program."""
    reason = (
        f"scene {scene.name} has friction"
        if scene.nf
        else f"scene {scene.name} has damped contacts"
        if scene.damped
        else why_not_linear(scene)
    )
    return (
        None
        if reason is None
        else f"{reason}, and a proof needs a linear scene with contacts alone and a convex quadratic running cost."
    )


def _exact_plan(scene: Scene, u: np.ndarray) -> Trajectory | None:
    """The rollout of these inputs through the true contact law, landed on the goal.

    None unless it is exact to `EXACT` by its own residuals.
    """
    rollout, u = correct_end(scene, load_kernel(scene), u)
    if rollout.diverged:
        return None
    plan = plan_of(scene, rollout, u)
    return plan if is_exact(scene, plan) else None


def is_exact(scene: Scene, plan: Trajectory) -> bool:
    """Whether a plan meets the strict problem: time step, start, goal, bounds, and complementarity, by its own residuals; knows no solver."""
    found = PlanResiduals(scene).of(plan)
    names = (
        "dynamics_defect",
        "start_error",
        "input_bound_excess",
        "velocity_bound_excess",
        "force_sign",
        "complementarity",
    )
    return distance(plan.end, goal_state(scene.task)) <= EXACT and all(
        found.get(name, 0.0) <= EXACT for name in names
    )


def scip(model: Any, seconds: float) -> Any:
    """SCIP by Pyomo. Its log must be off: it deadlocks on 64 KB of it."""
    options = {"display/verblevel": 0, "limits/time": max(seconds, 1e-3), "limits/gap": 0.01 * GAP}
    return SolverFactory("scip_direct").solve(
        model,
        load_solutions=False,
        raise_exception_on_nonoptimal_result=False,
        solver_options=options,
    )

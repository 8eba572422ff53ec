"""The planning problem of any scene with its contact modes fixed: a smooth problem without complementarity, solved by Ipopt.

The same question as `quadratic` answers for linear scenes, at the price of an Ipopt run; its answers are local.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from formulations.ipopt import IpoptResult
from formulations.transcription.build import build_model
from formulations.transcription.contact_laws import ContactLaw, hold_modes
from formulations.transcription.goal import move_ball, open_goal
from formulations.transcription.plans import load_first_guess, load_plan, read_plan
from formulations.transcription.residuals import PlanResiduals
from formulations.transcription.workbench import Account, Workbench
from formulations.windows.stationarity import Stationarity, classify
from models.codegen.kernel import Kernel
from models.scene import Scene
from models.trajectory import Trajectory

_BIACTIVE = 1e-6  # [N] force and separation below which a pair touches without pressing; Ipopt keeps them to 1e-8
_PATIENCE = 50  # most iterations for a neighbour of a plan: it needs 5 to 20


@dataclass(frozen=True, kw_only=True, eq=False)
class NlpAnswer:
    """A local optimum for these modes."""

    closed: np.ndarray
    plan: Trajectory
    phi: np.ndarray
    cost: float
    result: IpoptResult
    of_force: np.ndarray
    of_separation: np.ndarray
    stiffness: np.ndarray

    @property
    def u(self) -> np.ndarray:
        return self.plan.u

    @property
    def dual_infeasibility(self) -> float:
        return self.result.residuals.dual_infeasibility

    def stationarity(self) -> Stationarity:
        """The class of the pairs that touch without pressing."""
        return classify(self.of_force, self.of_separation, self._biactive())

    @property
    def pull(self) -> np.ndarray:
        """(steps, nc) what holds a touching pair in its mode, 0 elsewhere: where it is negative the other mode is cheaper."""
        return np.where(self._biactive(), np.minimum(0.0, np.minimum(self.of_force, self.of_separation)), 0.0)

    def _biactive(self) -> np.ndarray:
        lam, separation = self.plan.lam, self.plan.lam - self.stiffness * self.phi
        biactive = (lam <= _BIACTIVE) & (separation <= _BIACTIVE)
        biactive[:1] = False  # the start is no choice
        return biactive


class NonlinearModes:
    """One model, whose modes are moved by bounds. guess: the plan that the first solve starts from."""

    def __init__(self, scene: Scene, kernel: Kernel, ball: float, account: Account, options: Mapping[str, Any]) -> None:
        self._scene, self._kernel = scene, kernel
        # The bound is never used: products are switched off as soon as modes are held.
        model = build_model(scene, ContactLaw.COMPLEMENTARITY, eps=1.0 if scene.nc else None)
        open_goal(model, ball)
        self._bench, self._residuals = Workbench(model), PlanResiduals(scene)
        self.begin(ball, account, options)

    def begin(self, ball: float, account: Account, options: Mapping[str, Any]) -> None:
        """As if built anew; ball: positive if it was built with one, else 0."""
        move_ball(self._bench.model, ball)
        self._account, self._options = account, {**options, "bound_relax_factor": 0.0}
        self.guess: Trajectory | None = None
        self.solves, self.unsolved = 0, 0

    def solve(self, closed: np.ndarray, *, near: NlpAnswer | None = None, below: float = np.inf) -> NlpAnswer | None:
        """The optimum near the plan of `near`, or None where none was found that costs less than `below`."""
        model, scene = self._bench.model, self._scene
        guess = self.guess if near is None else near.plan
        closed = np.array(closed, dtype=bool)
        if scene.nc:
            closed[0] = self._kernel.penetration(np.array([scene.task.start[: scene.nq]]))[0] > 0.0
        if guess is None:
            load_first_guess(model)
        else:
            load_plan(model, guess)
        if scene.nc:
            hold_modes(model, closed)
        self.solves += 1
        most = self._options["max_iter"] if near is None else min(self._options["max_iter"], _PATIENCE)
        result = self._bench.run(self._account, {**self._options, "max_iter": self._account.iterations + most})
        if not result.solved:
            self.unsolved += 1
            return None
        plan = read_plan(model)
        cost = self._residuals.cost(plan)
        if not cost < below:
            return None
        slope = self._slope(result)
        phi = self._kernel.penetration(plan.q[:-1])
        return NlpAnswer(
            closed=closed,
            plan=plan,
            phi=phi,
            cost=cost,
            result=result,
            of_force=slope[0],
            of_separation=slope[1],
            stiffness=self._kernel.stiffness(),
        )

    def _slope(self, result: IpoptResult) -> np.ndarray:
        """(2, steps, nc) derivative of the Lagrangian without its bounds, by lam and by v = lam - k phi: the multipliers of their bounds."""
        model, problem = self._bench.model, self._bench.problem(self._account)
        if not self._scene.nc:
            return np.zeros((2, self._scene.task.steps, 0))
        place = {id(variable): column for column, variable in enumerate(problem.variables)}
        rows, columns = problem.jacobianstructure()
        slope = problem.gradient(result.x) + np.bincount(columns, problem.jacobian(result.x) * result.lagrange[rows], problem.n)
        lam = [place[id(variable)] for variable in model.variable_lam.values()]
        separation = [place[id(pair.v)] for pair in model.complementarity_contact.values()]
        return slope[np.array([lam, separation])].reshape(2, -1, self._scene.nc)

"""A single shooting method opened on a scene: the kernel is loaded once and serves every eps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from time import perf_counter
from typing import Generic, TypeVar

import numpy as np

from formulations.grids import plan_of
from formulations.method import Clock, Method, Session
from formulations.shooting.descent import Descent, descend
from formulations.shooting.objective import Loss, Objective, Weights, noise
from formulations.shooting.options import DescentOptions, LbfgsOptions
from formulations.shooting.quasi_newton import minimise as quasi_newton
from formulations.shooting.stage import arrived, given_inputs, measure_growth, plan_residuals, stage_seconds, with_growth
from formulations.solution import Outcome, Solution
from models.codegen.kernel import load_kernel
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw
from models.scene import Scene
from models.trajectory import Trajectory

__all__ = ["ShootingSession", "descend", "noise", "quasi_newton"]

_Options = TypeVar("_Options", bound=DescentOptions | LbfgsOptions)


class ShootingSession(Session, Generic[_Options]):
    """One method on one scene.

    clock: of the opening; law: the contact law of the rollouts; minimise: from a loss, inputs u0 (steps, nu), options and a time limit in wall seconds
    to the best inputs; loss: None for the paper's; noise: at an eps, what the loss is averaged over (samples, steps, nu), if it is.
    """

    def __init__(
        self,
        method: Method,
        scene: Scene,
        options: _Options,
        clock: Clock,
        *,
        law: ContactLaw,
        minimise: Callable[[Objective, np.ndarray, _Options, float], Descent],
        loss: Loss | None = None,
        noise: Callable[[float], np.ndarray] | None = None,
    ) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._law, self._minimise, self._loss, self._noise = law, minimise, loss, noise
        self._kernel, self._steps = load_kernel(scene), load_steps(scene)
        self._clock = clock
        clock.stop()

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        """Descend from the inputs of the warm start. Raises TrajectoryError for a plan of another scene or grid."""
        stage = Clock()
        self._method.check_stage(eps, time_limit)
        objective = self._objective(eps)
        u0 = given_inputs(self._scene, warm_start)
        descending = perf_counter()
        descent = self._minimise(objective, u0, self._options, time_limit)
        evaluating, descending = objective.seconds, perf_counter() - descending
        solution = self._solution(descent, u0, objective.eps)
        return replace(solution, seconds=stage_seconds(stage, self._clock, evaluating, descending))

    def _objective(self, eps: float | None) -> Objective:
        """The loss at this eps: of the softplus law, or of the noise."""
        return Objective(
            self._kernel,
            law=self._law,
            eps=eps if self._law is ContactLaw.SOFTPLUS else None,
            weights=Weights(terminal=self._options.terminal_weight, running=self._options.input_weight),
            loss=self._loss,
            noise=None if self._noise is None or eps is None else self._noise(eps),
        )

    def _solution(self, descent: Descent, u0: np.ndarray, eps: float | None) -> Solution:
        """The plan simulated once more by the kernel, and its residuals recomputed from that; without a plan, the growth at the first guess."""
        law, task = self._law, self._scene.task
        empty = Solution(
            method=self._method.name,
            outcome=descent.outcome,
            message=descent.message,
            iterations=descent.iterations,
            options=asdict(self._options),
            history={column: tuple(values) for column, values in descent.history.items()},
        )
        u = u0 if descent.u is None else descent.u
        plan = self._kernel.rollout(np.array(task.start), u, task.step, law, eps)
        growth = None if plan.diverged else measure_growth(self._steps, np.hstack([plan.q, plan.v]), u, law, eps)
        if descent.u is None:
            return empty if growth is None else replace(empty, message=with_growth(descent.message, growth), residuals=growth.residuals())
        if plan.diverged:  # impossible while the kernel is deterministic: the descent has just evaluated these inputs
            return replace(empty, outcome=Outcome.EVALUATION_ERROR, message="the plan could not be simulated again.")
        trajectory = plan_of(self._scene, plan, u)
        residuals = {
            "gradient_norm": descent.gradient_norm,
            **plan_residuals(self._scene, trajectory),
            **({} if growth is None else growth.residuals()),
        }
        outcome, message = arrived(self._scene, descent.outcome, descent.message, residuals)
        return replace(
            empty,
            outcome=outcome,
            message=message if outcome is Outcome.SOLVED or growth is None else with_growth(message, growth),
            trajectory=trajectory,
            cost=self._kernel.cost(plan.q, plan.v, u),
            residuals=residuals,
        )

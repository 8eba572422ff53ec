"""A single shooting method opened on a scene; the kernel serves every eps."""

from __future__ import annotations

from dataclasses import asdict, replace
from time import perf_counter

import numpy as np

from formulations.grids import plan_of
from formulations.method import Clock, Method, Session
from formulations.shooting.descent import Descent, descend
from formulations.shooting.objective import Objective, Weights
from formulations.shooting.options import DescentOptions, QuasiNewtonOptions
from formulations.shooting.quasi_newton import minimise
from formulations.shooting.rollout import Loss
from formulations.shooting.stage import (
    arrived,
    given_inputs,
    measure_growth,
    plan_residuals,
    stage_seconds,
    with_growth,
)
from formulations.solution import Outcome, Solution
from models.codegen.kernel import load_kernel
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw
from models.scene import Scene
from models.trajectory import Trajectory


class ShootingSession(Session):
    """One method on one scene; `loss` is a custom loss, or None for the paper's."""

    def __init__(
        self,
        method: Method,
        scene: Scene,
        options: DescentOptions | QuasiNewtonOptions,
        clock: Clock,
        law: ContactLaw,
        loss: Loss | None,
    ) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._law, self._loss = law, loss
        self._kernel, self._steps = load_kernel(scene), load_steps(scene)
        self._clock = clock

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Descend from the inputs of the warm start.

        Raises TrajectoryError for another scene or grid.
        """
        stage = Clock()
        self._method.check_stage(eps, time_limit)
        u0, options = given_inputs(self._scene, warm_start), self._options
        weights = Weights(terminal=options.terminal_weight, running=options.input_weight)
        objective = Objective(
            self._kernel, law=self._law, eps=eps, weights=weights, loss=self._loss
        )
        descending = perf_counter()
        if isinstance(options, DescentOptions):
            descent = descend(objective, u0, options, time_limit)
        else:
            descent = minimise(objective, u0, options, time_limit)
        evaluating, descending = objective.seconds, perf_counter() - descending
        solution = self._solution(descent, u0, eps)
        return replace(solution, seconds=stage_seconds(stage, self._clock, evaluating, descending))

    def _solution(self, descent: Descent, u0: np.ndarray, eps: float | None) -> Solution:
        """Return the plan simulated again with its residuals.

        Without a plan the growth at the first guess.
        """
        task, law = self._scene.task, self._law
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
        growth = (
            None
            if plan.diverged
            else measure_growth(self._steps, np.hstack([plan.q, plan.v]), u, law, eps)
        )
        if descent.u is None:
            return (
                empty
                if growth is None
                else replace(
                    empty,
                    message=with_growth(descent.message, growth),
                    residuals=growth.residuals(),
                )
            )
        if plan.diverged:  # a custom loss can be finite on a diverged motion
            return replace(
                empty,
                outcome=Outcome.EVALUATION_ERROR,
                message="the plan could not be simulated again.",
            )
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
            message=message
            if outcome is Outcome.SOLVED or growth is None
            else with_growth(message, growth),
            trajectory=trajectory,
            cost=self._kernel.cost(plan.q, plan.v, u),
            residuals=residuals,
        )

"""The base of both multiple shooting methods; each file of a method adds its contact law."""

from __future__ import annotations

from dataclasses import asdict, replace
from time import perf_counter

import numpy as np

from formulations.grids import input_bounds, plan_of
from formulations.method import Clock, Method, Session
from formulations.multiple_shooting.solver import (
    Costs,
    MultipleShootingOptions,
    Solver,
    SolverResult,
)
from formulations.shooting.stage import (
    arrived,
    given_inputs,
    measure_growth,
    plan_residuals,
    stage_seconds,
)
from formulations.solution import Solution
from models.codegen.kernel import load_kernel
from models.codegen.steps import load_steps
from models.contact_law import ContactLaw
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid


class MultipleShootingSession(Session):
    """Multiple shooting on one scene; its compiled steps serve every eps."""

    def __init__(
        self,
        method: MultipleShootingMethod,
        scene: Scene,
        options: MultipleShootingOptions,
        clock: Clock,
    ) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._kernel, self._steps, self._costs = load_kernel(scene), load_steps(scene), Costs(scene)
        self._clock = clock

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Shoot from the nodes of the warm start.

        Raises TrajectoryError for another scene or grid.
        """
        stage, started = Clock(), perf_counter()
        self._method.check_stage(eps, time_limit)
        x, u = self._first_guess(warm_start)
        solver = Solver(
            steps=self._steps,
            costs=self._costs,
            law=self._method.law,
            eps=eps,
            options=self._options,
        )
        solving = perf_counter()
        result = solver.solve(x, u, started + time_limit)
        solving = perf_counter() - solving
        solution = self._solution(result, eps)
        return replace(
            solution, seconds=stage_seconds(stage, self._clock, solver.evaluate_seconds, solving)
        )

    def _first_guess(self, warm_start: Trajectory | None) -> tuple[np.ndarray, np.ndarray]:
        task = self._scene.task
        start = np.array(task.start)
        u = np.clip(given_inputs(self._scene, warm_start), *input_bounds(self._scene))
        if warm_start is not None:
            x = np.hstack([warm_start.q, warm_start.v])
        else:
            end = [
                begin if goal is None or self._options.guess == "start" else goal
                for begin, goal in zip(start, task.goal, strict=True)
            ]
            x = start + np.linspace(0.0, 1.0, task.steps + 1)[:, None] * (np.array(end) - start)
        x[0] = start
        return x, u

    def _solution(self, result: SolverResult, eps: float | None) -> Solution:
        """Return the motion of the inputs as plan, or the nodes if there are gaps between them."""
        scene, task, law = self._scene, self._scene.task, self._method.law
        base = {
            "method": self._method.name,
            "iterations": result.iterations,
            "options": asdict(self._options),
            "history": {column: tuple(values) for column, values in result.history.items()},
        }
        if not result.outcome.has_answer:
            return Solution(outcome=result.outcome, message=f"{result.message}.", **base)
        nq, u = scene.nq, result.u
        run = self._kernel.rollout(np.array(task.start), u, task.step, law, eps)
        if run.diverged or result.gap > self._options.gap_tolerance:
            linear = self._steps.linearise(result.x[:-1], u, task.step, law, eps)
            lam = np.zeros((task.steps, scene.nl)) if linear is None else linear.lam
            plan = Trajectory(
                t=uniform_grid(task.step, task.steps),
                q=result.x[:, :nq],
                v=result.x[:, nq:],
                u=u,
                lam=lam,
                scheme=Scheme.SEMI_IMPLICIT_EULER,
            )
        else:
            plan = plan_of(scene, run, u)
        growth = measure_growth(self._steps, np.hstack([plan.q, plan.v]), u, law, eps)
        residuals = {
            "gap": result.gap,
            "promised_decrease": max(0.0, -result.slope),
            **plan_residuals(scene, plan),
            **({} if growth is None else growth.residuals()),
        }
        outcome, message = result.outcome, result.message
        open_gap = (
            f"the nodes are up to {result.gap:.2g} apart from the motion"
            if result.gap > self._options.gap_tolerance
            else ""
        )
        message = "; ".join(part for part in (message, open_gap) if part)
        outcome, message = arrived(
            scene,
            outcome,
            f"{message}." if message else "",
            residuals,
            "a larger goal_weight or more iterations",
        )
        return Solution(
            outcome=outcome,
            message=message,
            trajectory=plan,
            cost=self._kernel.cost(plan.q, plan.v, u),
            residuals=residuals,
            **base,
        )


class MultipleShootingMethod(Method[MultipleShootingOptions]):
    """Multiple shooting under one contact law."""

    law: ContactLaw
    options = MultipleShootingOptions

    def session(self, scene: Scene, options: MultipleShootingOptions, clock: Clock) -> Session:
        """Open a session."""
        return MultipleShootingSession(self, scene, options, clock)

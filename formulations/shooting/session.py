"""A gradient method opened on a scene: the kernel is loaded once and serves every eps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter, process_time
from typing import cast

import numpy as np

from formulations.method import OptionError, Session
from formulations.shooting.descent import Descent, Settings, descend
from formulations.shooting.method import DescentMethod
from formulations.shooting.objective import Objective, Weights
from formulations.solution import Outcome, Seconds, Solution
from models.codegen.kernel import load_kernel
from models.errors import TrajectoryError
from models.goal import goal_state, miss
from models.scene import Scene
from models.trajectory import Trajectory, uniform_grid


class DescentSession(Session):
    """See the module docstring.

    options: filled in and checked by the method; opening: wall and CPU clock when opening began, before PyTorch was imported.
    """

    def __init__(self, method: DescentMethod, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> None:
        self._method, self._scene, self._options = method, scene, dict(options)
        self._kernel = load_kernel(scene)
        self._weights = Weights(terminal=_number(options["terminal_weight"]), running=_number(options["input_weight"]))
        iterations = options["iterations"]
        self._settings = Settings(
            learning_rate=_number(options["learning_rate"]),
            iterations=None if iterations is None else int(_number(iterations)),
            max_iterations=int(_number(options["max_iterations"])),
            tolerance=_number(options["tolerance"]),
        )
        # The first stage pays for building; the stages after it find it done.
        self._opening = (perf_counter() - opening[0], process_time() - opening[1])

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        started, cpu = perf_counter(), process_time()
        self._method.check_eps(eps)
        if not time_limit > 0.0:
            raise OptionError(f"method {self._method.name}: the time limit is {time_limit!r}, but must be a positive number of seconds.")
        objective = Objective(self._kernel, law=self._method.law, eps=eps, weights=self._weights)
        u0 = self._first_guess(warm_start)
        descending = perf_counter()
        descent = descend(objective, u0, self._settings, time_limit)
        rest = perf_counter() - descending - objective.evaluate_seconds
        opening_wall, opening_cpu = self._opening
        self._opening = (0.0, 0.0)
        seconds = Seconds(
            build=opening_wall,
            evaluate=objective.evaluate_seconds,
            linear_algebra=max(0.0, rest),
            wall=opening_wall + perf_counter() - started,
            cpu=opening_cpu + process_time() - cpu,
        )
        return replace(self._solution(descent, eps), seconds=seconds)

    def _first_guess(self, warm_start: Trajectory | None) -> np.ndarray:
        """Inputs (steps, nu) of the warm start, or zeros."""
        task = self._scene.task
        if warm_start is None:
            return np.zeros((task.steps, self._scene.nu))
        warm_start.check_fits(self._scene)
        grid = uniform_grid(task.step, task.steps)
        if warm_start.steps != task.steps or not np.allclose(warm_start.t - warm_start.t[0], grid, rtol=1e-9, atol=1e-9 * task.step):
            raise TrajectoryError(
                f"warm start: it has {warm_start.steps} steps over {warm_start.t[-1] - warm_start.t[0]:g} s, but scene {self._scene.name} has "
                f"{task.steps} steps of {task.step:g} s; resample it to that grid."
            )
        return np.array(warm_start.u)

    def _solution(self, descent: Descent, eps: float | None) -> Solution:
        """The plan simulated once more by the kernel, and its figures recomputed from that."""
        name, law, task = self._method.name, self._method.law, self._scene.task
        history = {column: tuple(values) for column, values in descent.history.items()}
        empty = Solution(
            method=name,
            outcome=descent.outcome,
            message=descent.message,
            iterations=descent.iterations,
            options=dict(self._options),
            history=history,
        )
        if descent.u is None:
            return empty
        u = descent.u
        plan = self._kernel.rollout(np.array(task.start), u, task.step, law, eps)
        if plan.diverged:  # impossible while the kernel is deterministic: the descent has just evaluated these inputs
            return replace(empty, outcome=Outcome.EVALUATION_ERROR, message="the plan could not be simulated again.")
        error = miss(np.concatenate([plan.q[-1], plan.v[-1]]), goal_state(task))
        lower, upper = np.array([item.lower for item in self._scene.inputs]), np.array([item.upper for item in self._scene.inputs])
        residuals = {
            "gradient_norm": descent.gradient_norm,
            "terminal_error": float(np.linalg.norm(error)),
            "terminal_position_error": float(np.linalg.norm(error[: self._scene.nq])),
            "input_bound_excess": float(np.maximum(np.maximum(lower - u, u - upper), 0.0).max(initial=0.0)),
        }
        if any(coordinate.has_velocity_bounds for coordinate in self._scene.coordinates):
            slowest = np.array([coordinate.velocity_lower for coordinate in self._scene.coordinates])
            fastest = np.array([coordinate.velocity_upper for coordinate in self._scene.coordinates])
            residuals["velocity_bound_excess"] = float(
                np.maximum(np.maximum(slowest - plan.v[:-1], plan.v[:-1] - fastest), 0.0).max(initial=0.0)
            )
        outcome, message = self._arrival(descent.outcome, descent.message, residuals)
        missed = f" The goal is missed by {residuals['terminal_error']:.3g} in the plan's own contact model." if task.has_goal else ""
        return replace(
            empty,
            outcome=outcome,
            message=f"{message}{missed}",
            trajectory=Trajectory(t=uniform_grid(task.step, task.steps), q=plan.q, v=plan.v, u=u, lam=plan.lam),
            cost=self._kernel.cost(plan.q, plan.v, u),
            residuals=residuals,
        )

    def _arrival(self, outcome: Outcome, message: str, residuals: Mapping[str, float]) -> tuple[Outcome, str]:
        """Whoever converged away from the goal has not solved the task: the loss weighs the goal against the inputs."""
        for name in ("terminal_position_error", "terminal_error"):
            limit = self._scene.limit(f"discrete_{name}")
            if outcome is Outcome.SOLVED and limit is not None and residuals[name] > limit.value:
                advice = f"the scene asks for {limit.value:g}; a larger terminal_weight brings it nearer"
                return Outcome.STALLED, f"{message} It converged away from the goal: {name} is {residuals[name]:.3g}, {advice}."
        return outcome, message


def _number(value: object) -> float:
    return float(cast(float, value))  # checked by filled_options

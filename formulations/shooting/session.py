"""A single shooting method opened on a scene: the kernel is loaded once and serves every eps."""

from __future__ import annotations

from dataclasses import asdict, replace
from time import perf_counter, process_time

import numpy as np

from formulations.method import OptionError, Session
from formulations.shooting.descent import Descent
from formulations.shooting.ending import arrived, given_inputs, plan_residuals
from formulations.shooting.growth import measure_growth, told
from formulations.shooting.method import DescentOptions, LbfgsOptions, ShootingMethod
from formulations.solution import Outcome, Seconds, Solution
from models.codegen.kernel import load_kernel, load_steps
from models.contact_law import ContactLaw
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid


class ShootingSession(Session):
    """See the module docstring.

    opening: wall and CPU clock when opening began.
    """

    def __init__(self, method: ShootingMethod, scene: Scene, options: DescentOptions | LbfgsOptions, opening: tuple[float, float]) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._kernel, self._steps = load_kernel(scene), load_steps(scene)
        # The first stage pays for building; the stages after it find it done.
        self._opening = (perf_counter() - opening[0], process_time() - opening[1])

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        started, cpu = perf_counter(), process_time()
        self._method.check_eps(eps)
        if not time_limit > 0.0:
            raise OptionError(f"method {self._method.name}: the time limit is {time_limit!r}, but must be a positive number of seconds.")
        objective = self._method.objective(self._kernel, eps, self._options)
        u0 = given_inputs(self._scene, warm_start)
        descending = perf_counter()
        descent = self._method.minimise(objective, u0, self._options, time_limit)
        rest = perf_counter() - descending - objective.seconds
        solution = self._solution(descent, u0, eps if self._method.law is ContactLaw.SOFTPLUS else None)
        opening_wall, opening_cpu = self._opening
        self._opening = (0.0, 0.0)
        seconds = Seconds(
            build=opening_wall,
            evaluate=objective.seconds,
            linear_algebra=max(0.0, rest),
            wall=opening_wall + perf_counter() - started,
            cpu=opening_cpu + process_time() - cpu,
        )
        return replace(solution, seconds=seconds)

    def _solution(self, descent: Descent, u0: np.ndarray, eps: float | None) -> Solution:
        """The plan simulated once more by the kernel, and its figures recomputed from that; without a plan, the growth at the first guess."""
        law, task = self._method.law, self._scene.task
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
            return empty if growth is None else replace(empty, message=told(descent.message, growth), residuals=growth.figures())
        if plan.diverged:  # impossible while the kernel is deterministic: the descent has just evaluated these inputs
            return replace(empty, outcome=Outcome.EVALUATION_ERROR, message="the plan could not be simulated again.")
        trajectory = Trajectory(
            t=uniform_grid(task.step, task.steps), q=plan.q, v=plan.v, u=u, lam=plan.lam, scheme=Scheme.SEMI_IMPLICIT_EULER
        )
        residuals = {
            "gradient_norm": descent.gradient_norm,
            **plan_residuals(self._scene, trajectory),
            **({} if growth is None else growth.figures()),
        }
        outcome, message = arrived(self._scene, descent.outcome, descent.message, residuals)
        return replace(
            empty,
            outcome=outcome,
            message=message if outcome is Outcome.SOLVED or growth is None else told(message, growth),
            trajectory=trajectory,
            cost=self._kernel.cost(plan.q, plan.v, u),
            residuals=residuals,
        )

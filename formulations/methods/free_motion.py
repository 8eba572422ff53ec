"""The motion of a scene without inputs, by its time step and true contact."""

from __future__ import annotations

import numpy as np

from formulations.grids import plan_of
from formulations.method import Clock, Kind, Method, Options, Session
from formulations.solution import Outcome, Seconds, Solution
from models.codegen.kernel import Kernel, load_kernel
from models.scene import Scene
from models.scene.goal import distance, goal_state
from models.trajectory import Trajectory


class _FreeMotionSession(Session):
    def __init__(self, method: FreeMotion, kernel: Kernel) -> None:
        self._method, self._kernel = method, kernel

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        self._method.check_eps(eps)
        scene, task = self._kernel.scene, self._kernel.scene.task
        if warm_start is not None:
            warm_start.check_fits(scene)
        clock = Clock()
        u = np.zeros((task.steps, 0))
        motion = self._kernel.rollout(np.array(task.start), u, task.step)
        clock.stop()
        wall, cpu = clock.pay()
        seconds = Seconds(evaluate=wall, wall=wall, cpu=cpu)
        if motion.diverged:
            message = f"the time step of {task.step:g} s let the motion grow without bound by step {motion.finite_steps}; use a smaller one."
            return Solution(
                method=self._method.name, outcome=Outcome.DIVERGED, message=message, seconds=seconds
            )
        plan = plan_of(scene, motion, u)
        return Solution(
            method=self._method.name,
            outcome=Outcome.SOLVED,
            trajectory=plan,
            cost=self._kernel.cost(motion.q, motion.v, u),
            iterations=1,
            seconds=seconds,
            residuals={"terminal_error": distance(plan.end, goal_state(task))},
        )


class FreeMotion(Method):
    """The motion of a scene without inputs."""

    name = "free_motion"
    title = "Free motion of a scene without inputs"
    kind = Kind.DIRECT
    needs_eps = False

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes with inputs."""
        return (
            f"scene {scene.name} has inputs, so its motion is to be planned." if scene.nu else None
        )

    def session(self, scene: Scene, options: Options, clock: Clock) -> Session:
        """Open a session with the compiled time step."""
        return _FreeMotionSession(self, load_kernel(scene))


METHOD = FreeMotion()

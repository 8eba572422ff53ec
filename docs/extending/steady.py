"""Single shooting with one constant input for the whole horizon."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy.optimize import minimize

from formulations.grids import check_warm_start, plan_of
from formulations.method import Clock, Kind, Method, Options, Session, option, without_inputs
from formulations.solution import Outcome, Seconds, Solution
from models.codegen.kernel import Kernel, load_kernel
from models.scene import Scene
from models.scene.goal import distance, goal_state
from models.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class SteadyOptions(Options):
    """Options of `steady`."""

    miss: float = option(
        1e-6, "solved only if the plan ends this near to the goal, in (q, v)", lower=0.0
    )


class _SteadySession(Session):
    def __init__(self, method: Steady, kernel: Kernel, options: SteadyOptions) -> None:
        self._method, self._kernel, self._options = method, kernel, options

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        self._method.check_stage(eps, time_limit)
        kernel, scene, task = self._kernel, self._kernel.scene, self._kernel.scene.task
        check_warm_start(scene, warm_start)
        clock = Clock()

        def rolled(push):
            u = np.tile(push, (task.steps, 1))
            return u, kernel.rollout(np.array(task.start), u, task.step)

        def miss(push):
            _, motion = rolled(push)
            return distance(np.concatenate([motion.q[-1], motion.v[-1]]), goal_state(task))

        first = np.zeros(scene.nu) if warm_start is None else warm_start.u.mean(axis=0)
        found = minimize(
            lambda push: miss(push) ** 2,
            first,
            method="Nelder-Mead",
            options={"xatol": 1e-10, "fatol": 1e-16},
        )
        u, motion = rolled(found.x)
        clock.stop()
        wall, cpu = clock.pay()
        return Solution(
            method=self._method.name,
            outcome=Outcome.SOLVED if miss(found.x) < self._options.miss else Outcome.STALLED,
            trajectory=plan_of(scene, motion, u),
            cost=kernel.cost(motion.q, motion.v, u),
            iterations=found.nit,
            options=asdict(self._options),
            residuals={"terminal_error": miss(found.x)},
            seconds=Seconds(evaluate=wall, wall=wall, cpu=cpu),
        )


class Steady(Method[SteadyOptions]):
    """One constant input."""

    name, title = "steady", "One constant input"
    # DIRECT: the exact contact law. An INDIRECT method relaxes it and may violate it.
    kind = Kind.DIRECT
    needs_eps = False
    options = SteadyOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes without inputs."""
        return without_inputs(scene, "hold")

    def session(self, scene: Scene, options: SteadyOptions, clock: Clock) -> Session:
        """Open a session with the compiled time step."""
        return _SteadySession(self, load_kernel(scene), options)


METHOD = Steady()

"""`global` opened on a scene: the proof, and what it says as a Solution."""

from __future__ import annotations

from time import perf_counter, process_time

import numpy as np

from formulations.method import Method, OptionError, Session
from formulations.proof.prove import Proof, ProofStatus, prove
from formulations.solution import Bound, Outcome, Seconds, Solution
from formulations.transcription.residuals import PlanResiduals
from models.errors import TrajectoryError
from models.scene import Scene
from models.trajectory import Trajectory, uniform_grid

_OUTCOMES = {
    ProofStatus.OPTIMAL: Outcome.SOLVED,
    ProofStatus.BOUND: Outcome.TIME_LIMIT,
    ProofStatus.INFEASIBLE: Outcome.INFEASIBLE,
    ProofStatus.NOTHING: Outcome.TIME_LIMIT,
}


class ProofSession(Session):
    def __init__(self, method: Method, scene: Scene, seconds: float, opening: tuple[float, float]) -> None:
        self._method, self._scene, self._seconds = method, scene, seconds
        self._opening = (perf_counter() - opening[0], process_time() - opening[1])

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        self._method.check_eps(eps)
        if not time_limit > 0.0:
            raise OptionError(f"method {self._method.name}: the time limit is {time_limit!r}, but must be a positive number of seconds.")
        if warm_start is not None:
            self._check_grid(warm_start)
        (build, build_cpu), self._opening = self._opening, (0.0, 0.0)
        seconds = min(time_limit, self._seconds)
        proof = prove(self._scene, incumbent=warm_start, time_limit=seconds)
        return Solution(
            method=self._method.name,
            outcome=_OUTCOMES[proof.status],
            message=proof.sentence,
            trajectory=proof.plan,
            cost=proof.cost,
            iterations=proof.nodes,
            seconds=Seconds(build=build, linear_algebra=proof.seconds, wall=build + proof.seconds, cpu=build_cpu + proof.cpu),
            residuals={} if proof.plan is None else PlanResiduals(self._scene).of(proof.plan),
            options={"seconds": self._seconds},
            solver=proof.solver,
            history={
                name: (value,) for name, value in (("cost", proof.cost), ("bound", proof.bound)) if value is not None and np.isfinite(value)
            },
            bound=_bound(proof),
        )

    def _check_grid(self, plan: Trajectory) -> None:
        plan.check_fits(self._scene)
        task = self._scene.task
        if plan.steps != task.steps or not np.allclose(
            plan.t - plan.t[0], uniform_grid(task.step, task.steps), rtol=1e-9, atol=1e-9 * task.step
        ):
            raise TrajectoryError(
                f"warm start: it has {plan.steps} steps over {plan.t[-1] - plan.t[0]:g} s, but scene {self._scene.name} has {task.steps} steps of "
                f"{task.step:g} s; resample it to that grid."
            )


def _bound(proof: Proof) -> Bound | None:
    if not np.isfinite(proof.bound):
        return None
    return Bound(
        value=proof.bound,
        gap=proof.gap,
        proved=proof.status is ProofStatus.OPTIMAL,
        decisions=proof.pairs,
        open_decisions=proof.binaries,
        nodes=proof.nodes,
    )

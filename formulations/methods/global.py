"""The global optimum, proved: one binary variable a contact and step, for linear scenes with few enough of them.

The plan given is the incumbent, the proof says how much cheaper a plan could be at most.
"""
# ruff: noqa: N999 - a method's file is named like the method; nobody writes `import global`

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from formulations.grids import check_warm_start
from formulations.method import Clock, Kind, Method, Options, Session, option, without_inputs
from formulations.solution import Seconds, Solution
from formulations.transcription.residuals import PlanResiduals
from models.scene import Scene
from models.trajectory import Trajectory

# Contact decisions beyond which nothing is begun: 38 of three carts (20 steps) are proved in
# seconds, 98 (50 steps) leave most of the gap open.
_MOST = 60


@dataclass(frozen=True, kw_only=True)
class GlobalOptions(Options):
    """Options of `global`."""

    seconds: float = option(
        200.0, "time after which the best bound is reported", unit="s", lower=1e-3, upper=1e7
    )


class GlobalSession(Session):
    """A proof each time it is asked: nothing is shared between stages."""

    def __init__(self, method: Global, scene: Scene, options: GlobalOptions, clock: Clock) -> None:
        from formulations.proof import (
            prove,
        )  # imports Pyomo: 0.9 s that planning a campaign does without

        self._method, self._scene, self._options, self._prove = method, scene, options, prove
        self._clock = clock

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Prove a bound; warm_start: the incumbent.

        Raises TrajectoryError for a plan of another scene or grid.
        """
        self._method.check_stage(eps, time_limit)
        check_warm_start(self._scene, warm_start)
        build, build_cpu = self._clock.pay()
        proof = self._prove(
            self._scene, incumbent=warm_start, time_limit=min(time_limit, self._options.seconds)
        )
        return Solution(
            method=self._method.name,
            outcome=proof.outcome,
            message=proof.sentence,
            trajectory=proof.plan,
            cost=proof.cost,
            iterations=proof.nodes,
            seconds=Seconds(
                build=build,
                linear_algebra=proof.seconds,
                wall=build + proof.seconds,
                cpu=build_cpu + proof.cpu,
            ),
            residuals={} if proof.plan is None else PlanResiduals(self._scene).of(proof.plan),
            options=asdict(self._options),
            solver=proof.solver,
            history={
                name: (value,)
                for name, value in (("cost", proof.cost), ("bound", proof.bound))
                if value is not None and np.isfinite(value)
            },
            bound=proof.known_bound,
        )


class Global(Method[GlobalOptions]):
    """A bound below which no plan costs, by branch and bound."""

    name = "global"
    title = "Global optimum by branch and bound"
    kind = Kind.DIRECT
    needs_eps = False
    options = GlobalOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes whose modes do not leave a convex quadratic program, with too many contact decisions, or without SCIP."""
        if not scene.inputs:
            return without_inputs(scene, "plan")
        decisions = scene.nc * (scene.task.steps - 1)
        if decisions > _MOST:
            return (
                f"scene {scene.name} has {decisions} contact decisions ({scene.nc} a step), and a proof is tried up to {_MOST}; "
                "`python -m benchmarks proof` in a checkout says what is reached beyond."
            )
        from formulations.proof import missing_solver, why_no_proof

        return why_no_proof(scene) or missing_solver()

    def session(self, scene: Scene, options: GlobalOptions, clock: Clock) -> Session:
        """Open a session, which imports Pyomo."""
        return GlobalSession(self, scene, options, clock)


METHOD = Global()

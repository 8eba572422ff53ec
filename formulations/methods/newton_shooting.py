"""Single shooting on true contact: correct inputs by damped Newton steps to end on the goal.

From a cold start random pushes that end close to the goal are corrected, and the cheapest of the
first that arrive is improved and kept. Contact modes, friction and damping need no unknowns.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from time import monotonic

from formulations.grids import check_warm_start, plan_of, replayed_goal_error
from formulations.method import Clock, Kind, Method, Options, Session, option, without_inputs
from formulations.shooting.stage import plan_residuals, stage_seconds
from formulations.shots import (
    Shot,
    allowed_miss,
    cheaper,
    corrected,
    nearest_pushes,
    off_the_edge,
)
from formulations.solution import Outcome, Solution, checked
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.trajectory import Trajectory

_ON_EDGE = "Its motion depends on rounding: contact begins exactly between two modes."


@dataclass(frozen=True, kw_only=True)
class NewtonShootingOptions(Options):
    """Options of `newton_shooting`."""

    pushes: int = option(
        320,
        "random pushes of a cold start, and where the plan given cannot be corrected",
        lower=1,
        upper=10**6,
    )
    corrections: int = option(
        48, "most of these pushes that are corrected, the nearest first", lower=1, upper=10**6
    )
    plans: int = option(
        4, "corrected motions among which the cheapest is kept", lower=1, upper=10**6
    )
    seed: int = option(0, "of the random pushes", lower=0)
    plan_tolerance: float = option(
        1e-6, "solved only if velocities keep their bounds to this [m/s, rad/s]", lower=0.0
    )


class NewtonShootingSession(Session):
    """The session of `newton_shooting`."""

    def __init__(
        self, method: NewtonShooting, scene: Scene, options: NewtonShootingOptions, clock: Clock
    ) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._kernel, self._near, self._clock = load_kernel(scene), allowed_miss(scene), clock

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Correct the inputs of the warm start, or random pushes.

        Raises TrajectoryError for a plan of another scene or grid.
        """
        self._method.check_stage(eps, time_limit)
        check_warm_start(self._scene, warm_start)
        stage, began = Clock(), monotonic()
        ends = began + time_limit
        shots = self._shots(warm_start, ends)
        arrived = [shot for shot in shots if shot.has_arrived]
        if arrived:
            cheapest = min(arrived, key=lambda shot: shot.cost)
            scene, kernel, near = self._scene, self._kernel, self._near
            best, steps = cheaper(scene, kernel, cheapest, near, lambda: monotonic() >= ends)
            settled = off_the_edge(scene, kernel, best, near)
            best = best if settled is None else settled
            words = f"{len(arrived)} of {len(shots)} inputs were corrected to end near the goal; {steps} steps made the cheapest cheaper."
            outcome = Outcome.SOLVED
            if settled is None:
                outcome, words = Outcome.STALLED, f"{words} {_ON_EDGE}"
        else:
            best, steps = min(shots, key=lambda shot: shot.missed, default=None), 0
            words = f"none of {len(shots)} inputs could be corrected to end near the goal."
            outcome = Outcome.TIME_LIMIT if monotonic() >= ends else Outcome.STALLED
        spent = monotonic() - began
        solution = Solution(
            method=self._method.name,
            outcome=outcome,
            message=words,
            iterations=len(shots) + steps,
            options=asdict(self._options),
            seconds=stage_seconds(stage, self._clock, spent, spent),
        )
        return solution if best is None else self._with_plan(solution, best)

    def _shots(self, start: Trajectory | None, ends: float) -> list[Shot]:
        scene, kernel, near, own = self._scene, self._kernel, self._near, self._options
        shots: list[Shot] = []
        if start is not None:
            shots.append(corrected(scene, kernel, start.u, near))
            if shots[0].has_arrived:
                return shots
        for u in nearest_pushes(scene, kernel, near, own.seed, own.pushes)[: own.corrections]:
            if sum(shot.has_arrived for shot in shots) >= own.plans or monotonic() >= ends:
                break
            shots.append(corrected(scene, kernel, u, near))
        return shots

    def _with_plan(self, solution: Solution, shot: Shot) -> Solution:
        scene = self._scene
        plan = plan_of(scene, shot.rollout, shot.u)
        residuals = {
            **plan_residuals(scene, plan),
            "discrete_terminal_error": replayed_goal_error(scene, self._kernel, plan),
        }
        most = self._options.plan_tolerance
        promises = {"input_bound_excess": most, "velocity_bound_excess": most}
        outcome, message = checked(solution.outcome, solution.message, residuals, promises)
        fields = {"outcome": outcome, "message": message, "residuals": residuals}
        return replace(solution, trajectory=plan, cost=shot.cost, **fields)


class NewtonShooting(Method[NewtonShootingOptions]):
    """Single shooting by damped Newton steps."""

    name = "newton_shooting"
    title = "Single shooting on true contact by Newton steps, from random pushes"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = NewtonShootingOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes without inputs, and without a goal."""
        if not scene.inputs:
            return without_inputs(scene, "correct")
        if not scene.task.has_goal:
            return f"scene {scene.name} has no goal that inputs could be corrected to end on."
        return None

    def session(self, scene: Scene, options: NewtonShootingOptions, clock: Clock) -> Session:
        """Open a session with the compiled time step."""
        return NewtonShootingSession(self, scene, options, clock)


METHOD = NewtonShooting()

"""Direct transcription with relaxed complementarity lam (lam - k phi) <= eps [N^2].

Plans for a smaller eps are feasible for a larger one, so a failed start is not tried again below.
The first stage of a long horizon is solved on coarser grids before. A cold start that makes no
progress begins at ten times the eps and returns from there. On two_finger_lift a start at 1e-2
finds no plan in 1000 iterations directly, but by 1e-1 in 219.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from formulations.grids import coarse_scene, on_grid
from formulations.method import Clock, Kind, Method, Session
from formulations.solution import Outcome, Solution, ended
from formulations.transcription.method import (
    BarrierOptions,
    SolveBudget,
    StageRules,
    Work,
    duals_option,
    first_eps_option,
)
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.stability import step_stability
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.ipopt import IpoptResult
    from formulations.transcription.homotopy import Stage


# Limit of work from a cold start: successful stages of the bank took up to 3.9e6 (two_finger_lift).
_COLD = Work(5e6, 1000)
# Limit of work from a plan: successful stages of the bank took up to 2.6e6 (two_discs_wall).
_WARM = Work(3e6, 400)
# Iterations after which a cold start begins softer: fast scenes take 18 to 102, the rest 222 to
# more than 1312.
_SOON = 150
_SOFTER = "It began softer, at eps = {:g}: from a cold start there was no plan soon."
# An iterate with a larger error of the time step [m/s] or products [N^2] is no plan.
_BROKEN = 1e-2
# With more steps than this, every second step is solved first, and so on. From their softplus plan
# three carts take 1386 iterations in 5000 steps, but 96 in 312 steps and then, grid by grid, 34, 32
# and 96.
_LONG = 2000
# The coarsest grid has at most this number of steps.
_SHORT = 500


@dataclass(frozen=True, kw_only=True)
class RelaxedLCPOptions(BarrierOptions):
    """Options of `relaxed_lcp`."""

    duals_from: float = duals_option("N^2")
    first_eps: float = first_eps_option(0.99, "N^2")


class RelaxedLCPSession(Session):
    """The session of `relaxed_lcp`; each eps only changes the bound.

    longest: with more steps, coarser grids are solved first
    """

    def __init__(
        self,
        method: RelaxedLCP,
        scene: Scene,
        options: RelaxedLCPOptions,
        clock: Clock,
        longest: int | None = None,
    ) -> None:
        # Imports Pyomo and Ipopt: 0.9 s that planning a campaign saves.
        from formulations.transcription import homotopy

        self._method, self._scene, self._options = method, scene, options
        self._longest = _LONG if longest is None else longest
        self._homotopy = homotopy.Homotopy(
            method, scene, homotopy.ContactFormulation.COMPLEMENTARITY, options, clock, self._rules
        )
        self._solver = self._homotopy.solver

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Solve at this eps. Raises TrajectoryError for a plan of another grid."""
        first = self._options.first_eps
        return self._homotopy.solve(
            eps,
            warm_start,
            time_limit,
            first,
            lambda stage, eps: self._solve_stage(stage, eps, warm_start),
        )

    def _rules(self, eps: float) -> StageRules:
        scene, options, tolerance = self._scene, self._options, self._options.plan_tolerance
        # Softplus with sharpness b = k ln2 / sqrt(eps) has the same worst violation: lam (lam - k
        # phi) = eps at phi = 0.
        softest = min(load_kernel(scene).stiffness(), default=math.inf)
        plan_limits, promises = (
            {"dynamics_defect": _BROKEN},
            {**options.promises(), "friction_cone": tolerance},
        )
        # With damping the bound holds for spring, switch and force separately, not for the true
        # law.
        if not scene.damped:
            plan_limits |= dict.fromkeys(("complementarity", "friction_law"), 2.0 * eps + _BROKEN)
            # friction_law is the sum of a friction's two products.
            products = {"complementarity": eps + tolerance, "friction_law": 2.0 * eps + tolerance}
            promises = {
                **options.promises(),
                **products,
                "force_sign": tolerance,
                "friction_cone": tolerance,
            }
        return StageRules(
            ipopt=options.ipopt(),
            cold=options.cold_barrier(),
            cold_work=_COLD,
            warm_work=_WARM,
            takes_duals=eps <= options.duals_from,
            sharpest=float(softest) * math.log(2.0) / math.sqrt(eps),
            plan_limits=plan_limits,
            promises=promises,
        )

    def _solve_stage(self, stage: Stage, eps: float, start: Trajectory | None) -> IpoptResult:
        # A later stage starts from a plan of this grid.
        if self._scene.task.steps <= self._longest or self._solver.last is not None:
            return self._reached_cold(stage, eps) if start is None else stage.reach(eps, start)
        coarse = self._from_coarser_grid(stage.budget, eps, start)
        if coarse is not None:
            self._solver.load(coarse)
        return stage.reach(eps, start if coarse is None else coarse)

    def _from_coarser_grid(
        self, budget: SolveBudget, eps: float, start: Trajectory | None
    ) -> Trajectory | None:
        coarse = coarse_scene(self._scene, math.ceil(self._scene.task.steps / 2))
        if coarse is None or not step_stability(coarse).is_stable:
            return None
        with budget.building():
            session = RelaxedLCPSession(self._method, coarse, self._options, Clock(), _SHORT)
            start = None if start is None else on_grid(start, coarse)
            session._solver.prepare(eps, start)
        session._solve_stage(session._homotopy.stage(budget), eps, start)
        solved = session._solver.last
        return None if solved is None else on_grid(solved.plan, self._scene)

    def _reached_cold(self, stage: Stage, eps: float) -> IpoptResult:
        """Solve from the loaded first guess, at a larger eps first if there is no progress."""
        levels = [eps]
        while self._scene.nl and 10.0 * levels[-1] < 1.0:
            levels.append(10.0 * levels[-1])
        result, last = self._first_to_end(stage, levels)
        if last > 0:
            if result.outcome is not Outcome.INFEASIBLE and not stage.budget.is_over:
                result = self._back_from(stage, levels[: last + 1])
            result = replace(
                result, message=f"{ended(result.message)} {_SOFTER.format(levels[last])}".lstrip()
            )
        return result

    def _first_to_end(self, stage: Stage, levels: list[float]) -> tuple[IpoptResult, int]:
        """Start cold at each level until one converges soon; the last one has no limit."""
        for index, level in enumerate(levels):
            self._solver.load(None)
            result = stage.solve(
                level, None, cold_work=Work(0.0, _SOON) if index < len(levels) - 1 else None
            )
            if result.outcome is not Outcome.ITERATION_LIMIT or not stage.may_go_on:
                break
        return result, index

    def _back_from(self, stage: Stage, levels: list[float]) -> IpoptResult:
        """Return from the plan of the softest level to the first, or start the first cold.

        From an unsolved plan the steps are halved: hopper_planar fails at 1e-2 from the last
            iterate at 1e-1
        unless by 3e-2.
        """
        halfway = (
            []
            if self._solver.last is not None
            else [math.sqrt(low * high) for low, high in pairwise(levels)]
        )
        plan = stage.left(levels[-1])
        if plan is None:
            self._solver.load(None)
            return stage.solve(levels[0], None)
        for level in sorted({*levels[:-1], *halfway}, reverse=True):
            self._solver.last = None
            self._solver.load(plan)
            result = stage.solve(level, plan)
            plan = stage.left(level) or plan
        return result


class RelaxedLCP(Method[RelaxedLCPOptions]):
    """Collocation with lam (lam - k phi) <= eps."""

    name = "relaxed_lcp"
    title = "Collocation with relaxed complementarity"
    kind = Kind.INDIRECT
    needs_eps = True
    options = RelaxedLCPOptions

    def session(self, scene: Scene, options: RelaxedLCPOptions, clock: Clock) -> Session:
        """Open a session, which imports Pyomo and Ipopt."""
        return RelaxedLCPSession(self, scene, options, clock)


METHOD = RelaxedLCP()

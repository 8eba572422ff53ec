"""Direct transcription with relaxed complementarity lam (lam - k phi) <= eps [N^2], Pyomo's own relaxation, tightened by its bound.

Plans for a smaller eps are among those for a larger one: where a start led to none, it is not tried
again below. On a long horizon the first stage is solved on coarser grids before, each half as fine.

A start without a plan that leads nowhere soon begins again softer, at ten times the eps, and comes
back from that plan: hundreds of iterations from a cold start are a walk in which the last digit
decides where it ends. Iterations and cost at eps = 1e-2, directly and by 1e-1: push_box 764 and
381, both 4803; transport 1002 at 1.75 and 1289 at 0.91; two_finger_lift 1000 without an end and 219
at 59.0; hopper_planar 1312 without a plan and 1460 with one.
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


# Stages of the bank that ended well took up to 3.9e6 from a cold start (two_finger_lift: 575
# iterations, of 6814 unknowns), and up to 2.6e6 from a plan (two_discs_wall: 333, of 7688).
_COLD = Work(5e6, 1000)
_WARM = Work(3e6, 400)
# Iterations after which a start without a plan begins softer: the bank's quick ones are done in 18
# to 102, the others need 222 to more than 1312.
_SOON = 150
_SOFTER = "It began softer, at eps = {:g}: from a cold start there was no plan soon."
# A last iterate that misses its own time step [m/s] or its products [N^2] by more is no plan: the
# next stage starts better from the one before.
_BROKEN = 1e-2
# More steps than the first are solved on every second step before, and so on down to the second:
# from their softplus plan three carts in 5000 steps take 1386 iterations, in 312 steps 96, and
# then, from grid to grid, 34, 32 and 96.
_LONG = 2000
_SHORT = 500


@dataclass(frozen=True, kw_only=True)
class RelaxedLCPOptions(BarrierOptions):
    """Options of `relaxed_lcp`."""

    duals_from: float = duals_option("N^2")
    first_eps: float = first_eps_option(0.99, "N^2")


class RelaxedLCPSession(Session):
    """The model is built once.

    Each eps moves its bound, and starts warm. longest: more steps than this are solved on coarser
    grids first.
    """

    def __init__(
        self,
        method: RelaxedLCP,
        scene: Scene,
        options: RelaxedLCPOptions,
        clock: Clock,
        longest: int | None = None,
    ) -> None:
        from formulations.transcription import (
            homotopy,
        )  # imports Pyomo and Ipopt: 0.9 s that planning a campaign does without

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
            lambda stage, eps: self._found(stage, eps, warm_start),
        )

    def _rules(self, eps: float) -> StageRules:
        scene, options, tolerance = self._scene, self._options, self._options.plan_tolerance
        # Softplus with sharpness b = k ln2 / sqrt(eps) has this worst-case violation: lam (lam - k
        # phi) = eps at phi = 0.
        softest = min(load_kernel(scene).stiffness(), default=math.inf)
        plan_limits, promises = (
            {"dynamics_defect": _BROKEN},
            {**options.promises(), "friction_cone": tolerance},
        )
        # there the bound holds for spring, switch and force each, not for the force against the
        # true law
        if not scene.damped:
            plan_limits |= dict.fromkeys(("complementarity", "friction_law"), 2.0 * eps + _BROKEN)
            # each friction has two products, and friction_law is their sum
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

    def _found(self, stage: Stage, eps: float, start: Trajectory | None) -> IpoptResult:
        """Solve the model, which holds the start already."""
        if (
            self._scene.task.steps <= self._longest or self._solver.last is not None
        ):  # a later stage starts from a plan of this grid
            return self._reached_cold(stage, eps) if start is None else stage.reach(eps, start)
        coarse = self._from_coarser_grid(stage.budget, eps, start)
        if coarse is not None:
            self._solver.load(coarse)
        return stage.reach(eps, start if coarse is None else coarse)

    def _from_coarser_grid(
        self, budget: SolveBudget, eps: float, start: Trajectory | None
    ) -> Trajectory | None:
        """A plan of every second step, on this grid, or None if there is none."""
        coarse = coarse_scene(self._scene, math.ceil(self._scene.task.steps / 2))
        if coarse is None or not step_stability(coarse).is_stable:
            return None
        with budget.building():
            session = RelaxedLCPSession(self._method, coarse, self._options, Clock(), _SHORT)
            start = None if start is None else on_grid(start, coarse)
            session._solver.prepare(eps, start)
        session._found(session._homotopy.stage(budget), eps, start)
        solved = session._solver.last
        return None if solved is None else on_grid(solved.plan, self._scene)

    def _reached_cold(self, stage: Stage, eps: float) -> IpoptResult:
        """From the first guess, which the model holds.

        Softer first where that leads nowhere soon.
        """
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
        """Cold starts, each softer than the one before, until one ends soon.

        The softest may take its time.
        """
        for index, level in enumerate(levels):
            self._solver.load(None)
            result = stage.solve(
                level, None, cold_work=Work(0.0, _SOON) if index < len(levels) - 1 else None
            )
            if result.outcome is not Outcome.ITERATION_LIMIT or not stage.may_go_on:
                break
        return result, index

    def _back_from(self, stage: Stage, levels: list[float]) -> IpoptResult:
        """From the plan that the softest level left in the model to the first.

        Where it is none, the first from a cold start.

        From a plan that was not solved, by half the steps: hopper_planar at 1e-2 from the last
        iterate at 1e-1 is lost, and by 3e-2 it is not.
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

"""Direct transcription with strict complementarity 0 <= lam, lam - k phi, one of them zero.

1. attack: solve with lam * v <= attack_bound, from the given plan or cold; by looser bounds first
   if the scene is not linear
2. modes: fix every pair and solve the smooth problem (`transcription.solving.FixedModes`)
3. if the modes have no plan, tighten the bound by 100 and repeat
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from formulations.grids import replayed_goal_error
from formulations.method import Clock, Kind, Method, Session, option
from formulations.solution import Outcome, Solution, ended
from formulations.transcription.method import BarrierOptions, SolveBudget, Work
from models.codegen.kernel import load_kernel
from models.dynamics import derive
from models.scene import Scene
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.ipopt import IpoptResult
    from formulations.transcription.solving import FixedModes

# Factor between two bounds of step 3.
_TIGHTENING = 1e-2
# Last bound: below it Ipopt's tolerance (1e-8) is coarser.
_LAST_BOUND = 1e-8
# First bound of the attack in nonlinear scenes. Two fingers that carry a disc take 63, 60 and 13
# iterations at 1e-2, 1e-3 and 1e-4. At 1e-4 directly they fail after 500.
_FIRST_BOUND = 1e-2
# Factor between two of these bounds.
_NARROWING = 0.1
# Iteration limit at the first bound, from a plan with Ipopt's default barrier; successful solves
# took up to 121. A softplus plan of two fingers that lift a disc fails even in 1300, but takes 89
# with the barrier of a cold start.
_FROM_PLAN = 130
# Limit of each solve of the attack, in addition to its option; successful ones took up to 4.8e6
# (acrobot_limits) or 801 iterations.
_ATTACK = Work(5e6, 1000)
# A plan with a larger error of its time step is a worse start than the first guess.
_BROKEN = 1e-2
_CUT_OFF = "The search for contact modes was cut off by its limit or stalled; with more time, or a warm start, a cheaper plan may be found."


@dataclass(frozen=True, kw_only=True)
class StrictLCPOptions(BarrierOptions):
    """Options of `strict_lcp`."""

    attack_bound: float = option(
        1e-4,
        "bound of lam (lam - k phi) at which the modes of the contacts are found; the plan itself has none",
        unit="N^2",
        lower=1e-8,
        upper=1.0,
    )
    attack_iterations: int = option(
        2000,
        "most Ipopt iterations of the search for modes; where it is cut off, its modes are tried as they are",
        lower=1,
        upper=10**9,
    )
    depth_share: float = option(
        0.0,
        "keep penetrations below this share of each contact's depth; 0: they are not bounded",
        lower=0.0,
        upper=1.0,
    )
    mode_switches: int = option(
        20, "most rounds of switching contacts to a cheaper mode", lower=0, upper=10**6
    )
    physics_tolerance: float = option(
        1e-3,
        "solved only if the sum of abs(lam (lam - k phi)) is at most this",
        unit="N^2",
        lower=0.0,
    )
    terminal_tolerance: float = option(
        1e-8, "solved only if the plan ends this near to its goal", lower=0.0
    )
    replay_tolerance: float = option(
        1e-5,
        "solved only if the plan's inputs end this near to the goal through the same time step with the true contact law",
        lower=0.0,
    )


class StrictLCPSession(Session):
    """The session of `strict_lcp`: one model at the bound of the attack, one with fixed modes."""

    def __init__(
        self, method: StrictLCP, scene: Scene, options: StrictLCPOptions, clock: Clock
    ) -> None:
        # Imports Pyomo and Ipopt: 0.9 s that planning a campaign saves.
        from formulations.transcription import solving

        self._method, self._scene, self._options = method, scene, options
        self._solver = solving.PlanSolver(
            scene,
            solving.ContactFormulation.COMPLEMENTARITY,
            options,
            clock,
            depth_share=options.depth_share or None,
        )
        self._kernel = load_kernel(scene)
        self._modes: FixedModes | None = None

    def start_used(self, warm_start: Trajectory | None) -> Trajectory | None:
        """Return the warm start, or None if it is not a usable plan of this scene with contacts."""
        if (
            warm_start is None
            or not self._scene.nl
            or self._solver.residuals.dynamics_defect(warm_start) <= _BROKEN
        ):
            return warm_start
        return (
            warm_start if self._is_nearly_strict(warm_start, self._options.attack_bound) else None
        )

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Find an exact plan by the three steps. Raises TrajectoryError for another grid."""
        self._method.check_stage(eps, time_limit)
        budget = self._solver.begin(self._options.attack_bound, warm_start, time_limit)
        start = self.start_used(warm_start)
        if start is not warm_start:
            self._solver.load(start)
        result = self._search_plan(budget, start)
        return self._solver.solution(
            self._method.name,
            budget,
            result,
            self._residuals,
            plan_limits={},
            promises=self._promises(),
        )

    def _search_plan(self, budget: SolveBudget, start: Trajectory | None) -> IpoptResult:
        if not self._scene.nl:
            return self._solver.attempt(budget, self._ipopt(start), from_plan=self._options.ipopt())
        bound = self._options.attack_bound
        if start is not None and self._is_nearly_strict(start, bound):
            exact = self._exact(budget, start)
            if exact.outcome is Outcome.SOLVED:
                return exact
            self._solver.load(start)
        result = self._attack(budget, start, bound)
        while result.outcome.has_answer and not budget.is_over:
            plan = self._solver.read()
            exact = self._exact(budget, plan)
            if exact.outcome is Outcome.SOLVED:
                return (
                    exact
                    if result.outcome is Outcome.SOLVED
                    else replace(exact, message=f"{ended(exact.message)} {_CUT_OFF}")
                )
            self._solver.load(plan)
            bound *= _TIGHTENING
            if result.outcome is not Outcome.SOLVED or bound < _LAST_BOUND or budget.is_over:
                break
            self._solver.set_relaxation(bound)
            self._solver.release_modes()
            result = self._solver.run(budget, self._options.ipopt(), after=result)
            # There was a plan at a looser bound, so this proves nothing.
            if result.outcome is Outcome.INFEASIBLE:
                result = replace(result, outcome=Outcome.STALLED)
        return result

    def _is_nearly_strict(self, plan: Trajectory, bound: float) -> bool:
        residuals, tolerance = self._solver.residuals.of(plan), self._options.plan_tolerance
        products = max(residuals.get("complementarity", 0.0), residuals.get("friction_law", 0.0))
        return (
            products <= bound + tolerance
            and max(residuals["terminal_error"], residuals["dynamics_defect"]) <= tolerance
        )

    def _attack(self, budget: SolveBudget, start: Trajectory | None, bound: float) -> IpoptResult:
        self._solver.release_modes()
        if start is not None:
            result = self._narrowed(budget, start, bound)
            if result.outcome.has_answer or budget.is_over:
                return result
            self._solver.load(None)
        return self._narrowed(budget, None, bound)

    def _narrowed(self, budget: SolveBudget, start: Trajectory | None, bound: float) -> IpoptResult:
        bounds = [bound]
        while not derive(self._scene).structure.linear and bounds[0] < _FIRST_BOUND:
            bounds.insert(0, bounds[0] / _NARROWING)
        for looser in bounds:
            self._solver.set_relaxation(looser)
            result = self._attempted(
                budget, start, is_first=looser == bounds[0] and len(bounds) > 1
            )
            if result.outcome is not Outcome.SOLVED or looser == bounds[-1]:
                break
            start = self._solver.read()
        return result

    def _attempted(
        self, budget: SolveBudget, start: Trajectory | None, *, is_first: bool
    ) -> IpoptResult:
        options, from_plan = self._attack_options(budget, start), self._options.ipopt()
        if start is None or not is_first:
            return self._solver.attempt(budget, options, from_plan=from_plan)
        most = min(options["max_iter"], budget.iterations + _FROM_PLAN)
        result = self._solver.attempt(budget, {**options, "max_iter": most}, from_plan=from_plan)
        if (
            result.outcome is not Outcome.ITERATION_LIMIT
            or budget.is_over
            or most == options["max_iter"]
        ):
            return result
        self._solver.load(start)
        inside = {**self._attack_options(budget, start), **self._options.cold_barrier()}
        return self._solver.attempt(budget, inside, from_plan=from_plan)

    def _ipopt(self, start: Trajectory | None) -> dict[str, Any]:
        return {**self._options.ipopt(), **(self._options.cold_barrier() if start is None else {})}

    def _attack_options(self, budget: SolveBudget, start: Trajectory | None) -> dict[str, Any]:
        options, most = self._ipopt(start), _ATTACK.iterations(self._solver.unknowns)
        return {
            **options,
            "max_iter": min(
                options["max_iter"], budget.iterations + min(most, self._options.attack_iterations)
            ),
        }

    def _exact(self, budget: SolveBudget, plan: Trajectory) -> IpoptResult:
        """Perform step 2 with the modes of a plan, else with those of its inputs in true contact.

        The latter always have a motion. A friction mode one step early can make the problem
        infeasible.
        """
        exact = self._with_modes(budget, self._solver.residuals.modes(plan))
        if exact.outcome is Outcome.SOLVED or budget.is_over:
            return exact
        rolled = self._kernel.rollout(
            np.array(self._scene.task.start), plan.u, self._scene.task.step
        )
        if rolled.diverged:
            return exact
        motion = replace(plan, q=rolled.q, v=rolled.v, lam=rolled.lam)
        self._solver.load(motion)
        return self._with_modes(budget, self._solver.residuals.modes(motion))

    def _with_modes(self, budget: SolveBudget, closed: np.ndarray) -> IpoptResult:
        if self._modes is None:
            self._modes = self._solver.with_fixed_modes(self._options.mode_switches)
        return self._modes.solve(budget, closed)

    def _residuals(self, plan: Trajectory) -> dict[str, float]:
        return {
            **self._solver.residuals.of(plan),
            "discrete_terminal_error": replayed_goal_error(self._scene, self._kernel, plan),
        }

    def _promises(self) -> dict[str, float]:
        return {
            **self._options.promises(),
            **dict.fromkeys(
                ("force_sign", "friction_cone", "friction_law"), self._options.plan_tolerance
            ),
            "physics": self._options.physics_tolerance,
            "terminal_error": self._options.terminal_tolerance,
            "discrete_terminal_error": self._options.replay_tolerance,
        }


class StrictLCP(Method[StrictLCPOptions]):
    """Collocation whose plan has no relaxation left."""

    name = "strict_lcp"
    title = "Collocation with strict complementarity"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = StrictLCPOptions

    def session(self, scene: Scene, options: StrictLCPOptions, clock: Clock) -> Session:
        """Open a session, which imports Pyomo and Ipopt."""
        return StrictLCPSession(self, scene, options, clock)


METHOD = StrictLCP()

"""Direct transcription with strict complementarity 0 <= lam, lam - k phi, and one of them zero: no relaxation is left in its plan.

Ipopt attacks the model at a tiny bound, the modes of the contacts are read off, and the rest is
solved exactly.

1. attack: lam * v <= attack_bound, from the given plan or cold (no smoother problem is solved
    first): at once where the scene is linear,
   by way of looser bounds where it is not. A plan that meets this bound already goes straight to 2.
2. modes: every pair is decided, and the problem without any complementarity is solved
    (`transcription.solving.FixedModes`).
3. If those modes have no plan: the bound is tightened by 100, warm, and the modes are read again.
    An attack that was cut off by a limit
   has its modes tried once.

The plan is judged on its own: residuals from the scene, and the goal after a replay of its inputs
through true contact.
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

# Step 3: the factor between two bounds, and the last one; below it Ipopt's own tolerance (1e-8) is
# coarser than the bound.
_TIGHTENING = 1e-2
_LAST_BOUND = 1e-8
# Bounds of lam * v on the way to the attack's, where the scene is not linear: two fingers that
# carry a disc need 63, 60 and 13 iterations for 1e-2, 1e-3 and 1e-4, and have no plan after 500 at
# 1e-4 alone. A linear scene is solved at once in fewer.
_FIRST_BOUND = 1e-2
_NARROWING = 0.1
# Most iterations at the first of these bounds from a given plan with Ipopt's own barrier: those
# that were solved took up to 121. A soft plan of two fingers that lift a disc leads nowhere in ten
# times as many, and is solved in 89 with the barrier of a cold start.
_FROM_PLAN = 130
# Of each solve of the attack, beside its option: those that were solved took up to 4.8e6
# (acrobot_limits: 529 iterations, of 9004 unknowns) or up to 801 iterations. What is cut off has
# its modes tried.
_ATTACK = Work(5e6, 1000)
# A plan that misses its own time step by more than this was never one: the first guess is a better
# start.
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
    """The model is built once, at the bound of the attack, and translated a second time with its modes fixed."""

    def __init__(
        self, method: StrictLCP, scene: Scene, options: StrictLCPOptions, clock: Clock
    ) -> None:
        from formulations.transcription import (
            solving,
        )  # imports Pyomo and Ipopt: 0.9 s that planning a campaign does without

        self._method, self._scene, self._options = method, scene, options
        self._solver = solving.PlanSolver(
            scene, solving.ContactFormulation.COMPLEMENTARITY, options, clock
        )
        self._kernel = load_kernel(scene)
        self._modes: FixedModes | None = None

    def start_used(self, warm_start: Trajectory | None) -> Trajectory | None:
        """Without contacts any plan is a start.

        With them one that misses its own time step is none.
        """
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
        """Find an exact plan by the three steps.

        Raises TrajectoryError for a plan of another grid.
        """
        self._method.check_stage(eps, time_limit)
        budget = self._solver.begin(self._options.attack_bound, warm_start, time_limit)
        start = self.start_used(warm_start)
        if start is not warm_start:
            self._solver.load(start)
        result = self._found(budget, start)
        return self._solver.solution(
            self._method.name,
            budget,
            result,
            self._residuals,
            plan_limits={},
            promises=self._promises(),
        )

    # -- the three steps
    #   --------------------------------------------------------------------------------------------------------

    def _found(self, budget: SolveBudget, start: Trajectory | None) -> IpoptResult:
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
            if (
                result.outcome is Outcome.INFEASIBLE
            ):  # a little looser there was a plan: that is no proof that there is none
                result = replace(result, outcome=Outcome.STALLED)
        return result

    def _is_nearly_strict(self, plan: Trajectory, bound: float) -> bool:
        found, tolerance = self._solver.residuals.of(plan), self._options.plan_tolerance
        products = max(found.get("complementarity", 0.0), found.get("friction_law", 0.0))
        return (
            products <= bound + tolerance
            and max(found["terminal_error"], found["dynamics_defect"]) <= tolerance
        )

    def _attack(self, budget: SolveBudget, start: Trajectory | None, bound: float) -> IpoptResult:
        """Step 1; a plan that leads nowhere is left for the first guess."""
        self._solver.release_modes()
        if start is not None:
            result = self._narrowed(budget, start, bound)
            if result.outcome.has_answer or budget.is_over:
                return result
            self._solver.load(None)
        return self._narrowed(budget, None, bound)

    def _narrowed(self, budget: SolveBudget, start: Trajectory | None, bound: float) -> IpoptResult:
        """The model solved at the bound from what it holds: at once, or by way of looser bounds, each from the plan before."""
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
        """At the bound of the model.

        A plan that leads nowhere with Ipopt's own barrier is tried once more from well inside its
        bounds.
        """
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
        """Step 2 with the modes of a plan.

        Where they have none, with those of its inputs under the true law.

        These have one: that motion, if it only reached the goal. Where friction begins to hold, a
        mode that is one step early leaves nothing.
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

    # -- what is promised of the plan
    #   -------------------------------------------------------------------------------------------

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

"""Strict complementarity: Ipopt attacks the model at a tiny bound, the modes of the contacts are read off, and the rest is solved exactly.

1. attack: lam * v <= attack_bound, from the given plan or cold (no smoother problem is solved first): at once where the scene is linear,
   by way of looser bounds where it is not. A plan that meets this bound already goes straight to 2.
2. modes: every pair is decided, closed (lam = k phi) or open (lam = 0), and the problem without any complementarity is solved. Pairs at
   lam = 0 = lam - k phi whose multiplier says that the other mode is cheaper are switched, and the problem is solved again.
3. If those modes have no plan: the bound is tightened by 100, warm, and the modes are read again. An attack that was cut off by a limit
   has its modes tried once.

The plan is judged on its own: residuals from the scene, and the goal after a replay of its inputs through true contact.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from formulations.ipopt import IpoptProblem, IpoptResult
from formulations.method import Method
from formulations.solution import Outcome
from formulations.transcription.contact import ContactLaw, hold_modes, pressed_columns, release_modes, sides, tighten
from formulations.transcription.session import Ending, TranscriptionSession, Work, cold_barrier
from formulations.transcription.workbench import Account, Workbench, load_first_guess, load_plan, primal_dual, read_plan, size_on_paper
from models.codegen.kernel import Kernel, load_kernel
from models.dynamics import derive
from models.scene import Scene
from models.scene.goal import distance, goal_state
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.methods.strict_lcp import StrictLCPOptions

# Step 3: the factor between two bounds, and the last one; below it Ipopt's own tolerance (1e-8) is coarser than the bound.
_TIGHTENING, _LAST_BOUND = 1e-2, 1e-8
# Modes that have a plan are solved in 6 to 20 iterations; more are spent only on proving that there is none.
_MODE_ITERATIONS = 100
# They start from a plan that is nearly theirs: Ipopt's own barrier (0.1) first pushes it away from every bound, so far that two fingers that lift
# a disc end in restoration; with this one they need 23 iterations.
_NEAR = {"mu_init": 1e-4, "bound_push": 1e-6, "bound_frac": 1e-6}
# Bounds of lam * v on the way to the attack's, where the scene is not linear: two fingers that carry a disc need 63, 60 and 13 iterations for
# 1e-2, 1e-3 and 1e-4, and have no plan after 500 at 1e-4 alone. A linear scene is solved at once in fewer.
_FIRST_BOUND, _NARROWING = 1e-2, 0.1
# Most iterations at the first of these bounds from a given plan with Ipopt's own barrier: those that were solved took up to 121. A soft plan of two
# fingers that lift a disc leads nowhere in ten times as many, and is solved in 89 with the barrier of a cold start.
_FROM_PLAN = 130
# Of each solve of the attack, beside its option: those that were solved took up to 4.8e6 (acrobot_limits: 529 iterations, of 9004 unknowns) or up to
# 801 iterations. What is cut off has its modes tried.
_ATTACK = Work(5e6, 1000)
# A plan that misses its own time step by more than this was never one: the first guess is a better start.
_BROKEN = 1e-2
# Part of the remaining time an attack may take: a cut-off attack leaves modes that can still be solved exactly, in a twentieth of its time.
_ATTACK_SHARE = 0.8
# A pair counts as undecided where both forces are below this [N], and as wanting the other mode where that would lower the cost by
# more than this a newton: both well above Ipopt's 1e-8 and far below any force that moves a cart.
_UNDECIDED, _WANTING = 1e-5, 1e-5


class StrictSession(TranscriptionSession):
    contact = ContactLaw.COMPLEMENTARITY
    _options: StrictLCPOptions

    def __init__(self, method: Method, scene: Scene, options: StrictLCPOptions, opening: tuple[float, float]) -> None:
        super().__init__(method, scene, options, opening)
        self._kernel: Kernel = load_kernel(scene)
        self._modes_bench: Workbench | None = None

    def first_eps(self, eps: float | None) -> float:
        return self._options.attack_bound

    def cold_options(self) -> dict[str, Any]:
        return cold_barrier(self._options)

    def common_options(self) -> dict[str, Any]:
        return {**super().common_options(), "bound_relax_factor": 0.0}

    def start_used(self, warm_start: Trajectory | None) -> Trajectory | None:
        """Without contacts any plan is a start; with them a broken one is none."""
        if warm_start is None or not self._scene.nl or self._residuals.dynamics_defect(warm_start) <= _BROKEN:
            return warm_start
        return warm_start if self._is_nearly_strict(warm_start, self._options.attack_bound) else None

    def certificate(self, plan: Trajectory, eps: float | None) -> dict[str, float]:
        task = self._scene.task
        replay = self._kernel.rollout(np.array(task.start), plan.u, task.step)
        end = np.concatenate([replay.q[-1], replay.v[-1]])
        return {**self._residuals.of(plan), "discrete_terminal_error": distance(end, goal_state(task))}

    def promises(self, eps: float | None) -> dict[str, float]:
        return {
            **super().promises(eps),
            **dict.fromkeys(("force_sign", "friction_cone", "friction_law"), self._options.plan_tolerance),
            "physics": self._options.physics_tolerance,
            "terminal_error": self._options.terminal_tolerance,
            "discrete_terminal_error": self._options.replay_tolerance,
        }

    def solve_modes(self, closed: np.ndarray, time_limit: float = 60.0) -> IpoptResult:
        """Step 2 alone, from the paper's first guess: closed (steps, nc + 2 nf) as in `hold_modes`."""
        bench = self.bench(None)
        load_first_guess(bench.model)
        return self._solve_modes(bench, Account(time_limit), closed)

    # -- the three steps --------------------------------------------------------------------------------------------------------

    def run(self, bench: Workbench, account: Account, eps: float | None, warm_start: Trajectory | None) -> Ending:
        if not self._scene.nl:
            return self.ending(self.attempt(bench, account, None, self.ipopt_options(warm_start)))
        bound = self._options.attack_bound
        if warm_start is not None and self._is_nearly_strict(warm_start, bound):
            exact = self._exact(bench, account, warm_start)
            if exact.outcome is Outcome.SOLVED:
                return self.ending(exact)
            load_plan(bench.model, warm_start)
        result = self._attack(bench, account, warm_start, bound)
        while result.outcome.has_answer and not account.is_over:
            plan = read_plan(bench.model)
            exact = self._exact(bench, account, plan)
            if exact.outcome is Outcome.SOLVED:
                return self._exact_ending(exact, result)
            load_plan(bench.model, plan)
            bound *= _TIGHTENING
            if result.outcome is not Outcome.SOLVED or bound < _LAST_BOUND or account.is_over:
                break
            tighten(bench.model, bound)
            release_modes(bench.model)
            result = bench.run(account, self.ipopt_options(plan), primal_dual(result))
            if result.outcome is Outcome.INFEASIBLE:  # a little looser there was a plan: that is no proof that there is none
                result = replace(result, outcome=Outcome.STALLED)
        return self.ending(result)

    def _exact_ending(self, exact: IpoptResult, attack: IpoptResult) -> Ending:
        ending = self.ending(exact)
        if attack.outcome is Outcome.SOLVED:
            return ending
        cut = "The search for contact modes was cut off by its limit or stalled; with more time, or a warm start, a cheaper plan may be found."
        return replace(ending, message=f"{ending.message} {cut}")

    def _is_nearly_strict(self, plan: Trajectory, bound: float) -> bool:
        found, tolerance = self._residuals.of(plan), self._options.plan_tolerance
        products = max(found.get("complementarity", 0.0), found.get("friction_law", 0.0))
        return products <= bound + tolerance and max(found["terminal_error"], found["dynamics_defect"]) <= tolerance

    def _exact(self, bench: Workbench, account: Account, plan: Trajectory) -> IpoptResult:
        """Step 2 with the modes of a plan; where they have none, with those of its inputs under the true law, which have one: that motion,
        if it only reached the goal. Where friction begins to hold, a mode that is one step early leaves nothing."""
        exact = self._solve_modes(bench, account, self._residuals.modes(plan))
        if exact.outcome is Outcome.SOLVED or account.is_over:
            return exact
        rolled = self._kernel.rollout(np.array(self._scene.task.start), plan.u, self._scene.task.step)
        if rolled.diverged:
            return exact
        motion = replace(plan, q=rolled.q, v=rolled.v, lam=rolled.lam)
        load_plan(bench.model, motion)
        return self._solve_modes(bench, account, self._residuals.modes(motion))

    def _attack(self, bench: Workbench, account: Account, warm_start: Trajectory | None, bound: float) -> IpoptResult:
        """Step 1; a plan that leads nowhere is left for the first guess."""
        release_modes(bench.model)
        if warm_start is not None:
            result = self._narrowed(bench, account, warm_start, bound)
            if result.outcome.has_answer or account.is_over:
                return result
            load_first_guess(bench.model)
        return self._narrowed(bench, account, None, bound)

    def _narrowed(self, bench: Workbench, account: Account, start: Trajectory | None, bound: float) -> IpoptResult:
        """The model solved at the bound from what it holds: at once, or by way of looser bounds, each from the plan before."""
        bounds = [bound]
        while not derive(self._scene).structure.linear and bounds[0] < _FIRST_BOUND:
            bounds.insert(0, bounds[0] / _NARROWING)
        for looser in bounds:
            tighten(bench.model, looser)
            result = self._attempted(bench, account, start, is_first=looser == bounds[0] and len(bounds) > 1)
            if result.outcome is not Outcome.SOLVED or looser == bounds[-1]:
                break
            start = read_plan(bench.model)
        return result

    def _attempted(self, bench: Workbench, account: Account, start: Trajectory | None, *, is_first: bool) -> IpoptResult:
        """At the bound of the model; a plan that leads nowhere with Ipopt's own barrier is tried once more from well inside its bounds."""
        options = self._attack_options(account, start)
        if start is None or not is_first:
            return self.attempt(bench, account, None, options, share=_ATTACK_SHARE)
        most = min(options["max_iter"], account.iterations + _FROM_PLAN)
        result = self.attempt(bench, account, None, {**options, "max_iter": most}, share=_ATTACK_SHARE)
        if result.outcome is not Outcome.ITERATION_LIMIT or account.is_over or most == options["max_iter"]:
            return result
        load_plan(bench.model, start)
        return self.attempt(bench, account, None, {**self._attack_options(account, start), **self.cold_options()}, share=_ATTACK_SHARE)

    def _attack_options(self, account: Account, warm_start: Trajectory | None) -> dict[str, Any]:
        options, most = self.ipopt_options(warm_start), _ATTACK.iterations(size_on_paper(self._scene, self.contact).unknowns)
        return {**options, "max_iter": min(options["max_iter"], account.iterations + min(most, self._options.attack_iterations))}

    def _solve_modes(self, bench: Workbench, account: Account, closed: np.ndarray) -> IpoptResult:
        """Step 2: the last solved problem without complementarity, its plan left in the model."""
        if self._modes_bench is None:
            self._modes_bench = Workbench(bench.model)
        hold_modes(bench.model, closed)
        best = self._modes_bench.run(account, self._modes_options(account))
        for _ in range(self._options.mode_switches):
            if best.outcome is not Outcome.SOLVED or account.is_over:
                return best
            switch = _cheaper_modes(self._modes_bench.problem(account), best, bench.model, closed)
            if not switch.any():
                return best
            plan, closed = read_plan(bench.model), closed ^ switch
            hold_modes(bench.model, closed)
            again = self._modes_bench.run(account, self._modes_options(account))
            if again.outcome is not Outcome.SOLVED or again.objective >= best.objective:
                load_plan(bench.model, plan)  # no gain beyond rounding: keep what was there
                return best
            best = again
        return best

    def _modes_options(self, account: Account) -> dict[str, Any]:
        options = {**self.common_options(), **_NEAR}
        return {**options, "max_iter": min(options["max_iter"], account.iterations + _MODE_ITERATIONS)}


def _cheaper_modes(problem: IpoptProblem, result: IpoptResult, model: Any, closed: np.ndarray) -> np.ndarray:
    """(steps, nc + 2 nf) pairs at lam = 0 = v that would lower the cost in the other mode: the force held at zero there has a negative multiplier."""
    place = {id(variable): column for column, variable in enumerate(problem.variables)}
    couples = sides(model)
    lam, separation = (np.array([place[id(couple[side])] for couple in couples]) for side in (0, 1))
    rows, columns = problem.jacobianstructure()
    slope = problem.gradient(result.x) + np.bincount(columns, problem.jacobian(result.x) * result.lagrange[rows], problem.n)
    undecided = np.maximum(result.x[lam], result.x[separation]) < _UNDECIDED
    held = np.where(closed.ravel(), separation, lam)
    switch = (undecided & (slope[held] < -_WANTING)).reshape(closed.shape)
    for contact, forward in pressed_columns(model):  # a friction that nothing presses has no mode to switch
        switch[:, forward : forward + 2] &= closed[:, contact : contact + 1]
    return switch

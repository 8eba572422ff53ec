"""From a scene to the cheapest mode sequence that can be found: where the modes come from, and what is tried when they have no plan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from formulations.contact_modes.goal import (
    continue_to_goal,
    correct_end,
    correct_end_by_softplus,
)
from formulations.contact_modes.method import MpccOptions
from formulations.contact_modes.nonlinear import (
    STAGE_ITERATIONS,
    NonlinearModes,
    SceneModels,
    schedule,
)
from formulations.contact_modes.quadratic import ModesAnswer, ModesProblem
from formulations.contact_modes.search import SearchResult, flip_wrong_signs, search_sequences
from formulations.contact_modes.starts import random_plan
from formulations.grids import coarse_scene, on_grid, plan_of, rolled_plan
from formulations.pipelines import RELAXED_FROM, RELAXED_TO, load_method
from formulations.solution import Outcome
from formulations.transcription.method import SolveBudget
from formulations.transcription.solving import nearest, no_plan, out_of_reach
from models.scene.goal import distance, goal_state
from models.trajectory import Trajectory

_ARRIVED = 1e-6  # from the goal: what remains is taken out by the exact problem
STRIDES = 125  # the first stride is this part of the steps: 4 steps of 500
_STAGES = 3  # of the homotopy whose modes are tried, the sharpest first
_RANDOM = 6  # random inputs that are corrected to end on the goal if the first guess leads nowhere
_NONLINEAR = 20  # a nonlinear scene tries this part of the mode sequences that a linear one may
# From so many contacts on modes are searched around other sources too (`_searched_again`); with two
# contacts the first source led twenty starts of the three carts to the same plan.
_MANY = 3
_LOOSE = (0.3, 0.03, 3e-3)  # [N^2] bounds of the relaxation: the first of whose modes has a plan
# Most iterations of a walk of relaxed complementarity. Six carts, tasks 3, 11 and 7: 702 lead from
# 980.6 to 854.7; 734 to 2516, where loosened modes lead from 2484.9 to 2377.6; 1871 to no plan, and
# loosened modes from 1557.3 to 1476.4. So these come first, and where they lead below the plan
# nothing is walked.
_WALK = 800
_NEAREST = 3  # of the rollouts that came nearest so many are continued to the goal


@dataclass(frozen=True, kw_only=True)
class FinderResult:
    """The optimum of the best modes (None: no modes had a plan), how it ended, and how many modes the search solved."""

    answer: ModesAnswer | None
    outcome: Outcome
    message: str
    tried: int = 0


class Finder:
    """Finds contact modes of one scene; its models serve every solve."""

    def __init__(self, models: SceneModels, options: MpccOptions) -> None:
        self._scene, self._kernel, self._is_linear = models.scene, models.kernel, models.is_linear
        self._options, self._models = options, models
        self._is_walked = (
            False  # relaxed complementarity was: whatever the start, its plan is the same
        )
        self._random_failed = (
            False  # all random inputs were corrected once, and none of them gave a plan
        )
        self._on_coarse: Finder | None = None
        self._most_work = 0.0  # of the search under way, once it has a plan

    def find(
        self,
        budget: SolveBudget,
        modes_of: Trajectory | None = None,
        start: Trajectory | None = None,
    ) -> FinderResult:
        """Find the best plan. modes_of: a plan whose modes are tried first.

        start: where the homotopy begins (None: the paper's first guess).
        """
        with budget.building():
            problem = self._models.modes(budget, self._ipopt_options(self._options.tolerance))
        self._most_work = budget.most_work
        budget.most_work = min(self._most_work, budget.work + 1e6 * self._options.first_work)
        self._ending = (Outcome.FAILED, "no source of contact modes gave a plan.")
        self._near: list[
            tuple[float, np.ndarray]
        ] = []  # (miss, modes) of rollouts that do not quite reach the goal
        answer, stride, is_refined = None, max(1, self._scene.task.steps // STRIDES), False
        for guess, fineness in self._guesses(budget, modes_of, start):
            answer = (
                self._continued(budget, problem, stride)
                if guess is None
                else self._exact(budget, problem, guess)
            )
            if answer is not None or budget.is_over:
                stride, is_refined = fineness or stride, fineness > 0
                break
        is_given_up, budget.most_work = budget.is_over, self._most_work
        if answer is None:
            outcome, message = self._ending
            if budget.is_late:
                outcome, message = (
                    Outcome.TIME_LIMIT,
                    "no feasible contact mode sequence was found within the time limit.",
                )
            elif budget.is_over:
                outcome, message = (
                    Outcome.ITERATION_LIMIT,
                    "no feasible contact mode sequence was found within the work limit.",
                )
            elif is_given_up:
                millions = self._options.first_work
                limit = f"the work limit of a first one (first_work, {millions:g} million)"
                outcome, message = (
                    Outcome.ITERATION_LIMIT,
                    f"no feasible contact mode sequence was found within {limit}.",
                )
            return FinderResult(answer=None, outcome=outcome, message=message)
        found = self.searched(budget, problem, answer, stride, far=not is_refined)
        cold = modes_of is None and start is None and not is_refined
        if (
            cold
            and isinstance(problem, ModesProblem)
            and self._options.search
            and self._scene.nc >= _MANY
            and not budget.is_over
        ):
            return self._searched_again(budget, problem, found, stride)
        return found

    # -- where modes come from
    #   --------------------------------------------------------------------------------------------------

    def _guesses(
        self, budget: SolveBudget, modes_of: Trajectory | None, start: Trajectory | None
    ) -> Iterator[tuple[Trajectory | None, int]]:
        """Plans whose modes are worth a try, with the stride (in steps) of a search around them, 0 for the usual one.

        None: no more from this source, so that what came nearest is continued to the goal.
        """
        if modes_of is not None:
            yield modes_of, 0
        coarse = self._coarse(budget, start)
        if coarse is not None:
            yield coarse
        if budget.is_over:
            return
        first = coarse[0] if coarse is not None else start if start is not None else modes_of
        had_plan, most = False, budget.most_work
        budget.most_work = min(
            most, budget.work + 0.5e6 * self._options.first_work
        )  # the rest is for other sources
        stages = self._stages(budget, first, STAGE_ITERATIONS)
        budget.most_work = most
        for plan in stages:
            had_plan = True
            yield plan, 0
        if not had_plan and not budget.is_over and self._is_out_of_reach(budget):
            return
        plan = None if budget.is_late or self._is_walked else self._relaxed(budget)
        if plan is not None:
            yield plan, 0
        yield None, 0
        for plan in self._corrected(budget, first):
            yield plan, 0
        yield None, 0
        self._random_failed = True
        if had_plan:
            for plan in self._stages(budget, first, self._options.max_iterations):
                yield plan, 0
            yield None, 0

    def _stages(
        self, budget: SolveBudget, begin_at: Trajectory | None, most_iterations: int
    ) -> list[Trajectory]:
        """The plans of the sharpest stages of the homotopy, the sharpest first."""
        own = self._options
        with budget.building():
            sharpnesses = schedule(own.first_sharpness, own.last_sharpness, own.sharpness_growth)
            homotopy = self._models.homotopy(sharpnesses)
        stages: list[Trajectory] = []
        ending = homotopy.run(
            budget,
            self._ipopt_options(own.homotopy_tolerance),
            begin_at,
            stages.append,
            most_iterations,
        )
        self._ending = self._reason(*ending)
        return stages[: -_STAGES - 1 : -1]

    def _relaxed(self, budget: SolveBudget) -> Trajectory | None:
        """The plan of relaxed complementarity, walked down from a loose bound: none of its forces acts at a distance.

        Two fingers that carry a disc have no softplus plan after 348 iterations, and modes that
        have a plan are read off here after 121. Its own rules limit the work of the walk; what is
        done with its plan may cost as much as a first one once more.
        """
        with load_method("relaxed_lcp").open(
            self._scene, {"first_eps": RELAXED_FROM, "max_iterations": _WALK}
        ) as session:
            found = session.solve(eps=RELAXED_TO, warm_start=None, time_limit=budget.remaining)
        budget.told(found)
        self._is_walked = True
        budget.most_work = min(self._most_work, budget.work + 0.5e6 * self._options.first_work)
        return found.trajectory

    def _corrected(self, budget: SolveBudget, first: Trajectory | None) -> Iterator[Trajectory]:
        """Random inputs, and those of a plan, corrected to end on the goal through softplus contact that grows sharper."""
        scene, kernel, own = self._scene, self._kernel, self._options
        for index in range(
            -1, 0 if self._random_failed else _RANDOM
        ):  # whatever the start, these are the same
            if budget.is_over:
                return
            plan = first if index < 0 else random_plan(scene, kernel, (own.seed, index))
            if plan is None:
                continue
            rollout, u = correct_end_by_softplus(scene, kernel, plan.u, own.first_sharpness)
            if not rollout.diverged:
                yield plan_of(scene, rollout, u)

    def _is_out_of_reach(self, budget: SolveBudget) -> bool:
        """Whether no plan reaches the goal within the input bounds.

        Asked where not even softplus contact had a plan.
        """
        if not self._scene.task.has_goal:
            return False
        found = nearest(self._scene, budget, budget.iterations + self._options.max_iterations)
        if found.is_out_of_reach:
            self._ending = (Outcome.INFEASIBLE, out_of_reach(self._scene, found))
        return found.is_out_of_reach

    def _coarse(
        self, budget: SolveBudget, start: Trajectory | None
    ) -> tuple[Trajectory, int] | None:
        """The best plan of a coarser grid, on this one."""
        coarse = coarse_scene(self._scene, self._options.coarse_steps)
        if coarse is None:
            return None
        begin_at = None if start is None else on_grid(start, coarse)
        begun, allowed = budget.work, budget.most_work
        budget.most_work = (
            self._most_work
        )  # what it searches once it has a plan is no search for a first one
        if self._on_coarse is None:
            models = SceneModels(coarse, self._kernel)
            self._on_coarse = Finder(models, self._options)
        found = self._on_coarse.find(budget, start=begin_at)
        budget.most_work = min(self._most_work, allowed + budget.work - begun)
        if found.answer is None:
            return None
        plan = rolled_plan(coarse, self._kernel, found.answer.u)
        return (
            None
            if plan is None
            else (
                on_grid(plan, self._scene),
                max(1, self._scene.task.steps // coarse.task.steps // 2),
            )
        )

    def _reason(self, outcome: Outcome, message: str) -> tuple[Outcome, str]:
        if outcome is Outcome.INFEASIBLE:
            return outcome, f"{no_plan(self._scene)}, not even with forces at a distance."
        if outcome is Outcome.SOLVED:
            return (
                Outcome.STALLED,
                "softplus plans were found, but the contact modes read off them have no exact plan.",
            )
        return outcome, f"softplus homotopy: {message}"

    # -- what is done with them
    #   --------------------------------------------------------------------------------------------------

    def _exact(
        self, budget: SolveBudget, problem: ModesProblem | NonlinearModes, plan: Trajectory
    ) -> ModesAnswer | None:
        """The optimum for the modes of a plan.

        Where they have none, for the modes of its inputs in true contact, corrected to end on the
        goal.

        The latter modes have a plan, namely that rollout, whenever it arrives.
        """
        begin = perf_counter()
        answer = None
        for closed in self._modes(plan):
            if isinstance(problem, NonlinearModes):
                problem.guess = plan
            answer = problem.solve(closed)
            if answer is not None or budget.is_over:
                break
        if self._is_linear:  # an Ipopt run adds its own time to the budget
            budget.linear_algebra += perf_counter() - begin
        return answer

    def _modes(self, plan: Trajectory) -> Iterator[np.ndarray]:
        yield self._kernel.penetration(plan.q[:-1]) > 0.0
        rollout, _ = correct_end(self._scene, self._kernel, plan.u)
        if rollout.diverged:
            return
        end = np.concatenate([rollout.q[-1], rollout.v[-1]])
        missed = distance(end, goal_state(self._scene.task))
        if missed <= _ARRIVED:
            yield rollout.lam > 0.0
        self._near.append((missed, rollout.lam > 0.0))

    def _continued(
        self, budget: SolveBudget, problem: ModesProblem | NonlinearModes, stride: int
    ) -> ModesAnswer | None:
        """From the modes of the rollouts that came nearest to the goal, nearest first."""
        begin = perf_counter()
        near, self._near = sorted(self._near, key=lambda pair: pair[0]), []
        answer = None
        if isinstance(problem, ModesProblem):
            for _, closed in near[:_NEAREST]:
                answer = continue_to_goal(problem, closed, stride, lambda: budget.is_over)
                if answer is not None or budget.is_over:
                    break
            budget.linear_algebra += perf_counter() - begin
        return answer

    def searched(
        self, budget: SolveBudget, problem: Any, answer: ModesAnswer, stride: int, *, far: bool
    ) -> FinderResult:
        """Search for the cheapest plan around. far: whether to look further than a step (a coarser grid has seen to that already)."""
        how = (
            "the rest is a convex quadratic program, solved exactly"
            if self._is_linear
            else "the rest was solved by Ipopt"
        )
        if not self._scene.nc:
            return FinderResult(
                answer=answer, outcome=Outcome.SOLVED, message=f"There are no contacts; {how}."
            )
        begin, most = perf_counter(), problem.solves + self._most_sequences()
        share = self._options.search_share
        end, done = (
            begin + share * budget.remaining,
            budget.work + share * (budget.most_work - budget.work),
        )

        def is_over() -> bool:
            return problem.solves >= most or budget.work >= done or perf_counter() >= end

        found = SearchResult(best=answer, tried=0, complete=False)
        if self._options.search:
            found = search_sequences(answer, problem.solve, stride=stride, is_over=is_over, far=far)
        is_late = perf_counter() >= end
        if not found.complete:  # the plan is to be stationary all the same
            last = problem.solves + self._most_sequences()
            flipped = flip_wrong_signs(
                found.best, problem.solve, is_over=lambda: problem.solves >= last or budget.is_over
            )
            found = SearchResult(
                best=flipped.best, tried=found.tried + flipped.tried, complete=False
            )
        if self._is_linear:
            budget.linear_algebra += perf_counter() - begin
        message = f"With the contact modes fixed {how}; {found.tried} neighbouring sequences were tried, none is cheaper than this plan."
        if isinstance(problem, NonlinearModes):
            known = f"{problem.unsolved} of {problem.solves} solves found no plan in a few iterations, which proves nothing"
            message = f"With the contact modes fixed {how}; of {found.tried} neighbouring sequences none was found to be cheaper ({known})."
        if not self._options.search:
            message = f"Contact modes were read off a softplus plan; {how}."
        elif not found.complete:
            why = (
                "its part of the time was over before all were"
                if is_late
                else "as many as it may try"
            )
            message = f"With the contact modes fixed {how}; {found.tried} neighbouring sequences were tried, {why}: others may be cheaper."
        return FinderResult(
            answer=found.best,
            outcome=Outcome.TIME_LIMIT if budget.is_late else Outcome.SOLVED,
            message=message,
            tried=found.tried,
        )

    def _searched_again(
        self, budget: SolveBudget, problem: ModesProblem, found: FinderResult, stride: int
    ) -> FinderResult:
        """Around the modes of other sources, until one leads below the plan: far only where shifts alone do."""
        assert found.answer is not None, "what was searched around has a plan"
        tried = found.tried
        for source, words in (
            (self._loosened, "loosened"),
            (self._walked, "walked down from a cold start"),
        ):
            answer = None if budget.is_over else source(budget, problem, found.answer)
            for far in (False, True):
                if answer is None:
                    break
                again = self.searched(budget, problem, answer, stride, far=far)
                tried, answer = tried + again.tried, again.answer
                if answer is None or answer.cost >= found.answer.cost:
                    break
            else:
                told = f"Around modes of relaxed contact, {words}; around those of softplus contact the cheapest plan costs {found.answer.cost:.6g}."
                return replace(again, tried=tried, message=f"{again.message} {told}")
        return replace(found, tried=tried)

    def _loosened(
        self, budget: SolveBudget, problem: ModesProblem, best: ModesAnswer
    ) -> ModesAnswer | None:
        """For the modes of loosely relaxed complementarity from a plan, where all contacts change theirs at once."""
        rollout, u = correct_end(self._scene, self._kernel, best.u)
        plan, answer = None if rollout.diverged else plan_of(self._scene, rollout, u), None
        with load_method("relaxed_lcp").open(self._scene) as session:
            for eps in _LOOSE:
                if plan is None or answer is not None or budget.is_over:
                    break
                loose = session.solve(eps=eps, warm_start=plan, time_limit=budget.remaining)
                budget.told(loose)
                plan = loose.trajectory
                answer = (
                    None if plan is None or budget.is_over else self._exact(budget, problem, plan)
                )
        return answer

    def _walked(
        self, budget: SolveBudget, problem: ModesProblem, best: ModesAnswer
    ) -> ModesAnswer | None:
        """For the modes of relaxed complementarity walked down, which knows nothing of the plan.

        Where the search's share is what a first plan may take.
        """
        room = self._options.search_share * (budget.most_work - budget.work)
        plan = (
            None
            if self._is_walked or room < 1e6 * self._options.first_work
            else self._relaxed(budget)
        )
        budget.most_work = self._most_work
        return None if plan is None or budget.is_over else self._exact(budget, problem, plan)

    def _most_sequences(self) -> int:
        """Mode sequences that a search may ask for.

        A nonlinear scene's cost a run of Ipopt each.
        """
        return self._options.search_windows // (1 if self._is_linear else _NONLINEAR)

    def _ipopt_options(self, tolerance: float) -> dict[str, Any]:
        return {"tol": tolerance, "max_iter": self._options.max_iterations}

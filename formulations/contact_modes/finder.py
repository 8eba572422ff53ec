"""Find the cheapest mode sequence of a scene: sources of modes, searches, and fallbacks."""

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

# Largest distance from the goal; the exact problem corrects it.
_ARRIVED = 1e-6
# The first stride is the number of steps divided by this: 4 steps of 500.
STRIDES = 125
# Stages of the homotopy whose modes are tried, sharpest first.
_STAGES = 3
# Random inputs corrected to end on the goal, if the first guess fails.
_RANDOM = 6
# A nonlinear scene tries this fraction of the mode sequences of a linear one.
_NONLINEAR = 20
# Number of contacts from which modes of other sources are searched too (`_searched_again`); with
# two contacts the first source led twenty starts of the three carts to one plan.
_MANY = 3
# Bounds of the relaxation [N^2], tried until modes have a plan.
_LOOSE = (0.3, 0.03, 3e-3)
# Iteration limit of a walk of relaxed complementarity, which follows the loosened modes. Six carts,
# task 3: 702 iterations lower the cost from 980.6 to 854.7. Task 11: 734 raise it to 2516, while
# loosened modes lower it from 2484.9 to 2377.6. Task 7: 1871 fail, while loosened modes lower it
# from 1557.3 to 1476.4.
_WALK = 800
# Closest rollouts that are continued to the goal.
_NEAREST = 3


@dataclass(frozen=True, kw_only=True)
class FinderResult:
    """The optimum of the best modes (None without a plan), outcome, and number of modes tried."""

    answer: ModesAnswer | None
    outcome: Outcome
    message: str
    tried: int = 0


class Finder:
    """Search contact modes of one scene; its models are reused by every solve."""

    def __init__(self, models: SceneModels, options: MpccOptions) -> None:
        self._scene, self._kernel, self._is_linear = models.scene, models.kernel, models.is_linear
        self._options, self._models = options, models
        # Relaxed complementarity was walked: its plan does not depend on the start.
        self._is_walked = False
        # All random inputs were corrected without a plan.
        self._random_failed = False
        self._on_coarse: Finder | None = None
        self._most_work = 0.0  # of the current search, after a first plan

    def find(
        self,
        budget: SolveBudget,
        modes_of: Trajectory | None = None,
        start: Trajectory | None = None,
    ) -> FinderResult:
        """Return the best plan.

        modes_of: a plan whose modes are tried first
        start: start of the homotopy (None: the paper's first guess)
        """
        with budget.building():
            problem = self._models.modes(budget, self._ipopt_options(self._options.tolerance))
        self._most_work = budget.most_work
        budget.most_work = min(self._most_work, budget.work + 1e6 * self._options.first_work)
        self._ending = (Outcome.FAILED, "no source of contact modes gave a plan.")
        # (distance, modes) of rollouts that end close to the goal.
        self._near: list[tuple[float, np.ndarray]] = []
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
        result = self.searched(budget, problem, answer, stride, far=not is_refined)
        cold = modes_of is None and start is None and not is_refined
        if (
            cold
            and isinstance(problem, ModesProblem)
            and self._options.search
            and self._scene.nc >= _MANY
            and not budget.is_over
        ):
            return self._searched_again(budget, problem, result, stride)
        return result

    def _guesses(
        self, budget: SolveBudget, modes_of: Trajectory | None, start: Trajectory | None
    ) -> Iterator[tuple[Trajectory | None, int]]:
        """Yield plans whose modes are worth trying, each with a stride of its search (0: default).

        None marks the end of a source: the closest rollouts are then continued to the goal.
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
        # The rest is for other sources.
        budget.most_work = min(most, budget.work + 0.5e6 * self._options.first_work)
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
        """Walk relaxed complementarity down from a loose bound; its forces need contact.

        Two fingers that carry a disc have no softplus plan after 348 iterations, but modes with a
        plan here after 121. The walk has limits of its own; using its plan may cost as much as a
        first one.
        """
        with load_method("relaxed_lcp").open(
            self._scene, {"first_eps": RELAXED_FROM, "max_iterations": _WALK}
        ) as session:
            solution = session.solve(eps=RELAXED_TO, warm_start=None, time_limit=budget.remaining)
        budget.add_solution(solution)
        self._is_walked = True
        budget.most_work = min(self._most_work, budget.work + 0.5e6 * self._options.first_work)
        return solution.trajectory

    def _corrected(self, budget: SolveBudget, first: Trajectory | None) -> Iterator[Trajectory]:
        scene, kernel, own = self._scene, self._kernel, self._options
        # The random inputs do not depend on the start.
        for index in range(-1, 0 if self._random_failed else _RANDOM):
            if budget.is_over:
                return
            plan = first if index < 0 else random_plan(scene, kernel, (own.seed, index))
            if plan is None:
                continue
            rollout, u = correct_end_by_softplus(scene, kernel, plan.u, own.first_sharpness)
            if not rollout.diverged:
                yield plan_of(scene, rollout, u)

    def _is_out_of_reach(self, budget: SolveBudget) -> bool:
        if not self._scene.task.has_goal:
            return False
        closest = nearest(self._scene, budget, budget.iterations + self._options.max_iterations)
        if closest.is_out_of_reach:
            self._ending = (Outcome.INFEASIBLE, out_of_reach(self._scene, closest))
        return closest.is_out_of_reach

    def _coarse(
        self, budget: SolveBudget, start: Trajectory | None
    ) -> tuple[Trajectory, int] | None:
        coarse = coarse_scene(self._scene, self._options.coarse_steps)
        if coarse is None:
            return None
        begin_at = None if start is None else on_grid(start, coarse)
        begun, allowed = budget.work, budget.most_work
        # Its search after a first plan may use all the work.
        budget.most_work = self._most_work
        if self._on_coarse is None:
            models = SceneModels(coarse, self._kernel)
            self._on_coarse = Finder(models, self._options)
        result = self._on_coarse.find(budget, start=begin_at)
        budget.most_work = min(self._most_work, allowed + budget.work - begun)
        if result.answer is None:
            return None
        plan = rolled_plan(coarse, self._kernel, result.answer.u)
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

    def _exact(
        self, budget: SolveBudget, problem: ModesProblem | NonlinearModes, plan: Trajectory
    ) -> ModesAnswer | None:
        """Return the optimum for the modes of a plan, or for those of its corrected rollout.

        The rollout's modes have a plan, namely the rollout, if it reaches the goal.
        """
        begin = perf_counter()
        answer = None
        for closed in self._modes(plan):
            if isinstance(problem, NonlinearModes):
                problem.guess = plan
            answer = problem.solve(closed)
            if answer is not None or budget.is_over:
                break
        if self._is_linear:  # an Ipopt run adds its own time
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
        """Search for the cheapest plan around an answer.

        far: whether to try repetitions and detours (a coarser grid has done so)
        """
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

        search = SearchResult(best=answer, tried=0, complete=False)
        if self._options.search:
            search = search_sequences(
                answer, problem.solve, stride=stride, is_over=is_over, far=far
            )
        is_late = perf_counter() >= end
        if not search.complete:  # the plan must be stationary in any case
            last = problem.solves + self._most_sequences()
            flipped = flip_wrong_signs(
                search.best, problem.solve, is_over=lambda: problem.solves >= last or budget.is_over
            )
            search = SearchResult(
                best=flipped.best, tried=search.tried + flipped.tried, complete=False
            )
        if self._is_linear:
            budget.linear_algebra += perf_counter() - begin
        message = f"With the contact modes fixed {how}; {search.tried} neighbouring sequences were tried, none is cheaper than this plan."
        if isinstance(problem, NonlinearModes):
            known = f"{problem.unsolved} of {problem.solves} solves found no plan in a few iterations, which proves nothing"
            message = f"With the contact modes fixed {how}; of {search.tried} neighbouring sequences none was found to be cheaper ({known})."
        if not self._options.search:
            message = f"Contact modes were read off a softplus plan; {how}."
        elif not search.complete:
            why = (
                "its part of the time was over before all were"
                if is_late
                else "as many as it may try"
            )
            message = f"With the contact modes fixed {how}; {search.tried} neighbouring sequences were tried, {why}: others may be cheaper."
        return FinderResult(
            answer=search.best,
            outcome=Outcome.TIME_LIMIT if budget.is_late else Outcome.SOLVED,
            message=message,
            tried=search.tried,
        )

    def _searched_again(
        self, budget: SolveBudget, problem: ModesProblem, result: FinderResult, stride: int
    ) -> FinderResult:
        """Search around the modes of other sources, until one leads to a cheaper plan."""
        assert result.answer is not None, "what was searched around has a plan"
        tried = result.tried
        for source, words in (
            (self._loosened, "loosened"),
            (self._walked, "walked down from a cold start"),
        ):
            answer = None if budget.is_over else source(budget, problem, result.answer)
            for far in (False, True):
                if answer is None:
                    break
                again = self.searched(budget, problem, answer, stride, far=far)
                tried, answer = tried + again.tried, again.answer
                if answer is None or answer.cost >= result.answer.cost:
                    break
            else:
                source_note = f"Around modes of relaxed contact, {words}; around those of softplus contact the cheapest plan costs {result.answer.cost:.6g}."
                return replace(again, tried=tried, message=f"{again.message} {source_note}")
        return replace(result, tried=tried)

    def _loosened(
        self, budget: SolveBudget, problem: ModesProblem, best: ModesAnswer
    ) -> ModesAnswer | None:
        """Return the optimum for modes of loosely relaxed complementarity around a plan.

        All contacts may change their modes together there.
        """
        rollout, u = correct_end(self._scene, self._kernel, best.u)
        plan, answer = None if rollout.diverged else plan_of(self._scene, rollout, u), None
        with load_method("relaxed_lcp").open(self._scene) as session:
            for eps in _LOOSE:
                if plan is None or answer is not None or budget.is_over:
                    break
                loose = session.solve(eps=eps, warm_start=plan, time_limit=budget.remaining)
                budget.add_solution(loose)
                plan = loose.trajectory
                answer = (
                    None if plan is None or budget.is_over else self._exact(budget, problem, plan)
                )
        return answer

    def _walked(
        self, budget: SolveBudget, problem: ModesProblem, best: ModesAnswer
    ) -> ModesAnswer | None:
        room = self._options.search_share * (budget.most_work - budget.work)
        plan = (
            None
            if self._is_walked or room < 1e6 * self._options.first_work
            else self._relaxed(budget)
        )
        budget.most_work = self._most_work
        return None if plan is None or budget.is_over else self._exact(budget, problem, plan)

    def _most_sequences(self) -> int:
        return self._options.search_windows // (1 if self._is_linear else _NONLINEAR)

    def _ipopt_options(self, tolerance: float) -> dict[str, Any]:
        return {"tol": tolerance, "max_iter": self._options.max_iterations}

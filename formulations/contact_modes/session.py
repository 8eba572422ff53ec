"""`mpcc` opened on a scene: several starts, contact modes found from each, the cheapest plan kept, corrected to end on the goal, and checked.

    softplus homotopy -> which contact is closed when -> exact optimum for these modes -> cheaper
    modes -> rollout of the inputs

| number | start |
|---|---|
| 0 | the plan given, or the paper's first guess |
| 1 | the modes of a softplus chain, eps = 1e-3, 1e-5, 1e-7 |
| 2 | the modes of a softplus shooting solution, same eps |
| 3, 4 | both in the mirror of the scene, if it has one |
| others | seeded random inputs, in turn as start of a homotopy and, corrected to end on the goal, as source of modes |

The homotopy forgets where it began, modes do not: hence both.

Throws: where the end is free and has a cost, a plan that touches nothing may be a local optimum
    from which no slope leads to a contact. A disc at rest,
and another whose place at the end is paid for: nothing done costs 0.61, a throw off the wall 0.39,
    and all that lies between is dearer.

    constant inputs on a lattice -> those that press something and end at less final cost -> the
    cheapest, solved with their contact modes

Modes are then searched around the best of these plans as around any other.

The plan is the rollout of its own inputs through the true contact law: complementarity is zero by
construction, and what the solvers leave of the terminal error (1e-9) is taken out by Newton steps.
"""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from formulations.contact_modes.finder import STRIDES, Finder, FinderResult
from formulations.contact_modes.goal import correct_end
from formulations.contact_modes.method import MpccOptions
from formulations.contact_modes.nonlinear import STAGE_ITERATIONS, NonlinearModes, SceneModels
from formulations.contact_modes.quadratic import ModesAnswer, ModesProblem
from formulations.contact_modes.starts import (
    descended_plan,
    final_cost,
    mirrored,
    random_plan,
    thrown_plans,
)
from formulations.grids import check_warm_start, input_bounds, plan_of, replayed_goal_error
from formulations.method import Clock, Method, Session
from formulations.mpec.certificate.certificate import Certificate
from formulations.mpec.certificate.plan import certify_plan
from formulations.solution import Attempt, Outcome, Solution, checked
from formulations.transcription.method import SolveBudget
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.trajectory import Trajectory

_SOLVED = 6  # of the cheapest throws are solved with their contact modes, in 0.3 CPU s each
_PRESSED = 1e-6  # [N] a contact that is pressed with less is left open: Ipopt keeps forces to 1e-8
_CHAIN = tuple(float(-np.log(eps)) for eps in (1e-3, 1e-5, 1e-7))  # b L = |ln eps|


class MultiStart:
    """The starts of one scene, and its throws. finder: searches modes from each, and around the best throw."""

    def __init__(self, models: SceneModels, finder: Finder, options: MpccOptions) -> None:
        self._scene, self._kernel = models.scene, models.kernel
        self._finder, self._options, self._models = finder, options, models

    def run(
        self, budget: SolveBudget, warm_start: Trajectory | None
    ) -> tuple[FinderResult, tuple[Attempt, ...]]:
        """Try the starts; return the best result and an attempt for each start that had time.

        A start may do half of the work that is left, the last one all of it: better some starts
        that come to their end than none.
        """
        best: FinderResult | None = None
        attempts: list[Attempt] = []
        most = budget.most_work
        for number in range(self._options.starts):
            left = self._options.starts - number
            budget.most_work = budget.work + (most - budget.work) / min(2, left)
            if best is not None and budget.is_over:
                break
            words, plan, for_modes = self._start(budget, number, warm_start)
            found = self._finder.find(budget, plan if for_modes else None, plan)
            attempts.append(_attempt(words, found))
            if best is None or _cost(found) < _cost(best):
                best = found
        assert best is not None, "there is at least one start: the options see to that"
        thrown = self._thrown_instead(best, budget)
        if thrown is not best:
            place = min(
                range(len(attempts)),
                key=lambda place: (attempts[place].cost is None, attempts[place].cost or 0.0),
            )
            attempts[place] = _attempt(f"{attempts[place].start}, then throws", thrown)
        return thrown, tuple(attempts)

    def _start(
        self, budget: SolveBudget, number: int, warm_start: Trajectory | None
    ) -> tuple[str, Trajectory | None, bool]:
        """A start in words, its plan, and whether the plan's own modes are tried first."""
        if number == 0:
            return (
                "the paper's first guess" if warm_start is None else "the plan given",
                warm_start,
                warm_start is not None,
            )
        plan, words = self._special(budget, number) if number <= 4 else (None, "")
        if plan is not None:
            return words, plan, True
        plan = random_plan(self._scene, self._kernel, (self._options.seed, number))
        for_modes = number % 2 == 0 and plan is not None
        return (
            "random inputs, steered to the goal" if for_modes else "random inputs",
            plan,
            for_modes,
        )

    def _special(self, budget: SolveBudget, number: int) -> tuple[Trajectory | None, str]:
        """The starts 1 to 4, by name."""
        if number in (1, 3):
            plan, words = self._chain(budget), "softplus chain"
        else:
            plan, words = descended_plan(self._scene, self._kernel), "softplus gradient descent"
        if number <= 2 or plan is None:
            return plan, words
        return mirrored(self._scene, self._kernel, plan), f"{words}, mirrored"

    def _chain(self, budget: SolveBudget) -> Trajectory | None:
        stages: list[Trajectory] = []
        with budget.building():
            homotopy = self._models.homotopy(_CHAIN)
        ipopt = {"tol": self._options.homotopy_tolerance, "max_iter": self._options.max_iterations}
        homotopy.run(budget, ipopt, None, stages.append)
        return stages[-1] if stages else None

    # -- throws
    #   -------------------------------------------------------------------------------------------------------------------

    def _thrown_instead(self, before: FinderResult, budget: SolveBudget) -> FinderResult:
        """Find a cheaper plan that throws, or leave the one before.

        It stays where there is a goal, where the end costs nothing, and where its inputs press a
        contact that is not pressed without them.
        """
        task = self._scene.task
        if task.has_goal or task.final_cost == 0 or not self._scene.nc or budget.is_late:
            return before
        work = 1e6 * self._options.throw_work
        none = np.clip(np.zeros((task.steps, self._scene.nu)), *input_bounds(self._scene))
        idle = self._pressed(none)
        planned = none if before.answer is None else before.answer.u
        if work == 0.0 or (self._pressed(planned) & ~idle).any():
            return before
        budget.most_work = (
            budget.work + work
        )  # on top of what the starts were given: they may have spent it
        problem, best = self._best_throw(budget, planned, idle)
        if best is None or (before.answer is not None and best.cost >= before.answer.cost):
            return before
        found = self._finder.searched(
            budget, problem, best, max(1, task.steps // STRIDES), far=True
        )
        first = (
            "no plan was found"
            if before.answer is None
            else f"the best plan brought no contact about (cost {before.answer.cost:.6g})"
        )
        return replace(
            found,
            message=f"At first {first}; this one was found from throws by constant inputs. {found.message}",
        )

    def _best_throw(
        self, budget: SolveBudget, planned: np.ndarray, idle: np.ndarray
    ) -> tuple[ModesProblem | NonlinearModes, ModesAnswer | None]:
        """The problem with modes fixed, and the cheapest of its answers to the modes of throws."""
        with budget.building():
            below = final_cost(
                self._kernel,
                self._kernel.rollout(
                    np.array(self._scene.task.start), planned, self._scene.task.step
                ),
            )
            seed = (self._options.seed, 0)
            plans = thrown_plans(self._scene, self._kernel, seed, idle, below)[:_SOLVED]
            most = min(self._options.max_iterations, STAGE_ITERATIONS)
            problem = self._models.modes(budget, {"tol": self._options.tolerance, "max_iter": most})
        answers: list[ModesAnswer] = []
        for plan in plans:
            if isinstance(problem, NonlinearModes):
                problem.guess = plan
            answer = None if budget.is_over else problem.solve(plan.lam > 0.0)
            if answer is not None:
                answers.append(answer)
        return problem, min(answers, key=lambda answer: answer.cost, default=None)

    def _pressed(self, u: np.ndarray) -> np.ndarray:
        """(nc,) whether these inputs press a contact at any time."""
        rollout = self._kernel.rollout(np.array(self._scene.task.start), u, self._scene.task.step)
        return np.any(rollout.lam[:, : self._scene.nc] > _PRESSED, axis=0, keepdims=False)


def _cost(search: FinderResult) -> float:
    return float("inf") if search.answer is None else search.answer.cost


def _attempt(start: str, found: FinderResult) -> Attempt:
    cost = None if found.answer is None else float(found.answer.cost)
    return Attempt(start=start, outcome=found.outcome, cost=cost)


class MpccSession(Session):
    """`mpcc` on one scene."""

    def __init__(self, method: Method, scene: Scene, options: MpccOptions, clock: Clock) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._kernel, self._residuals = load_kernel(scene), PlanResiduals(scene)
        models = SceneModels(scene, self._kernel)
        self._starts = MultiStart(models, Finder(models, options), options)
        self._clock = clock

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Find a plan from the starts asked for.

        Raises TrajectoryError for a plan of another scene or grid.
        """
        self._method.check_stage(eps, time_limit)
        check_warm_start(self._scene, warm_start)
        budget = SolveBudget(time_limit, self._clock.pay())
        budget.most_work = 1e6 * self._options.work
        search, attempts = self._starts.run(budget, warm_start)
        return self._solution(budget, search, attempts)

    def _solution(
        self, budget: SolveBudget, search: FinderResult, attempts: tuple[Attempt, ...]
    ) -> Solution:
        several = attempts if len(attempts) > 1 else ()
        empty = Solution(
            method=self._method.name,
            outcome=search.outcome,
            message=search.message,
            options=asdict(self._options),
            starts=several,
        )
        answer = search.answer
        if answer is None:
            return budget.spent_on(empty)
        rollout, u = correct_end(self._scene, self._kernel, answer.u)
        plan = plan_of(self._scene, rollout, u)
        residuals = self._plan_residuals(plan)
        stationarity = answer.stationarity()
        if several:
            optima = [attempt.cost for attempt in several if attempt.cost is not None]
            spread = f"costs from {min(optima):.6g} to {max(optima):.6g}"
            search = replace(
                search,
                message=f"{len(optima)} of {self._options.starts} starts were solved, {spread}. {search.message}",
            )
            residuals |= {"starts_solved": float(len(optima)), "dearest_start": max(optima)}
        outcome, message = search.outcome, f"{search.message} {stationarity.sentence}"
        outcome, message = checked(outcome, message, residuals, self._promises())
        certificate = None
        if outcome is Outcome.SOLVED and not stationarity.strong:
            certificate = certify_plan(self._scene, plan)
            outcome, message = _stationary(certificate, message)
        residuals |= {
            "dual_infeasibility": answer.dual_infeasibility,
            "biactive_pairs": float(stationarity.biactive),
            "least_biactive_multiplier": stationarity.least,
            "windows_tried": float(search.tried),
        }
        cost = self._residuals.cost(plan)
        found = replace(
            empty,
            outcome=outcome,
            message=message,
            trajectory=plan,
            cost=cost,
            residuals=residuals,
            certificate=certificate,
        )
        return budget.spent_on(found)

    def _plan_residuals(self, plan: Trajectory) -> dict[str, float]:
        """Residuals of the plan by name.

        Complementarity with the penetration of the same compiled code that the forces come from.
        """
        found = self._residuals.of(plan)
        if self._scene.nc:
            products = np.abs(
                plan.lam
                * (plan.lam - self._kernel.stiffness() * self._kernel.penetration(plan.q[:-1]))
            )
            found |= {"physics": float(products.sum()), "complementarity": float(products.max())}
        return {
            **found,
            "discrete_terminal_error": replayed_goal_error(self._scene, self._kernel, plan),
        }

    def _promises(self) -> dict[str, float]:
        plan, miss = self._options.plan_tolerance, self._options.terminal_tolerance
        return {
            **dict.fromkeys(
                (
                    "dynamics_defect",
                    "start_error",
                    "input_bound_excess",
                    "velocity_bound_excess",
                    "force_sign",
                ),
                plan,
            ),
            **dict.fromkeys(("terminal_error", "discrete_terminal_error"), miss),
            "physics": self._options.physics_tolerance,
        }


def _stationary(found: Certificate, message: str) -> tuple[Outcome, str]:
    """Multipliers of touching pairs have the wrong sign, and no other mode was found to be cheaper: whether the plan can be left downhill after all.

    Where conditions depend on each other the multipliers are not the only ones, and others may have
    the right signs.
    """
    if found.b_stationary:
        return (
            Outcome.SOLVED,
            f"{message} These multipliers are not the only ones: no direction leads downhill (B-stationary).",
        )
    known = (
        "it is not B-stationary, so that cheaper plans lie next to it"
        if found.b_stationary is False
        else "whether it is B-stationary is not known"
    )
    return Outcome.STALLED, f"{message} The plan holds, but {known}: {found.sentence}."

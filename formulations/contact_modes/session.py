"""The session of `mpcc`: find contact modes from several starts, keep the cheapest plan, check it.

The starts by number:

- 0: the given plan, or the paper's first guess
- 1: the modes of a softplus chain, eps = 1e-3, 1e-5, 1e-7
- 2: the modes of a softplus shooting solution, same eps
- 3, 4: both in the mirror of the scene, if it has one
- more: seeded random inputs, as homotopy start and as source of modes in turn

The plan is the rollout of its inputs, so complementarity is exact; Newton steps correct its end.
"""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from formulations.certificate.certificate import Certificate
from formulations.certificate.plan import certify_plan
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
from formulations.solution import Attempt, Outcome, Solution, checked
from formulations.transcription.method import SolveBudget
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.trajectory import Trajectory

# Number of cheapest throws solved with their contact modes, in 0.3 CPU s each.
_SOLVED = 6
# A contact with a smaller force [N] stays open: Ipopt keeps forces to 1e-8.
_PRESSED = 1e-6
# b L = |ln eps|.
_CHAIN = tuple(float(-np.log(eps)) for eps in (1e-3, 1e-5, 1e-7))


class MultiStart:
    """The starts of one scene, and its throws; `finder` searches modes from each."""

    def __init__(self, models: SceneModels, finder: Finder, options: MpccOptions) -> None:
        self._scene, self._kernel = models.scene, models.kernel
        self._finder, self._options, self._models = finder, options, models

    def run(
        self, budget: SolveBudget, warm_start: Trajectory | None
    ) -> tuple[FinderResult, tuple[Attempt, ...]]:
        """Try the starts; return the best result, and an attempt for each start that ran.

        Each start may use half of the remaining work, the last one all of it.
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
            result = self._finder.find(budget, plan if for_modes else None, plan)
            attempts.append(_attempt(words, result))
            if best is None or _cost(result) < _cost(best):
                best = result
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
        """Return name and plan of a start, and whether the plan's own modes are tried first."""
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

    def _thrown_instead(self, before: FinderResult, budget: SolveBudget) -> FinderResult:
        """Return a cheaper plan that throws, or the previous result.

        With a free end that has a cost, a plan without contact can be a local optimum. Example: a
            disc
        throws another off a wall at cost 0.39; no motion costs 0.61, everything between costs more.
        Skipped with a goal, without a final cost, and if the plan already presses a contact.
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
        # In addition to the work of the starts, which may be used up.
        budget.most_work = budget.work + work
        problem, best = self._best_throw(budget, planned, idle)
        if best is None or (before.answer is not None and best.cost >= before.answer.cost):
            return before
        thrown = self._finder.searched(
            budget, problem, best, max(1, task.steps // STRIDES), far=True
        )
        first = (
            "no plan was found"
            if before.answer is None
            else f"the best plan brought no contact about (cost {before.answer.cost:.6g})"
        )
        return replace(
            thrown,
            message=f"At first {first}; this one was found from throws by constant inputs. {thrown.message}",
        )

    def _best_throw(
        self, budget: SolveBudget, planned: np.ndarray, idle: np.ndarray
    ) -> tuple[ModesProblem | NonlinearModes, ModesAnswer | None]:
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
        rollout = self._kernel.rollout(np.array(self._scene.task.start), u, self._scene.task.step)
        return np.any(rollout.lam[:, : self._scene.nc] > _PRESSED, axis=0, keepdims=False)


def _cost(search: FinderResult) -> float:
    return float("inf") if search.answer is None else search.answer.cost


def _attempt(start: str, result: FinderResult) -> Attempt:
    cost = None if result.answer is None else float(result.answer.cost)
    return Attempt(start=start, outcome=result.outcome, cost=cost)


class MpccSession(Session):
    """The session of `mpcc`."""

    def __init__(self, method: Method, scene: Scene, options: MpccOptions, clock: Clock) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._kernel, self._residuals = load_kernel(scene), PlanResiduals(scene)
        models = SceneModels(scene, self._kernel)
        self._starts = MultiStart(models, Finder(models, options), options)
        self._clock = clock

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Find a plan. Raises TrajectoryError for a plan of another scene or grid."""
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
        solution = replace(
            empty,
            outcome=outcome,
            message=message,
            trajectory=plan,
            cost=cost,
            residuals=residuals,
            certificate=certificate,
        )
        return budget.spent_on(solution)

    def _plan_residuals(self, plan: Trajectory) -> dict[str, float]:
        """Return the residuals by name.

        Complementarity uses the penetration of the compiled rollout.
        """
        residuals = self._residuals.of(plan)
        if self._scene.nc:
            products = np.abs(
                plan.lam
                * (plan.lam - self._kernel.stiffness() * self._kernel.penetration(plan.q[:-1]))
            )
            residuals |= {
                "physics": float(products.sum()),
                "complementarity": float(products.max()),
            }
        return {
            **residuals,
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


def _stationary(certificate: Certificate, message: str) -> tuple[Outcome, str]:
    """Judge a plan whose touching pairs have multipliers of the wrong sign, without cheaper modes.

    With dependent conditions other multipliers may have the right signs.
    """
    if certificate.b_stationary:
        return (
            Outcome.SOLVED,
            f"{message} These multipliers are not the only ones: no direction leads downhill (B-stationary).",
        )
    consequence = (
        "it is not B-stationary, so that cheaper plans lie next to it"
        if certificate.b_stationary is False
        else "whether it is B-stationary is not known"
    )
    return Outcome.STALLED, f"{message} The plan holds, but {consequence}: {certificate.sentence}."

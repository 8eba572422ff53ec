"""Solve a model for decreasing eps, in stages of bounded work.

After a failure at a larger eps the same start is not tried again. A stage that fails from a plan of
this session is preceded by one at the geometric mean of both eps. `Stage.walk` adapts the steps
itself, from a loose eps that leaves the choice of contacts open.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any, cast

from formulations.ipopt import IpoptResult
from formulations.ipopt.linear_solver import band_options
from formulations.method import Clock, Method
from formulations.solution import Outcome, Solution, beyond, ended
from formulations.transcription.contact import ContactFormulation
from formulations.transcription.method import SolveBudget, StageRules, TranscriptionOptions, Work
from formulations.transcription.solving import PlanSolver
from models.contact_law import ContactLaw as ForceLaw
from models.scene import Scene
from models.trajectory import Trajectory

__all__ = ["ContactFormulation", "Homotopy", "Stage", "band_options"]

# Factor of the sharpness at the first step of a walk. Steps of transport take 8 to 42 iterations
# with 1.4 or 2.
_FACTOR = 2.0
# Smallest factor.
_LEAST = 1.2
# Largest factor.
_LARGEST = 16.0
# A step of fewer iterations squares the factor.
_FEW = 30
# A step of more iterations, or without a plan, takes its square root.
_MANY = 100
# Number of such reductions that ends the walk.
_SHRINKS = 3


class Homotopy:
    """The model of one method on a scene; `rules` are those of a stage at an eps."""

    def __init__(
        self,
        method: Method,
        scene: Scene,
        contact: ContactFormulation,
        options: TranscriptionOptions,
        clock: Clock,
        rules: Callable[[float], StageRules],
    ) -> None:
        self._method, self.options, self.rules = method, options, rules
        self.solver = PlanSolver(scene, contact, options, clock)
        # eps, start and outcome of a stage without a plan.
        self._failure: tuple[float, Trajectory | None, Outcome] | None = None

    def solve(
        self,
        eps: float | None,
        start: Trajectory | None,
        time_limit: float,
        first: float,
        begin: Callable[[Stage, float], IpoptResult],
    ) -> Solution:
        """Run one stage: `begin` solves at the larger of first and eps; then walk down to eps.

        Nothing runs if a larger eps failed from this start. Cold starts of softplus contact differ
        by eps, since contact acts at another distance; complementarity plans of a smaller bound are
        feasible for a larger one.
        """
        self._method.check_stage(eps, time_limit)
        eps = cast(float, eps)
        softer, before, ending = self._failure or (0.0, None, Outcome.STALLED)
        is_nested = not self.solver.is_softplus
        if start is before and eps < softer and (is_nested or start is not None):
            message = (
                f"Not tried: this start gave no plan at eps = {softer:g}, where contact is softer."
            )
            outcome = ending if is_nested and ending is Outcome.INFEASIBLE else Outcome.STALLED
            return Solution(
                method=self._method.name,
                outcome=outcome,
                message=message,
                options=asdict(self.options),
            )
        budget = self.solver.begin(eps, start, time_limit)
        stage, first = self.stage(budget), max(eps, first)
        result, eps = stage.walk(begin(stage, first), first, eps)
        rules = self.rules(eps)
        limits = {"plan_limits": rules.plan_limits, "promises": rules.promises}
        solution = self.solver.solution(
            self._method.name, budget, result, lambda plan: self.residuals(plan, eps), **limits
        )
        if solution.trajectory is None and solution.outcome is not Outcome.TIME_LIMIT:
            self._failure = eps, start, solution.outcome
        return solution

    def stage(self, budget: SolveBudget) -> Stage:
        """Return a stage with this budget."""
        return Stage(self, budget)

    def residuals(self, plan: Trajectory, eps: float) -> dict[str, float]:
        """Return the residuals of a plan by name, for the contact law at this eps."""
        of = self.solver.residuals.of
        return of(plan, ForceLaw.SOFTPLUS, eps) if self.solver.is_softplus else of(plan)

    def sharper(self, eps: float, factor: float) -> float:
        """Return the eps of contact that is sharper by a factor."""
        return eps**factor if self.solver.is_softplus else eps / factor**2


class Stage:
    """The solves of one stage, with limited iterations."""

    def __init__(self, homotopy: Homotopy, budget: SolveBudget) -> None:
        self._homotopy, self._solver, self.budget = homotopy, homotopy.solver, budget
        self._spent = 0  # iterations

    @property
    def may_go_on(self) -> bool:
        """Return whether time and iterations remain."""
        return not self.budget.is_over and self._spent < self._homotopy.options.max_iterations

    def reach(self, eps: float, start: Trajectory | None) -> IpoptResult:
        """Solve at this eps from the loaded start.

        If the start is a plan of this session and the solve fails, insert a stage half way.
        """
        previous = None if start is None else self._solver.solved_before(start)
        result = self.solve(eps, start)
        if (
            previous is not None
            and self.may_go_on
            and result.outcome is not Outcome.SOLVED
            and self.left(eps) is None
        ):
            between = math.sqrt(previous.eps * eps)
            self._solver.load(previous.plan)
            if self.solve(between, previous.plan).outcome is Outcome.SOLVED:
                result = self.solve(eps, self._solver.read())
                words = (
                    f"It was solved via eps = {between:g}, because the direct step found no plan."
                )
                result = replace(result, message=f"{ended(result.message)} {words}".lstrip())
        return result

    def walk(self, result: IpoptResult, first: float, eps: float) -> tuple[IpoptResult, float]:
        """Walk from the first eps down to this one, each step from the previous plan.

        Return also the eps of the last plan, which the model holds.
        """
        reached, factor = first, _FACTOR
        known, shrinks = self._solver.last, 0
        while known is not None and reached > eps and self.may_go_on and shrinks < _SHRINKS:
            sharper, before = self._homotopy.sharper, self._spent
            there = sharper(reached, factor) if sharper(reached, factor**1.1) > eps else eps
            self._solver.load(known.plan)
            self._solver.last = known
            result = self.solve(there, known.plan)
            if result.outcome is Outcome.SOLVED:
                reached, known, shrinks = there, self._solver.last, 0
                spent = self._spent - before
                factor = (
                    min(_LARGEST, factor**2)
                    if spent <= _FEW
                    else max(_LEAST, math.sqrt(factor))
                    if spent > _MANY
                    else factor
                )
            else:
                factor, shrinks = math.sqrt(factor), shrinks + 1
        if known is not None and reached > eps:
            self._solver.load(known.plan)
            words = f"The walk to eps = {eps:g} ended at {reached:.3g}."
            limit = Outcome.TIME_LIMIT if self.budget.is_over else Outcome.ITERATION_LIMIT
            outcome = {Outcome.SOLVED: limit, Outcome.INFEASIBLE: Outcome.STALLED}.get(
                result.outcome, result.outcome
            )
            result = replace(
                result, outcome=outcome, message=f"{ended(result.message)} {words}".lstrip()
            )
        return result, reached

    def solve(
        self, eps: float, start: Trajectory | None, *, cold_work: Work | None = None
    ) -> IpoptResult:
        """Solve once at this eps from the loaded start; cold_work replaces the rules' limit."""
        rules = self._homotopy.rules(eps)
        # Work counts nonzeros of a softplus model, and unknowns of a complementarity model.
        size = (
            self._solver.problem(self.budget).nonzeros
            if self._solver.is_softplus
            else self._solver.unknowns
        )
        begun = self.budget.iterations
        cold = self._limited({**rules.ipopt, **rules.cold}, cold_work or rules.cold_work, size)
        warm = self._limited({**rules.ipopt}, rules.warm_work, size)
        result = self._solver.solve_at(
            eps, start, self.budget, rules, cold if start is None else warm, warm
        )
        self._spent += self.budget.iterations - begun
        return result

    def left(self, eps: float) -> Trajectory | None:
        """Return the plan left by a solve at eps, or None."""
        plan = self._solver.read()
        return (
            None
            if beyond(self._homotopy.rules(eps).plan_limits, self._homotopy.residuals(plan, eps))
            else plan
        )

    def _limited(self, options: dict[str, Any], work: Work | None, size: int) -> dict[str, Any]:
        left = max(0, options["max_iter"] - self._spent)
        most = left if work is None else min(left, work.iterations(size))
        return {**options, "max_iter": self.budget.iterations + most}

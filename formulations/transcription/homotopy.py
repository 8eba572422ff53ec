"""A model solved for ever smaller eps: a stage gets a bounded amount of work, and what it leaves is handed on only if it is a plan.

Where contact is softer and there was no plan, none is looked for from the same start. A stage that
leads from a plan of this session to none is solved half way before, at the geometric mean of the
two eps. Iterations of softplus contact from 1e-3 to 1e-5, directly and by 1e-4: transport 983
without a plan and 190 with one, hopper_planar 292 without and 166 with one.

`Stage.walk` chooses the eps itself: from a loose one, in steps of the sharpness that grow where
they were cheap, and shrink where they were dear or led to no plan. Where the first eps is too
small, the plan is caught where contact happens to be; a plan of a loose one has still the choice.
Cost of the exact plan in the end, relaxed 1e-2, 1e-3, 1e-4 and walked from 0.9: transport 0.916 and
0.704, two_finger 49.5 and 45.6.
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

# Of a walk: the factor of the sharpness at its first step, its least and largest; squared after a
# step of few iterations, its root taken after one of many or one without a plan, so often before
# the walk ends. Steps of transport take 8 to 42 iterations with a factor of 1.4 or 2.
_FACTOR = 2.0
_LEAST = 1.2
_LARGEST = 16.0
_FEW = 30
_MANY = 100
_SHRINKS = 3


class Homotopy:
    """One method's model on a scene. rules: what the method asks of a stage at an eps."""

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
        self._failure: tuple[float, Trajectory | None, Outcome] | None = (
            None  # eps, start and end of a stage that gave no plan
        )

    def solve(
        self,
        eps: float | None,
        start: Trajectory | None,
        time_limit: float,
        first: float,
        begin: Callable[[Stage, float], IpoptResult],
    ) -> Solution:
        """One stage: what `begin` finds at the first eps, where that is the larger one, walked down to this one; that there is no plan is remembered.

        Where there was none at a larger eps from this very start, it is not tried. A cold start of
        softplus contact is another one at each eps: contact acts from less far away. But plans of a
        smaller bound of complementarity are among those of a larger one.
        """
        self._method.check_stage(eps, time_limit)
        eps = cast(float, eps)
        softer, before, ending = self._failure or (0.0, None, Outcome.STALLED)
        is_nested = not self.solver.is_softplus
        if start is before and eps < softer and (is_nested or start is not None):
            message = f"Not tried: from this start there was no plan at eps = {softer:g} either, where contact is softer."
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
        found = self.solver.solution(
            self._method.name, budget, result, lambda plan: self.residuals(plan, eps), **limits
        )
        if found.trajectory is None and found.outcome is not Outcome.TIME_LIMIT:
            self._failure = eps, start, found.outcome
        return found

    def stage(self, budget: SolveBudget) -> Stage:
        """A stage that spends of this budget."""
        return Stage(self, budget)

    def residuals(self, plan: Trajectory, eps: float) -> dict[str, float]:
        """Residuals of a plan by name, held against the contact law at this eps."""
        of = self.solver.residuals.of
        return of(plan, ForceLaw.SOFTPLUS, eps) if self.solver.is_softplus else of(plan)

    def sharper(self, eps: float, factor: float) -> float:
        """The eps at which contact is sharper by a factor."""
        return eps**factor if self.solver.is_softplus else eps / factor**2


class Stage:
    """The solves of one stage, whose iterations are limited for each."""

    def __init__(self, homotopy: Homotopy, budget: SolveBudget) -> None:
        self._homotopy, self._solver, self.budget = homotopy, homotopy.solver, budget
        self._spent = 0  # iterations of its solves

    @property
    def may_go_on(self) -> bool:
        """Whether time and iterations are left."""
        return not self.budget.is_over and self._spent < self._homotopy.options.max_iterations

    def reach(self, eps: float, start: Trajectory | None) -> IpoptResult:
        """Solve at this eps from the start, which the model holds already.

        By half way where it is a plan of this session and leads to none.
        """
        known = None if start is None else self._solver.solved_before(start)
        result = self.solve(eps, start)
        if (
            known is not None
            and self.may_go_on
            and result.outcome is not Outcome.SOLVED
            and self.left(eps) is None
        ):
            between = math.sqrt(known.eps * eps)
            self._solver.load(known.plan)
            if self.solve(between, known.plan).outcome is Outcome.SOLVED:
                result = self.solve(eps, self._solver.read())
                words = f"It went by eps = {between:g}: directly there was no plan."
                result = replace(result, message=f"{ended(result.message)} {words}".lstrip())
        return result

    def walk(self, result: IpoptResult, first: float, eps: float) -> tuple[IpoptResult, float]:
        """From what was found at the first eps down to this one, each step from the plan before.

        And the eps of the last plan, which the model holds.
        """
        here, factor = first, _FACTOR
        known, shrinks = self._solver.last, 0
        while known is not None and here > eps and self.may_go_on and shrinks < _SHRINKS:
            sharper, before = self._homotopy.sharper, self._spent
            there = sharper(here, factor) if sharper(here, factor**1.1) > eps else eps
            self._solver.load(known.plan)
            self._solver.last = known
            result = self.solve(there, known.plan)
            if result.outcome is Outcome.SOLVED:
                here, known, shrinks = there, self._solver.last, 0
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
        if known is not None and here > eps:
            self._solver.load(known.plan)
            words = f"The walk to eps = {eps:g} ended at {here:.3g}."
            limit = Outcome.TIME_LIMIT if self.budget.is_over else Outcome.ITERATION_LIMIT
            outcome = {Outcome.SOLVED: limit, Outcome.INFEASIBLE: Outcome.STALLED}.get(
                result.outcome, result.outcome
            )
            result = replace(
                result, outcome=outcome, message=f"{ended(result.message)} {words}".lstrip()
            )
        return result, here

    def solve(
        self, eps: float, start: Trajectory | None, *, cold_work: Work | None = None
    ) -> IpoptResult:
        """Solve once at this eps from the start, which the model holds already. cold_work: most of it without a plan, if not as in the rules."""
        rules = self._homotopy.rules(eps)
        # work is counted in nonzeros of a softplus model, and in unknowns of one with
        # complementarity
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
        """What a solve at eps left in the model, if that is a plan."""
        plan = self._solver.read()
        return (
            None
            if beyond(self._homotopy.rules(eps).plan_limits, self._homotopy.residuals(plan, eps))
            else plan
        )

    def _limited(self, options: dict[str, Any], work: Work | None, size: int) -> dict[str, Any]:
        """With no more iterations than the stage has left, and than the work allows."""
        left = max(0, options["max_iter"] - self._spent)
        most = left if work is None else min(left, work.iterations(size))
        return {**options, "max_iter": self.budget.iterations + most}

"""What the methods share that are solved for ever smaller eps: a stage gets a bounded amount of work, what it leaves is handed on only if it is a
plan, and where contact is softer and there was no plan, none is looked for.

A stage that leads from a plan of this session to none is solved half way before, at the geometric mean of the two eps. Iterations of softplus contact
from 1e-3 to 1e-5, directly and by 1e-4: transport 983 without a plan and 190 with one, hopper_planar 292 without and 166 with one.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import asdict, dataclass, replace
from typing import Any, cast

from formulations.solution import Outcome, Solution
from formulations.transcription.plans import load_plan, read_plan
from formulations.transcription.session import Ending, TranscriptionSession
from formulations.transcription.size import size_on_paper
from formulations.transcription.workbench import Account, Workbench
from models.errors import TrajectoryError
from models.trajectory import Trajectory


@dataclass(frozen=True)
class Work:
    """Most iterations of a solve, times the size of its model, and the fewest iterations it may have however large the model."""

    most: float
    fewest: int

    def iterations(self, size: int) -> int:
        return max(self.fewest, int(self.most / size))


@dataclass(frozen=True)
class _Failure:
    """A stage that gave no plan, and what it had started from."""

    eps: float
    start: Trajectory | None
    outcome: Outcome


class TightenedSession(TranscriptionSession):
    """See the module docstring."""

    _failure: _Failure | None = None
    _size, _spent = 0, 0

    def size(self, bench: Workbench, account: Account) -> int:
        """Of the model, as `work` counts it: unknowns by hand."""
        return size_on_paper(self._scene, self.contact).unknowns

    @abstractmethod
    def work(self, warm_start: Trajectory | None) -> Work | None:
        """None: as many iterations as the method's option says."""

    @abstractmethod
    def is_vain(self, failed: Outcome, start: Trajectory | None) -> Outcome | None:
        """How a stage ends, untried, whose start led to `failed` at a larger eps; None: it is tried all the same."""

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        failure = self._failure
        if failure is not None and warm_start is failure.start and cast(float, eps) < failure.eps:
            self._method.check_eps(eps)
            outcome = self.is_vain(failure.outcome, warm_start)
            if outcome is not None:
                message = f"Not tried: from this start there was no plan at eps = {failure.eps:g} either, where contact is softer."
                return Solution(method=self._method.name, outcome=outcome, message=message, options=asdict(self._options))
        found = super().solve(eps=eps, warm_start=warm_start, time_limit=time_limit)
        if found.trajectory is None and found.outcome is not Outcome.TIME_LIMIT:
            self._failure = _Failure(cast(float, eps), warm_start, found.outcome)
        return found

    def run(self, bench: Workbench, account: Account, eps: float | None, warm_start: Trajectory | None) -> Ending:
        known = None if warm_start is None else self._solved_before(warm_start)
        accounts: list[Account] = []
        ending = self._apart(bench, account, eps, warm_start, accounts)
        may_go_on = not account.is_over and self._spent < self._options.max_iterations
        if known is not None and may_go_on and ending.outcome is not Outcome.SOLVED and self._left(bench, eps) is None:
            between = math.sqrt(cast(float, known.eps) * cast(float, eps))
            load_plan(bench.model, known.plan)
            if self._apart(bench, account, between, known.plan, accounts).outcome is Outcome.SOLVED:
                ending = self._apart(bench, account, eps, read_plan(bench.model), accounts)
                ending = replace(ending, message=f"{ending.message} It went by eps = {between:g}: directly there was no plan.".lstrip())
        for own in reversed(accounts):
            account.include(own)
        self._spent = 0
        return ending

    def _apart(self, bench: Workbench, account: Account, eps: float | None, plan: Trajectory | None, accounts: list[Account]) -> Ending:
        """A solve with an account of its own, because iterations are limited for each."""
        self._size = self.size(bench, account)
        own = Account(account.remaining)
        accounts.append(own)
        ending = super().run(bench, own, eps, plan)
        self._spent += own.iterations
        return ending

    def _left(self, bench: Workbench, eps: float | None) -> Trajectory | None:
        """What a solve at eps left in the model, if that is a plan."""
        try:
            plan = read_plan(bench.model)
        except TrajectoryError:
            return None
        return plan if self.is_plan(self.certificate(plan, eps), eps) else None

    def common_options(self) -> dict[str, Any]:
        options = super().common_options()
        return {**options, "max_iter": max(0, options["max_iter"] - self._spent)}

    def ipopt_options(self, warm_start: Trajectory | None) -> dict[str, Any]:
        options, work = super().ipopt_options(warm_start), self.work(warm_start)
        if work is None:
            return options
        return {**options, "max_iter": min(options["max_iter"], work.iterations(self._size))}

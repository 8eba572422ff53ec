"""What the methods share that are solved for ever smaller eps: a stage gets a bounded amount of work, what it leaves is handed on only if it is a
plan, and where contact is softer and there was no plan, none is looked for."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import asdict, dataclass
from typing import Any, cast

from formulations.solution import Outcome, Solution
from formulations.transcription.session import Ending, TranscriptionSession
from formulations.transcription.size import size_on_paper
from formulations.transcription.workbench import Account, Workbench
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
    _size = 0

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
        self._size = self.size(bench, account)
        return super().run(bench, account, eps, warm_start)

    def ipopt_options(self, warm_start: Trajectory | None) -> dict[str, Any]:
        options, work = super().ipopt_options(warm_start), self.work(warm_start)
        if work is None:
            return options
        return {**options, "max_iter": min(options["max_iter"], work.iterations(self._size))}

"""Where one stage spends its iterations, work and seconds, whatever solves are made in it. Light to import: no Pyomo."""

from __future__ import annotations

import math
from time import perf_counter, process_time
from typing import TYPE_CHECKING

from formulations.solution import Seconds

if TYPE_CHECKING:
    from formulations.ipopt import IpoptProblem, IpoptResult

_COLUMNS = ("objective", "inf_pr", "inf_du", "mu")


class SolveBudget:
    """Where one stage spends its iterations, work and seconds. `opened`: wall and CPU seconds spent before the stage that belong to it.

    work: iterations of Ipopt times nonzeros of the Jacobian and the Hessian, which is what an iteration's time grows with; most_work: of it there
    may be so much. It is the same whatever else the machine does.
    """

    def __init__(self, time_limit: float, opened: tuple[float, float] = (0.0, 0.0)) -> None:
        self._wall, self._cpu = perf_counter() - opened[0], process_time() - opened[1]
        self._deadline = self._wall + time_limit
        self.build, self.translate, self.evaluate, self.linear_algebra = opened[0], 0.0, 0.0, 0.0
        self.iterations = 0
        self.work, self.most_work = 0.0, math.inf
        self.solver = ""  # which Ipopt ran
        self.history: dict[str, list[float]] = {name: [] for name in _COLUMNS}

    @property
    def remaining(self) -> float:
        """Wall seconds left, never less than a millisecond: Ipopt wants a positive limit and then stops at once."""
        return max(1e-3, self._deadline - perf_counter())

    @property
    def is_late(self) -> bool:
        """Whether the time is over."""
        return perf_counter() >= self._deadline

    @property
    def is_over(self) -> bool:
        """Whether the time or the work is."""
        return self.is_late or self.work >= self.most_work

    def iterations_left(self, problem: IpoptProblem) -> float:
        """Iterations of Ipopt on a problem until the work is over."""
        return max(0, math.ceil((self.most_work - self.work) / problem.nonzeros)) if math.isfinite(self.most_work) else math.inf

    def add(self, result: IpoptResult, problem: IpoptProblem) -> None:
        """Count one solve of a problem."""
        self.iterations += result.iterations
        self.work += result.iterations * problem.nonzeros
        self.solver = result.version
        self.evaluate += result.seconds.evaluate
        self.linear_algebra += result.seconds.linear_algebra
        for line in result.history:
            for name in _COLUMNS:
                self.history[name].append(getattr(line, name))

    def include(self, earlier: SolveBudget) -> None:
        """What was spent before, in this budget's time."""
        self.iterations += earlier.iterations
        self.work += earlier.work
        self.solver = self.solver or earlier.solver
        for name in ("build", "translate", "evaluate", "linear_algebra"):
            setattr(self, name, getattr(self, name) + getattr(earlier, name))
        self.history = {name: earlier.history[name] + values for name, values in self.history.items()}

    def seconds(self) -> Seconds:
        """Seconds spent so far, by what for [s]."""
        return Seconds(
            build=self.build,
            translate=self.translate,
            evaluate=self.evaluate,
            linear_algebra=self.linear_algebra,
            wall=perf_counter() - self._wall,
            cpu=process_time() - self._cpu,
        )

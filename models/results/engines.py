"""TruthRecord: results of engines on the truth suite (docs/engines.md), by `validate truth`."""

from __future__ import annotations

from dataclasses import dataclass

from models.results.check import ChartRecord
from models.results.fields import Result


@dataclass(frozen=True, kw_only=True)
class LevelRecord(Result):
    """One of four motions: step [s] or tolerance, relative errors (None: none), CPU times [s]."""

    step: float | None
    tolerance: float | None
    error: float | None
    energy: float | None
    microseconds: float | None
    seconds: float


@dataclass(frozen=True, kw_only=True)
class TruthRow(Result):
    """Result of an engine on a problem.

    - came: done, cannot express it, not installed, failed.
    - why: reason.
    - source: of the exact answer.
    - worst: quantity with the largest error.
    - order: of the error in the step, if known.
    """

    phenomenon: str
    problem: str
    source: str
    engine: str
    came: str
    why: str = ""
    worst: str = ""
    order: float | None = None
    levels: tuple[LevelRecord, ...] = ()

    @property
    def error(self) -> float | None:
        """Return the error at the finest level, if there is one."""
        return self.levels[-1].error if self.levels else None


@dataclass(frozen=True, kw_only=True)
class TruthRecord(Result):
    """engines: title, version and contact law by name; rows by problem, then engine.

    charts: error against CPU time.
    """

    engines: dict[str, str]
    rows: tuple[TruthRow, ...]
    summary: str
    charts: tuple[ChartRecord, ...] = ()

    @property
    def problems(self) -> list[tuple[TruthRow, ...]]:
        """Return the rows of each problem, in the order of engines."""
        width = len(self.engines)
        return [self.rows[place : place + width] for place in range(0, len(self.rows), width)]

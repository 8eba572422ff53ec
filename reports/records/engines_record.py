"""What engines say of the problems of the truth suite (docs/engines.md): TruthRecord, written by `validate truth`."""

from __future__ import annotations

from reports.records.check_record import ChartRecord
from reports.records.record import Finite, Model


class LevelRecord(Model):
    """One of the four motions: step [s] or tolerance, error and energy error as shares (None: it diverged, or there is none), microseconds a step, CPU time [s]."""

    step: Finite | None
    tolerance: Finite | None
    error: Finite | None
    energy: Finite | None
    microseconds: Finite | None
    seconds: Finite


class TruthRow(Model):
    """What an engine made of a problem.

    came: done, cannot express it, not installed, failed; why: it is not done; source: of the exact
        answer; worst: the quantity that decides its error; order: of
    the error in the step, None where there is none to tell.
    """

    phenomenon: str
    problem: str
    source: str
    engine: str
    came: str
    why: str = ""
    worst: str = ""
    order: Finite | None = None
    levels: tuple[LevelRecord, ...] = ()

    @property
    def error(self) -> float | None:
        """At the finest level; None where there is none."""
        return self.levels[-1].error if self.levels else None


class TruthRecord(Model):
    """engines: by name, what each is called, its version and how it makes contact.

    Rows by problem, then by engine; summary: a sentence; charts: error against CPU time.
    """

    engines: dict[str, str]
    rows: tuple[TruthRow, ...]
    summary: str
    charts: tuple[ChartRecord, ...] = ()

    @property
    def problems(self) -> list[tuple[TruthRow, ...]]:
        """Rows of each problem, in the order of the engines."""
        width = len(self.engines)
        return [self.rows[place : place + width] for place in range(0, len(self.rows), width)]

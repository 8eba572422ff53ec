"""Says on stderr how a campaign goes: a bar on a terminal, one plain line a finished cell anywhere else."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from validate.cli.table import one_line

if TYPE_CHECKING:
    from reports.examination_record import ExaminationRecord
    from reports.record import RunRecord
    from validate.engine import Running


def narrator() -> PlainNarrator:
    """The narrator for this terminal (or no terminal)."""
    if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
        return BarNarrator()
    return PlainNarrator()


class PlainNarrator:
    """One line a finished cell."""

    def __init__(self) -> None:
        self.total = self.stored = self.done = 0

    def begins(self, total: int, stored: int) -> None:
        self.total, self.stored = total, stored
        self._line(f"{stored} stored, {total - stored} to run")

    def warns(self, sentence: str) -> None:
        """What the user should know before anything runs."""
        self._line(f"warning: {one_line(sentence)}")

    def runs(self, workers: Sequence[Running]) -> None:
        """Called many times a second with the running workers."""

    def finished(self, record: RunRecord | ExaminationRecord) -> None:
        self.done += 1
        self._line(f"[{self.stored + self.done}/{self.total}] {_summary(record)}")

    def ends(self) -> None:
        """The last cell finished, or the campaign was interrupted."""

    def _line(self, text: str) -> None:
        click.echo(text, err=True)


class BarNarrator(PlainNarrator):
    """The same lines above a bar that says what is running."""

    def begins(self, total: int, stored: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        self._console = Console(stderr=True)
        self._progress = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.description}", markup=False),
            console=self._console,
            transient=True,
        )
        super().begins(total, stored)
        self._task = self._progress.add_task("", total=total, completed=stored)
        self._progress.start()
        self._said = 0.0

    def runs(self, workers: Sequence[Running]) -> None:
        if time.monotonic() - self._said > 0.25:  # no faster than an eye reads
            self._said = time.monotonic()
            text = "; ".join(f"{worker.cell.title}: {worker.progress()}" for worker in workers)
            self._progress.update(self._task, description=one_line(text))

    def finished(self, record: RunRecord | ExaminationRecord) -> None:
        super().finished(record)
        self._progress.advance(self._task)

    def ends(self) -> None:
        self._progress.stop()

    def _line(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False)


def _summary(record: RunRecord | ExaminationRecord) -> str:
    from reports.examination_record import ExaminationRecord

    if isinstance(record, ExaminationRecord):
        return _examined(record)
    last = record.stages[-1]
    which = f" ({record.part} of {record.parts})" if record.parts > 1 else ""
    parts = [f"{record.scene.name} x {record.pipeline}{which}: {record.outcome}"]
    if record.verdict != "no plan":
        parts.append(record.verdict)
    if last.cost is not None:
        parts.append(f"cost {last.cost:.2f}")
    parts.append(f"{record.wall_seconds:.1f} s")
    if record.verdict == "no plan" and record.message:
        parts.append(record.message)
    return one_line(", ".join(parts))


def _examined(record: ExaminationRecord) -> str:
    ended = ("passed" if record.passed else "failed") if record.outcome == "answered" else record.outcome
    return one_line(f"{record.title}: {ended}, {record.wall_seconds:.1f} s, {record.found or record.message}")

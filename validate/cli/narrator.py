"""Says on stderr how a campaign goes: a bar on a terminal, one plain line a finished run anywhere else."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from validate.cli.table import one_line

if TYPE_CHECKING:
    from reports.records.check_record import ExaminationRecord
    from reports.records.record import RunRecord
    from validate.execution.engine import Running


# Width of the bar [characters]: what runs needs the room.
_BAR = 12


def narrator() -> PlainNarrator:
    """The narrator for this terminal (or no terminal)."""
    if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
        return BarNarrator()
    return PlainNarrator()


class PlainNarrator:
    """One line a finished run."""

    def __init__(self) -> None:
        self.total = self.stored = self.done = self.anew = 0

    def begins(self, total: int, stored: int, anew: int) -> None:
        """stored: runs whose records are used again; anew: others of which a record is stored too."""
        self.total, self.stored, self.anew = total, stored, anew
        self._line(
            f"{stored} stored, {total - stored} to run"
            if not anew
            else f"{stored} used again, {total - stored} to run, {anew} of them anew"
        )

    def so_far(self, out: Path) -> str:
        """How many runs there is a result of, in words."""
        if not out.is_dir():
            return f"{out} is gone, and what was stored in it with it"
        count = f"{self.stored + self.done} of {self.total} runs"
        return f"{count} are done, what {out} holds of the others is kept" if self.anew else f"{count} are stored in {out}"

    def warns(self, sentence: str) -> None:
        """What the user should know before anything runs."""
        self._line(f"warning: {one_line(sentence)}")

    def runs(self, workers: Sequence[Running]) -> None:
        """Called many times a second with the running workers."""

    def finished(self, record: RunRecord | ExaminationRecord) -> None:
        """A run or check ended with this record."""
        self.done += 1
        self._line(f"[{self.stored + self.done}/{self.total}] {_summary(record)}")

    def ends(self) -> None:
        """The last run finished, or the campaign was interrupted."""

    def _line(self, text: str) -> None:
        click.echo(text, err=True)


class BarNarrator(PlainNarrator):
    """The same lines above a bar that says what is running."""

    def begins(self, total: int, stored: int, anew: int) -> None:
        """Show the bar."""
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
        from rich.table import Column

        def whole() -> Column:  # what runs is cut off where the terminal ends, the numbers never
            return Column(no_wrap=True)

        self._console = Console(stderr=True)
        self._progress = Progress(
            BarColumn(bar_width=_BAR),
            MofNCompleteColumn(table_column=whole()),
            TimeElapsedColumn(table_column=whole()),
            TextColumn("{task.fields[left]}", table_column=whole()),
            TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
            console=self._console,
            transient=True,
            expand=True,
        )
        super().begins(total, stored, anew)
        self._task = self._progress.add_task("", total=total, completed=stored, left="")
        self._progress.start()
        self._began, self._said = time.monotonic(), 0.0

    def runs(self, workers: Sequence[Running]) -> None:
        """Say what runs, no more often than an eye reads."""
        if time.monotonic() - self._said > 0.25:
            self._said = time.monotonic()
            text = "; ".join(f"{worker.task.title}: {worker.progress()}" for worker in workers)
            self._progress.update(self._task, description=one_line(text), left=self._left())

    def _left(self) -> str:
        """How long the runs that have not finished take, if they take as long as those that have."""
        if not self.done:
            return ""
        each = (time.monotonic() - self._began) / self.done
        return f"about {in_words(each * (self.total - self.stored - self.done))} left"

    def finished(self, record: RunRecord | ExaminationRecord) -> None:
        """A run or check ended with this record."""
        super().finished(record)
        self._progress.advance(self._task)

    def ends(self) -> None:
        """Take the bar away."""
        self._progress.stop()

    def _line(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False)


def in_words(seconds: float) -> str:
    """A time as roughly as it is known."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _summary(record: RunRecord | ExaminationRecord) -> str:
    from reports.records.check_record import ExaminationRecord

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
    if record.verdict in ("no plan", "not applicable") and record.message:
        parts.append(record.message)
    return one_line(", ".join(parts))


def _examined(record: ExaminationRecord) -> str:
    ended = ("passed" if record.passed else "failed") if record.outcome == "answered" else record.outcome
    return one_line(f"{record.title}: {ended}, {record.wall_seconds:.1f} s, {record.found or record.message}")

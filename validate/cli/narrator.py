"""Print the progress of a campaign on stderr.

A terminal shows a bar and one line a scene; a file or pipe receives one line a finished run.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from models.results.check import CheckRecord
from models.results.run import RunRecord
from models.results.verdict import HOLD
from reports.findings import NOT_ASKED
from reports.judged import end_of
from reports.rule import fails
from validate.cli.table import in_words, one_line, say
from validate.store.store import progress_in

# Width of the bar [characters]; the current tasks need the rest of the line.
_BAR = 12


def narrator() -> PlainNarrator:
    """Return the narrator for a terminal, or for a file or pipe."""
    if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
        return BarNarrator()
    return PlainNarrator()


class PlainNarrator:
    """Print one line for each finished run."""

    def __init__(self) -> None:
        self.total = self.stored = self.done = 0
        self._refused: list[RunRecord] = []  # runs of unfinished scenes

    def begins(self, total: int, stored: int) -> None:
        """Print the number of tasks. stored: runs and checks whose records are used."""
        self.total, self.stored = total, stored
        self.notes(f"{stored} stored, {total - stored} to run")

    def so_far(self, out: Path) -> str:
        """Return the number of runs with a result, in words."""
        if not out.is_dir():
            return f"{out} is gone, and what was stored in it with it"
        return f"{self.stored + self.done} of {self.total} runs are stored in {out}"

    def notes(self, sentence: str) -> None:
        """Print a note on a line."""
        say(sentence, err=True, indent="  ")

    def found(self, runs: Sequence[RunRecord]) -> None:
        """Print the summary of a scene whose runs have all ended.

        The summary lists runs that do not apply with their reasons, the number that hold, and the
        cheapest plan.
        """
        self._refused = [run for run in self._refused if run.scene.name != runs[0].scene.name]
        self._refusals(run for run in runs if run.verdict == "not applicable")
        self.notes(f"so far: {_on_scene(runs)}")

    def _refusals(self, runs: Iterable[RunRecord]) -> None:
        refused: dict[str, list[str]] = {}
        for run in runs:
            method, _, why = run.message.partition(": ")
            refused.setdefault(why if method.isidentifier() else run.message, []).append(
                run.pipeline
            )
        for why, pipelines in refused.items():
            self.notes(f"not applicable: {', '.join(pipelines)}: {why}")

    def warns(self, sentence: str) -> None:
        """Print a warning before anything runs."""
        self.notes(f"warning: {sentence}")

    def runs(self, folders: Mapping[str, Path]) -> None:
        """Receive the current tasks many times a second.

        folders: name of a task -> its unfinished folder.
        """

    def finished(self, record: RunRecord | CheckRecord) -> None:
        """Print the line of a finished run or check.

        Runs that do not apply to their scene are printed together (`found`).
        """
        self.done += 1
        if record.outcome != "refused":
            if self._is_worth_a_line(record):
                self.notes(f"[{self.stored + self.done}/{self.total}] {_summary(record)}")
        elif isinstance(record, RunRecord):
            self._refused.append(record)

    def _is_worth_a_line(self, record: RunRecord | CheckRecord) -> bool:
        return True

    def ends(self) -> None:
        """Print the remaining runs that do not apply, after the last run or an interrupt."""
        self._refusals(self._refused)


class BarNarrator(PlainNarrator):
    """Print one line for each scene and each failure, above a bar with the current tasks."""

    def begins(self, total: int, stored: int) -> None:
        """Show the bar."""
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
        )
        from rich.table import Column

        def whole() -> Column:  # names are cut at the end of the line, numbers never
            return Column(no_wrap=True)

        self._console = Console(stderr=True)
        self._progress = Progress(
            BarColumn(bar_width=_BAR),
            MofNCompleteColumn(table_column=whole()),
            TimeElapsedColumn(table_column=whole()),
            TextColumn("{task.fields[left]}", table_column=whole()),
            TextColumn(
                "{task.description}",
                markup=False,
                table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1),
            ),
            console=self._console,
            transient=True,
            expand=True,
        )
        super().begins(total, stored)
        self._task = self._progress.add_task("", total=total, completed=stored, left="")
        self._progress.start()
        self._began, self._said = time.monotonic(), 0.0

    def runs(self, folders: Mapping[str, Path]) -> None:
        """Show the current tasks, no more often than an eye can read."""
        if time.monotonic() - self._said > 0.25:
            self._said = time.monotonic()
            text = "; ".join(f"{title}: {progress_in(folder)}" for title, folder in folders.items())
            self._progress.update(self._task, description=one_line(text), left=self._left())

    def _left(self) -> str:
        """Return the expected time of the unfinished runs, from the time of the finished ones."""
        if not self.done:
            return ""
        each = (time.monotonic() - self._began) / self.done
        return f"about {in_words(each * (self.total - self.stored - self.done))} left"

    def finished(self, record: RunRecord | CheckRecord) -> None:
        """Advance the bar for a finished run or check."""
        super().finished(record)
        self._progress.advance(self._task)

    def _is_worth_a_line(self, record: RunRecord | CheckRecord) -> bool:
        return fails(record)

    def ends(self) -> None:
        """Remove the bar."""
        super().ends()
        self._progress.stop()

    def notes(self, sentence: str) -> None:
        """Print a note above the bar."""
        self._console.print(one_line(sentence), markup=False, highlight=False)


def _on_scene(runs: Sequence[RunRecord]) -> str:
    """Return a sentence: `three_cart: 14 of 15 runs that end with exact contact hold; ..`."""
    scene = runs[0].scene
    asked = [run for run in runs if run.must_hold and run.verdict not in NOT_ASKED]
    if not asked:
        return f"{scene.name}: nothing is asked of its {len(runs)} runs"
    holding = [run for run in asked if run.verdict in HOLD]
    said = f"{scene.name}: {len(holding)} of {len(asked)} runs that end with exact contact hold"
    cheapest = min(
        (run for run in holding if run.cost is not None),
        key=lambda run: run.cost or 0.0,
        default=None,
    )
    if cheapest is None:
        return said
    end = end_of(cheapest.stages[-1], scene)
    off = f", its replay ends off the goal by {end}" if end not in ("", "free end") else ""
    return f"{said}; the cheapest is {cheapest.pipeline}, cost {cheapest.cost:.2f}{off}"


def _summary(record: RunRecord | CheckRecord) -> str:
    ended = record.outcome.replace("_", " ")
    times = f"{record.cpu_seconds:.1f} CPU s ({record.wall_seconds:.1f} s wall)"
    if isinstance(record, CheckRecord):
        ended = ("passed" if record.passed else "failed") if record.outcome == "answered" else ended
        return f"{record.title}: {ended}, {times}, {record.found or record.message}"
    verdict = record.verdict if record.verdict != "no plan" else ""
    cost = "" if record.cost is None else f"cost {record.cost:.2f}"
    why = record.message if record.verdict in ("no plan", "not applicable") else ""
    return ", ".join(filter(None, [f"{record.title}: {ended}", verdict, cost, times, why]))

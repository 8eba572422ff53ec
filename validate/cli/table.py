"""Plain text tables for a terminal, and numbers as short as they can be read."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from reports.records.record import RunRecord

# From here on decimals would fill the line: a diverged plan may cost 1e200.
_LARGE = 1e9
_COLOURS = {"holds": "green", "holds with feedback": "cyan", "violates": "red", "undecided": "yellow", "no plan": "red"}


def use_colour() -> bool | None:
    """False where the user said NO_COLOR, or the terminal knows no colours; None leaves it to whether the output is a terminal."""
    return False if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" else None


def one_line(text: str) -> str:
    """Text from anywhere, fit for one line of a terminal: no line breaks, no control characters."""
    return "".join(letter for letter in " ".join(text.split()) if letter.isprintable())


def table(titles: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str] = ()) -> str:
    """Columns as wide as their widest cell; those named in `right` are aligned to the right."""
    widths = [max(len(title), *(len(row[place]) for row in rows)) if rows else len(title) for place, title in enumerate(titles)]

    def line(cells: Sequence[str]) -> str:
        padded = [
            cell.rjust(width) if title in right else cell.ljust(width) for cell, width, title in zip(cells, widths, titles, strict=True)
        ]
        return "  ".join(padded).rstrip()

    return "\n".join([line(titles), line(["-" * width for width in widths]), *(_coloured(line(row), row) for row in rows)])


def _coloured(text: str, row: Sequence[str]) -> str:
    verdict = next((cell for cell in row if cell in _COLOURS), None)
    return text if verdict is None else text.replace(verdict, click.style(verdict, fg=_COLOURS[verdict]))


def short(value: Any, pattern: str = ".4g") -> str:
    """A number in few digits; empty where nothing is known."""
    if pattern.endswith("f") and isinstance(value, float) and abs(value) >= _LARGE:
        pattern = ".4g"
    return "" if value is None else format(value, pattern) if isinstance(value, float) else str(value)


_TITLES = (
    ("scene", "scene", ""),
    ("pipeline", "pipeline", ""),
    ("stage", "stage", ""),
    ("method", "method", ""),
    ("eps", "eps", "g"),
    ("outcome", "outcome", ""),
    ("cost", "cost", ".2f"),
    ("terminal_error", "terminal error", ".2e"),
    ("replay_terminal_error", "replayed", ".2e"),
    ("physics", "physics", ".4g"),
    ("verdict", "verdict", ""),
    ("stage_s", "seconds", ".2f"),
)
_NUMBERS = ("stage", "eps", "cost", "terminal error", "replayed", "physics", "seconds")


def results_table(records: Sequence[RunRecord]) -> str:
    """What of results.csv a terminal has room for; `replayed` is the terminal error after the replay that is judged."""
    from validate.store.results import rows

    content = rows(records)
    for row in content:
        if row["judged"] == "feedback":
            row["replay_terminal_error"] = row["tracked_replay_terminal_error"]
    cells = [[one_line(short(row[name], pattern)) for name, _, pattern in _TITLES] for row in content]
    place = [name for name, _, _ in _TITLES].index("verdict")
    for line, stage in zip(cells, [stage for record in records for stage in record.stages], strict=True):
        if stage.kind == "indirect" and stage.verdict == "violates":
            line[place] = "as expected: violates"
    return table([title for _, title, _ in _TITLES], cells, _NUMBERS)

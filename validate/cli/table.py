"""Plain text tables and sentences that fit a terminal, and short numbers.

# `why` breaks between words; `cost` is dropped in a narrow terminal
print(table(["scene", "cost", "why"], rows, ("cost",), drop=("cost",)))
"""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import IO, Any, TypeVar

import click

# Larger numbers have an exponent, since decimals would fill the line: a diverged plan may cost
# 1e200.
_LARGE = 1e9
_VERDICTS = {
    "holds": "green",
    "holds with feedback": "cyan",
    "violates": "red",
    "undecided": "yellow",
    "no plan": "red",
}
_GAP = "  "
# Width of a table in a file or pipe [characters], which may be read in a terminal later.
_PIPE = 100
# Least width of a column of sentences before another column is dropped [characters].
_SENTENCE = 20
# Least width of a column of sentences that may itself be dropped [characters].
_LEFT_OUT = 30
_WIDE = "touchstone.wide"
_Command = TypeVar("_Command", bound=Callable[..., Any])


def _keep_wide(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    context.meta[_WIDE] = value


def wide_option(command: _Command) -> _Command:
    """Add `--wide` to a command that prints tables."""
    words = "Print tables with all columns, at any width."
    return click.option(
        "--wide", is_flag=True, expose_value=False, callback=_keep_wide, help=words
    )(command)


def terminal_width(stream: IO[str] | None = None) -> int | None:
    """Return the characters in a line of a stream's terminal (default stdout), or COLUMNS if set.

    None means no limit: in a file, in a pipe and with --wide.
    """
    if _is_wide():
        return None
    return (
        shutil.get_terminal_size().columns
        if os.environ.get("COLUMNS") or (stream or sys.stdout).isatty()
        else None
    )


def _is_wide() -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(_WIDE))


def say(
    text: str, *, err: bool = False, begin: str = "", indent: str = "", colour: str | None = None
) -> None:
    """Print a sentence, broken between words at the width of the terminal.

    - err: print to stderr
    - begin, indent: text before the first line, and before each further line
    - colour: colour of `begin`
    """
    lines = wrapped(begin + one_line(text), terminal_width(sys.stderr if err else None), indent)
    click.echo(
        click.style(begin, fg=colour) + lines[len(begin) :] if colour else lines,
        err=err,
        color=use_colour(),
    )


def warn(sentences: Iterable[str]) -> None:
    """Print warnings to stderr, one a line."""
    for sentence in sentences:
        say(f"warning: {sentence}", err=True)


def wrapped(text: str, width: int | None, indent: str = "") -> str:
    """Return text in lines of at most `width` characters.

    A longer word stays whole. indent: prefix of all lines but the first.
    """
    if width is None or len(text) <= width:
        return text
    return textwrap.fill(
        text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def use_colour() -> bool | None:
    """Return False if NO_COLOR is set or the terminal has no colours, else None.

    None: click uses colours if the output is a terminal.
    """
    return False if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" else None


def one_line(text: str) -> str:
    """Return text without line breaks and control characters, for one line of a terminal."""
    return "".join(letter for letter in " ".join(text.split()) if letter.isprintable())


def table(
    titles: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Sequence[str] = (),
    *,
    drop: Sequence[str] = (),
) -> str:
    """Return a table that fits the terminal, or 100 columns of a file or pipe; --wide has no limit.

    - titles, rows: text, all rows as long as `titles`
    - right: titles of columns that are aligned to the right and never broken
    - drop: titles of columns that are dropped, in this order, if the table is too wide

    Other columns break between words.
    """
    rows = [[one_line(cell) for cell in row] for row in rows]
    width = terminal_width() or (None if _is_wide() else _PIPE)
    places, left_out = list(range(len(titles))), []
    natural = [
        max(len(title), *(len(row[place]) for row in rows)) if rows else len(title)
        for place, title in enumerate(titles)
    ]
    narrow = [_LEFT_OUT if title in drop else _SENTENCE for title in titles]
    least = [
        _narrowest(title, [row[place] for row in rows], narrow[place])
        for place, title in enumerate(titles)
    ]
    least = [
        natural[place] if title in right else least[place] for place, title in enumerate(titles)
    ]

    def excess(widths: Sequence[int]) -> int:
        """Return by how many characters the columns are wider than the terminal."""
        return (
            0
            if width is None
            else sum(widths[place] for place in places) + len(_GAP) * (len(places) - 1) - width
        )

    for title in drop:
        if excess(least) > 0:
            places.remove(titles.index(title))
            left_out.append(title)
    widths = natural
    while excess(widths) > 0 and (
        wider := [place for place in places if widths[place] > least[place]]
    ):
        widths[max(wider, key=lambda place: widths[place])] -= 1

    def line(cells: Sequence[str]) -> str:
        """Return a row, which is as many lines high as its highest cell."""
        parts = [wrapped(cells[place], widths[place]).split("\n") for place in places]
        high = range(max(map(len, parts)))
        return "\n".join(
            _GAP.join(
                _padded(
                    part[number] if number < len(part) else "",
                    widths[place],
                    _VERDICTS.get(cells[place]),
                    titles[place] in right,
                )
                for part, place in zip(parts, places, strict=True)
            ).rstrip()
            for number in high
        )

    lines = [line(titles), line(["-" * width for width in widths]), *map(line, rows)]
    if left_out := [title for title in left_out if title]:
        lines.append(
            wrapped(f"(no room for: {', '.join(left_out)}; --wide shows all columns)", width)
        )
    return "\n".join(lines)


def print_table(*arguments: Any, **options: Any) -> None:
    """Print a `table`, in colours if the terminal has them."""
    click.echo(table(*arguments, **options), color=use_colour())


def _padded(text: str, width: int, colour: str | None, right: bool) -> str:
    blank = " " * (width - len(text))
    coloured = click.style(text, fg=colour) if text and colour else text
    return blank + coloured if right else coloured + blank


def _narrowest(title: str, cells: Sequence[str], sentence: int) -> int:
    words = [word for cell in (title, *cells) for word in cell.split()]
    return max(min(sentence, max(map(len, (title, *cells)))), *map(len, words), 0)


def short(value: Any, pattern: str = ".4g") -> str:
    """Return a number in few digits; empty if it is unknown."""
    if pattern.endswith("f") and isinstance(value, float) and abs(value) >= _LARGE:
        pattern = ".4g"
    return (
        ""
        if value is None
        else format(value + 0.0, pattern)
        if isinstance(value, float)
        else str(value)
    )  # + 0.0 removes the sign of a zero


def in_words(seconds: float) -> str:
    """Return a time in words, as roughly as it is known."""
    if seconds < 60:
        return f"{seconds:.0f} s" if seconds >= 9.5 else f"{seconds:.2g} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"

"""Store the figures of a benchmark in DIR/NAME.json, with the machine, the commit and the command; print tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from models.results.stored import to_data
from validate.cli.table import table
from validate.processes.disk import make_folder, write_durably

Cell = str | float | int | None


def store(out: Path, name: str, figures: Mapping[str, Any]) -> Path:
    """Write figures to DIR/NAME.json, whole or not at all. Raises MachineError."""
    from validate.store.provenance import command_line, gather

    words = click.get_current_context().find_root().obj or ()
    provenance = to_data(gather(command_line(words, "python -m benchmarks")))
    make_folder(out)
    path = out / f"{name}.json"
    write_durably(path, json.dumps({"provenance": provenance, **figures}, indent=1))
    return path


def as_text(columns: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """A table for a terminal; columns without text are aligned to the right."""
    right = [
        title
        for title, *cells in zip(columns, *rows, strict=True)
        if not any(isinstance(cell, str) for cell in cells)
    ]
    return table(columns, [[_shown(cell, "-", ".7g") for cell in row] for row in rows], right)


def as_markdown(columns: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """A table for a page of `docs`."""
    cells = [[_shown(cell, "", ".8g") for cell in row] for row in rows]
    lines = [columns, ["---"] * len(columns), *cells]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _shown(cell: Cell, nothing: str, form: str) -> str:
    if cell is None:
        return nothing
    return format(cell, form) if isinstance(cell, float) else str(cell)

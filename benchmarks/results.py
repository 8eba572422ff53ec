"""Store the figures of a benchmark in DIR/NAME.json, with the machine, the commit and the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.records import SuiteRecord, Table, TableRecord
from validate.cli.table import table
from validate.store.disk import make_folder, write_durably


def typed() -> str:
    """The command that runs, as it was typed."""
    from validate.store.provenance import command_line

    context = click.get_current_context(silent=True)
    return command_line((context and context.find_root().obj) or (), "python -m benchmarks")


def store(out: Path, name: str, record: SuiteRecord | TableRecord) -> Path:
    """Write a record to DIR/NAME.json, whole or not at all. Raises MachineError."""
    make_folder(out)
    write_durably(out / f"{name}.json", record.model_dump_json(indent=1))
    return out / f"{name}.json"


def store_tables(
    out: Path,
    name: str,
    title: str,
    about: str,
    tables: Sequence[Table],
    runs: Sequence[Mapping[str, Any]] = (),
    quiet: bool = False,
) -> Path:
    """Write tables to DIR/NAME.json with the runs that they are made of, and print them unless `quiet`. Raises MachineError."""
    from validate.store.provenance import gather

    for told in () if quiet else tables:
        right = [
            title
            for title, *cells in zip(told.columns, *told.rows, strict=True)
            if not any(isinstance(cell, str) for cell in cells)
        ]
        cells = [
            [
                "-" if cell is None else cell if isinstance(cell, str) else f"{cell:.7g}"
                for cell in row
            ]
            for row in told.rows
        ]
        click.echo("\n".join(["", told.caption, table(told.columns, cells, right), *told.notes]))
    record = TableRecord(
        kind="table",
        name=name,
        title=title,
        about=about,
        tables=tuple(tables),
        runs=tuple(dict(run) for run in runs),
        provenance=gather(typed()),
    )
    return store(out, name, record)


def as_markdown(told: Table) -> str:
    """The rows of a table as a page of `docs` has them."""
    rows = [told.columns, ["---"] * len(told.columns), *told.rows]
    cells = [
        [
            "" if cell is None else f"{cell:.8g}" if isinstance(cell, float) else str(cell)
            for cell in row
        ]
        for row in rows
    ]
    return "".join(f"| {' | '.join(row)} |\n" for row in cells)


def tables_of(out: Path, name: str) -> TableRecord | None:
    """What `store_tables` wrote; None if there is nothing.

    Raises click.UsageError for a file that is something else.
    """
    path = out / f"{name}.json"
    try:
        return TableRecord.model_validate_json(path.read_bytes()) if path.is_file() else None
    except (OSError, ValueError) as error:
        raise click.UsageError(
            f"{path} is no record of {name}; move it away, or choose another folder."
        ) from error

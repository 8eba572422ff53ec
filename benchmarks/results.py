"""Where benchmarks leave what they measured, and the page reads it: DIR/NAME.json, a record each (`records`).

@click.command()
@out_option
def command(out): store(out, "cosim", {"kind": "cosim", "cases": [..]})
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.records import AnyRecord, BenchRecord, Table, TableRecord
from reports.records.load import ReportError, Unreadable, read_record
from validate.cli.table import table
from validate.store.disk import make_folder, write_durably


def typed() -> str:
    """The command that runs, as it was typed."""
    from validate.store.provenance import command_line

    context = click.get_current_context(silent=True)
    return command_line((context and context.find_root().obj) or (), "python -m benchmarks")


def store(out: Path, name: str, record: Mapping[str, Any]) -> Path:
    """Write a record to DIR/NAME.json, whole or not at all. Raises MachineError."""
    from validate.store.provenance import gather

    found = BenchRecord.model_validate({"provenance": gather(typed()), **record})
    make_folder(out)
    write_durably(out / f"{name}.json", found.model_dump_json(indent=1))
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
    )
    return store(out, name, record.model_dump(exclude={"provenance"}))


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


def stored(out: Path) -> tuple[list[AnyRecord], list[Unreadable]]:
    """Every record in a folder by the name of its file, and what there cannot be read.

    Raises ReportError if there is no such folder.
    """
    if not out.is_dir():
        raise ReportError(
            f"{out}: there is no such folder; give one that benchmarks wrote to (`--out`)."
        )
    unreadable: list[Unreadable] = []
    paths = sorted(path for path in out.glob("*.json") if not path.name.startswith("."))
    found = [read_record(path, out, BenchRecord.model_validate_json, unreadable) for path in paths]
    return [record.root for record in found if record is not None], unreadable

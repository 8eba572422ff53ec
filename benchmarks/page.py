"""`page`: what benchmarks left in a folder, told on one page by the report's own rendering.

It asks nothing of any network.

render(Path("runs/benchmarks"))  ->  the text of runs/benchmarks/page.html
"""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.options import measured_argument
from benchmarks.pages import (
    cosimulation,
    replay_speed,
    suite,
    tables,
)
from benchmarks.results import stored
from reports.pages.section import Section
from reports.records.load import ReportError
from reports.render import Templates, page, write_page

# kind of record -> what makes its section.
_SECTIONS = {
    "suite": suite,
    "replay_speed": replay_speed,
    "cosim": cosimulation,
    "table": tables,
}


def render(folder: Path) -> str:
    """The page's text. Raises ReportError if there is no such folder, or nothing in it."""
    records, unreadable = stored(folder)
    if not records and not unreadable:
        raise ReportError(
            f"{folder}: no benchmark has left figures there; `python -m benchmarks run NAME --out {folder}` measures."
        )
    told: list[tuple[Section, list]] = []
    for kind, maker in _SECTIONS.items():
        same = [record for record in records if record.kind == kind]
        for group in [[record] for record in same] if maker is tables else [same]:
            section = maker.build(group)
            if section is not None:
                told.append((section, group))
    measured = [(section, record.provenance) for section, group in told for record in group]
    overview = Section(
        "overview",
        "What is measured",
        "overview.html",
        {"measured": measured, "unreadable": unreadable},
    )
    return page(
        Templates(Path(__file__).parent / "pages" / "templates"),
        [overview, *(section for section, _ in told)],
        title="Benchmarks",
        lead="How fast and how exact touchstone is, and how it grows, beside what people would use instead.",
        again="python -m benchmarks page DIR",
    )


@click.command()
@measured_argument
def command(folder: Path) -> int:
    """Write DIR/page.html from what benchmarks left in DIR (runs/benchmarks, if none is given)."""
    try:
        write_page(folder / "page.html", render(folder))
    except ReportError as problem:
        raise click.UsageError(str(problem)) from problem
    click.echo(folder / "page.html")
    return 0

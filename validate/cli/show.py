"""`show`: one run of a campaign, in a terminal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from validate.cli.table import one_line, short, table, use_colour

if TYPE_CHECKING:
    from reports.examination_record import ExaminationRecord
    from reports.record import RunRecord, StageRecord

_EPILOG = """\b
Examples:
  python -m validate show runs/all/runs/4f2a...   one run, by its folder
  python -m validate show 4f2a                    by the beginning of its key
  python -m validate show "three_cart x mpcc"     by its name
  python -m validate show mpcc --in runs/mine     by part of a name

\b
Exit codes: 0 it does not make its campaign fail; 1 it does; 2 there is no such
run, or more than one.
"""
_LOG_LINES = 15


@click.command(epilog=_EPILOG)
@click.argument("run", metavar="RUN|KEY|NAME")
@click.option(
    "--in",
    "folder",
    type=click.Path(path_type=Path),
    default="runs/all",
    show_default=True,
    metavar="DIR",
    help="The folder of the campaign.",
)
@click.option("--json", "as_json", is_flag=True, help="The stored record, whole, as JSON.")
def command(run: str, folder: Path, as_json: bool) -> int:
    """One run: its stages, verdict, figures, options, the end of its log, and the command that runs it again."""
    from reports.examination_record import ExaminationRecord
    from reports.rule import fails

    folder, record = _found(run, folder)
    if as_json:
        click.echo(json.dumps(record.model_dump(mode="json"), indent=1, allow_nan=False))
    else:
        if isinstance(record, ExaminationRecord):
            _tell_examination(record)
        else:
            _tell_run(record)
        _tell_end(record, folder)
    return 1 if fails(record) else 0


def _found(run: str, folder: Path) -> tuple[Path, RunRecord | ExaminationRecord]:
    """The campaign's folder and the record. Raises CampaignError."""
    from validate.chosen import CampaignError
    from validate.store import RECORD, Store
    from validate.stored import stored_campaign

    path = Path(run)
    if path.name == RECORD and len(path.parts) > 1:
        path = path.parent
    if "\0" not in run and len(run) < 4000 and path.is_dir():
        record = Store(path.parent.parent).read(path.name)
        if record is None:
            raise CampaignError(f"{run}: this folder holds no readable record; give a folder below DIR/runs.")
        return path.parent.parent, record
    _, records = stored_campaign(folder)
    names = {record.key: _name(record) for record in records}
    for fits in (
        lambda record: len(run) >= 4 and record.key.startswith(run),
        lambda record: names[record.key] == run,
        lambda record: run.lower() in names[record.key].lower(),
    ):
        found = [record for record in records if fits(record)]
        if len(found) == 1:
            return folder, found[0]
        if found:
            shown = "; ".join(f"{names[record.key]} ({record.key[:12]})" for record in found[:8])
            raise CampaignError(f"{run!r} means {len(found)} runs: {shown}{' and more' if len(found) > 8 else ''}. Give one of these keys.")
    raise CampaignError(f"there is no run {run!r} in {folder}; {_hint(run, list(names.values()), folder)}")


def _hint(run: str, names: list[str], folder: Path) -> str:
    import difflib

    close = difflib.get_close_matches(run[:200], names, n=1, cutoff=0.4)
    return (
        f"did you mean {close[0]!r}?"
        if close
        else f"its runs are listed in {folder / 'results.csv'}, or `python -m validate report {folder}` writes that again."
    )


def _name(record: RunRecord | ExaminationRecord) -> str:
    from reports.examination_record import ExaminationRecord

    if isinstance(record, ExaminationRecord):
        return record.title
    return f"{record.scene.name} x {record.pipeline}" + (f" ({record.part} of {record.parts})" if record.parts > 1 else "")


def _tell_run(record: RunRecord) -> None:
    click.echo(one_line(f"{_name(record)}: {record.outcome}, {record.verdict}"))
    click.echo(one_line(f"{record.scene.title}; {record.pipeline_title}"))
    if record.message:
        click.echo(one_line(record.message))
    click.echo()
    click.echo(_stages(record), color=use_colour())
    last = record.stages[-1] if record.stages else None
    if last is None:
        return
    if last.why and last.why != record.message:
        click.echo()
        click.echo(one_line(f"the last stage {last.verdict}: {last.why}" if last.verdict != "no plan" else last.why))
    if last.metrics:
        click.echo()
        click.echo(_figures(last))
    click.echo()
    if last.certificate is not None:
        click.echo(one_line(f"certificate: {last.certificate.sentence}"))
    for stage in record.stages:
        options = ", ".join(f"{name} = {value}" for name, value in stage.options.items())
        click.echo(one_line(f"options of stage {stage.index + 1} ({stage.method}): {options or 'none'}"))


def _stages(record: RunRecord) -> str:
    rows = [
        [
            str(stage.index + 1), stage.method, short(stage.eps, "g"), stage.outcome, short(stage.cost, ".4f"), str(stage.iterations),
            stage.verdict, short(stage.seconds.stage, ".2f"), short(stage.seconds.replay, ".2f"),
        ]
        for stage in record.stages
    ]  # fmt: skip
    titles = ["stage", "method", "eps", "outcome", "cost", "iterations", "verdict", "seconds", "replay s"]
    return table(titles, [[one_line(cell) for cell in row] for row in rows], ("stage", "eps", "cost", "iterations", "seconds", "replay s"))


def _figures(stage: StageRecord) -> str:
    rows = []
    for figure in stage.metrics:
        judged = "" if figure.ok is None else "ok" if figure.ok else "too large"
        if figure.value is None:
            judged = "missing"
        elif figure.limit is not None and not figure.resolved:
            judged = "not resolved"
        rows.append([figure.name, short(figure.value, ".4e"), figure.unit, short(figure.limit, ".3g"), judged])
    return table(["figure", "value", "unit", "limit", ""], [[one_line(cell) for cell in row] for row in rows], ("value", "limit"))


def _tell_examination(record: ExaminationRecord) -> None:
    ended = ("passed" if record.passed else "failed") if record.outcome == "answered" else record.outcome
    click.echo(one_line(f"{record.title}: {ended}"))
    click.echo(one_line(f"expected: {record.expected}"))
    click.echo(one_line(f"found: {record.found or record.message}"))
    if record.figures:
        rows = [[figure.name, short(figure.value, ".4g"), figure.unit, short(figure.limit, ".3g")] for figure in record.figures]
        click.echo()
        click.echo(table(["figure", "value", "unit", "limit"], [[one_line(cell) for cell in row] for row in rows], ("value", "limit")))


def _tell_end(record: RunRecord | ExaminationRecord, folder: Path) -> None:
    from reports.again import again

    lines = record.log_tail.splitlines()[-_LOG_LINES:]
    click.echo(f"\nlog, its last {len(lines)} lines:" if lines else "\nlog: empty")
    for line in lines:
        click.echo(f"  {one_line(line)}")
    where = folder / "runs" / record.key
    click.echo(f"\nfiles: {where}")
    provenance = record.provenance
    click.echo(one_line(f"made by touchstone {provenance.touchstone} {provenance.commit[:12]}, {provenance.started}, {provenance.cpu}"))
    click.echo(f"again: {again(record)}")

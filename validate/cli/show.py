"""`show`: print one run of a campaign."""

from __future__ import annotations

import json
from pathlib import Path

import click

from models.errors import did_you_mean
from models.results.check import CheckRecord
from models.results.run import RunRecord
from models.results.stored import to_data
from reports.judged import again, cause_of
from reports.rule import fails
from validate.campaign.stored import CampaignError, campaign_of, stored_names
from validate.cli.options import folder_of
from validate.cli.table import one_line, print_table, say, short, wide_option
from validate.cli.verdict import print_score, print_verdict
from validate.store.store import RECORD, Store

_EPILOG = """\b
Examples:
  python -m validate show runs/all/runs/4f2a...
  python -m validate show 4f2a
  python -m validate show "three_cart x mpcc"
  python -m validate show mpcc --in runs/mine

Exit codes: 0 the run does not fail its campaign; 1 the run fails it; 2 no such
run, or more than one.
"""
_LOG_LINES = 15


@click.command(epilog=_EPILOG)
@click.argument("run", metavar="RUN|KEY|NAME")
@folder_of("--in", "Read the run from this campaign.")
@click.option("--json", "as_json", is_flag=True, help="Print the stored record as JSON.")
@wide_option
def command(run: str, folder: Path, as_json: bool) -> int:
    """Show a run: stages, verdict, questions, metrics, options, log and the command to repeat it.

    The run is named by its folder, the beginning of its key, its name, or a unique part of its name.
    """
    folder, record = find_run(run, folder)
    if as_json:
        click.echo(json.dumps(to_data(record), indent=1, allow_nan=False))
    else:
        if isinstance(record, CheckRecord):
            _print_check(record)
        else:
            _tell_run(record)
        _tell_end(record, folder)
    return 1 if fails(record) else 0


def find_run(run: str, folder: Path) -> tuple[Path, RunRecord | CheckRecord]:
    """Return the campaign's folder and the record of a run, by its folder, key or name.

    Raises CampaignError.
    """
    path = Path(run)
    if path.name == RECORD and len(path.parts) > 1:
        path = path.parent
    if "\0" not in run and len(run) < 4000 and path.is_dir():
        record = Store(path.parent.parent).read(path.name)
        if record is None:
            why = "this folder holds no record that this version reads (it is damaged, or of another schema); give a folder below DIR/runs."
            raise CampaignError(f"{run}: {why}")
        return path.parent.parent, record
    store = Store(folder)
    names = stored_names(store, campaign_of(folder).keys)
    for fits in (
        lambda key: len(run) >= 4 and key.startswith(run),
        lambda key: names[key] == run,
        lambda key: run.lower() in names[key].lower(),
    ):
        fitting = [key for key in names if fits(key)]
        found = [record for key in fitting if (record := store.read(key)) is not None]
        if fitting and not found:
            broken = store.runs / fitting[0] / RECORD
            raise CampaignError(
                f"{names[fitting[0]]}: {broken} cannot be read; the command of the campaign runs it again."
            )
        if len(found) == 1:
            return folder, found[0]
        if found:
            shown = "; ".join(f"{names[record.key]} ({record.key[:12]})" for record in found[:8])
            raise CampaignError(
                f"{run!r} means {len(found)} runs: {shown}{' and more' if len(found) > 8 else ''}. Give one of these keys."
            )
    what = f"its runs are listed in {folder / 'results.csv'}, which `python -m validate report {folder}` writes again."
    raise CampaignError(
        f"there is no run {run!r} in {folder}; {did_you_mean(run, list(names.values()), what, 0.4)}"
    )


def _tell_run(record: RunRecord) -> None:
    last = record.last
    why = (last.why if last is not None else "") or record.message
    print_verdict(record.verdict, why, last, cause_of(record))
    click.echo()
    say(f"{record.title}: {record.outcome}; {record.scene.title}; {record.pipeline_title}")
    if record.message and record.message != why:
        say(record.message)
    click.echo()
    _print_stages(record)
    if last is None:
        return
    if last.metrics:
        print_score(last)
    for sentence in record.scene.waived:
        say(f"waived by the scene: {sentence}")
    if record.scene.unstable:
        say(f"the scene is unstable in the open loop: {record.scene.unstable}")
    click.echo()
    if last.certificate is not None:
        say(f"certificate: {last.certificate.sentence}")
    for stage in record.stages:
        options = ", ".join(f"{name} = {value}" for name, value in stage.options.items())
        say(f"options of stage {stage.index + 1} ({stage.method}): {options or 'none'}")


def _print_stages(record: RunRecord) -> None:
    rows = []
    for stage in record.stages:
        found = [stage.outcome, short(stage.cost, ".4f"), str(stage.iterations), stage.verdict]
        took = [short(stage.seconds.cpu, ".2f"), short(stage.seconds.wall, ".2f")]
        rows.append([str(stage.index + 1), stage.method, short(stage.eps, "g"), *found, *took])
    titles = [
        "stage",
        "method",
        "eps",
        "outcome",
        "cost",
        "iterations",
        "verdict",
        "CPU s",
        "wall s",
    ]
    right, drop = (
        ("stage", "eps", "cost", "iterations", "CPU s", "wall s"),
        ("wall s", "iterations", "CPU s", "stage"),
    )
    print_table(titles, rows, right, drop=drop)


def _print_check(record: CheckRecord) -> None:
    ended = (
        ("passed" if record.passed else "failed")
        if record.outcome == "answered"
        else record.outcome
    )
    say(f"{record.title}: {ended}")
    say(f"expected: {record.expected}")
    say(f"found: {record.found or record.message}")
    if record.figures:
        rows = [
            [figure.name, short(figure.value, ".4g"), figure.unit, short(figure.limit, ".3g")]
            for figure in record.figures
        ]
        click.echo()
        print_table(["figure", "value", "unit", "limit"], rows, ("value", "limit"))


def _tell_end(record: RunRecord | CheckRecord, folder: Path) -> None:
    lines = record.log_tail.splitlines()[-_LOG_LINES:]
    click.echo(f"\nlog, its last {len(lines)} lines:" if lines else "\nlog: empty")
    for line in lines:
        click.echo(f"  {one_line(line)}")
    where = folder / "runs" / record.key
    click.echo(f"\nfiles: {where}")
    provenance = record.provenance
    say(
        f"made by touchstone {provenance.touchstone} {provenance.commit[:12]}, {provenance.started}, {provenance.cpu}"
    )
    click.echo(f"again: {again(record)}")

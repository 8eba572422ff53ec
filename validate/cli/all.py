"""`all`: run the campaign and print its results; `run` uses both steps too."""

from __future__ import annotations

import json
import signal
from collections.abc import Sequence
from typing import Any

import click

from models.errors import MachineError
from models.results.run import RunRecord
from reports.judged import Cause, by_cause, cause_of
from reports.rule import RESULTS, RULE, fails, failures
from validate.campaign.campaign import CampaignResult, run_campaign
from validate.campaign.results import check_rows, rows
from validate.campaign.runs import CampaignSettings
from validate.cli.dry_run import print_dry_run
from validate.cli.narrator import narrator
from validate.cli.options import CHOOSING, DRY_RUN, ENDING, OUT, PRINTING, SELECTING
from validate.cli.table import print_table, say, short
from validate.store.provenance import command_line

_RULE = "\n\n".join(
    [
        "A campaign fails (exit code 1) if",
        *(f"- {line}{'.' if line == RULE[-1] else ';'}" for line in RULE),
        *RESULTS,
    ]
)
_EPILOG = f"""{_RULE}

Stored runs are reused, except crashed runs and runs that reached a shorter
time limit. The key of a run is the hash of its content: scene, pipeline with
all options, our sources, library versions.

\b
Examples:
  python -m validate all --dry-run
  python -m validate all
  python -m validate all --quick
  python -m validate all -k FMU       (our FMUs, checked)
  python -m validate all -k stress    (the stress cases)
  python -m validate all -k "strict and not relaxed"
  python -m validate all --scene my/own_scene.py
  python -m validate all --last-failed

Exit codes: 0 every required check passed; 1 one failed; 2 usage,
configuration or nothing selected; 3 a system requirement is missing
(--dry-run: or its trial fails); 130 interrupted.
"""


@click.command(epilog=_EPILOG)
@CHOOSING
@SELECTING
@ENDING
@DRY_RUN
@OUT
@PRINTING
@click.pass_obj
def command(
    arguments: tuple[str, ...], dry_run: bool, as_json: bool, as_table: bool, **options: Any
) -> int:
    """Run every scene by every pipeline, replay and score each plan, write the report.

    Progress goes to stderr. Findings, reasons of failures and the path of the report go to stdout.
    DIR gets report.html with its pages, results.csv (one row a stage), checks.csv (one row a
    check), violation.csv and campaign.json. Each run has a folder runs/<key>.

    A selection (-k, --scene, --quick, --last-failed) keeps the other runs of DIR in the tables and
    the report.
    """
    settings = CampaignSettings(command=command_line(arguments), **options)
    if dry_run:
        return print_dry_run(settings, as_json=as_json, as_table=as_table)
    return run_and_tell(settings, arguments, as_json=as_json, as_table=as_table)


# Words that are dropped from the command that continues a campaign.
_ONCE = frozenset({"--fresh", "--lf", "--last-failed", "-x"})
# Names listed before "and N more".
_NAMED = 6
# Columns of results.csv that a terminal shows: title and pattern.
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
    ("stage_cpu_s", "CPU s", ".2f"),
    ("stage_s", "wall s", ".2f"),
)
_NUMBERS = ("stage", "eps", "cost", "terminal error", "replayed", "physics", "CPU s", "wall s")
_DROPPED = (
    "wall s",
    "stage",
    "physics",
    "terminal error",
    "outcome",
    "replayed",
    "method",
    "eps",
    "CPU s",
)


def run_and_tell(
    settings: CampaignSettings, arguments: Sequence[str], *, as_json: bool, as_table: bool
) -> int:
    """Run a campaign; print progress to stderr, results to stdout; return the exit code.

    arguments: the words of the command. Raises TouchstoneError.
    """
    # SIGTERM and SIGHUP act like Ctrl-C: children stop, finished runs are kept. Signals that nohup
    # ignores stay ignored.
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    teller = narrator()
    resume = typed([word for word in arguments if word not in _ONCE])
    try:
        outcome = run_campaign(settings, teller)
        if settings.stop_early and teller.stored + teller.done < teller.total:
            click.echo(
                f"stopped at the first failure (-x): {teller.so_far(settings.out)}", err=True
            )
        if as_json:
            _print_json(outcome, settings)
        else:
            if as_table and outcome.records:
                _print_results(outcome.records)
                click.echo()
            _print_summary(outcome, settings)
            click.echo(f"again:   {typed(arguments)}")
    except (KeyboardInterrupt, MachineError) as error:
        done = teller.stored + teller.done
        kept = teller.so_far(settings.out) if teller.total else "nothing was run yet"
        if isinstance(error, MachineError):
            if done < teller.total:
                click.echo(f"stopped: {kept}; resume with: {resume}", err=True)
            raise
        click.echo(f"interrupted: {kept}; resume with: {resume}", err=True)
        return 130
    return outcome.exit_code


def typed(arguments: Sequence[str]) -> str:
    """Return the command as the user typed it."""
    return command_line(arguments, str(click.get_current_context().find_root().info_name))


def _print_summary(outcome: CampaignResult, settings: CampaignSettings) -> None:
    for sentence in outcome.conclusions:
        say(sentence, begin="- ", indent="  ")
    if outcome.conclusions:
        click.echo()
    for kind in dict.fromkeys(record.kind for record in outcome.checks):
        passed = [record.passed for record in outcome.checks if record.kind == kind]
        say(f"{kind}: {sum(passed)} of {len(passed)} checks passed")
    if settings.quick:
        say(f"left out by --quick: {_named(outcome.left_out)}")
    _print_causes([run for run in outcome.records if run.must_hold and not fails(run)])
    for sentence in _grouped(outcome):
        say(sentence, begin="fails: ", indent="  ", colour="red")
    if outcome.records and all(record.outcome == "refused" for record in outcome.records):
        say("nothing was judged: no method applies to its scene, for the reasons in the report")
    elif not outcome.failures:
        say("all required checks passed")
    click.echo(f"report:  {outcome.report}")
    click.echo(f"results: {settings.out / 'results.csv'}")


def _print_causes(runs: Sequence[RunRecord]) -> None:
    """Print why runs that should hold do not: each cause once, with advice.

    These causes are no faults of touchstone.
    """
    lines = [[str(len(mine)), cause.sentence, cause.advice] for cause, mine in by_cause(runs)]
    if lines:
        print_table(
            ["runs", "why they do not hold", "what to do"], lines, ("runs",), drop=("what to do",)
        )
        click.echo()


def _grouped(outcome: CampaignResult) -> list[str]:
    """Return why the campaign fails: a sentence for each shared cause and each other failure."""
    causes = {
        sentence: cause
        for run in outcome.records
        if (cause := cause_of(run))
        for sentence in failures([run])[:1]
    }
    groups: dict[Cause | str, list[str]] = {}
    for sentence in outcome.failures:
        groups.setdefault(causes.get(sentence, sentence), []).append(sentence)
    told = []
    for cause, sentences in groups.items():
        names = [sentence.partition(": ")[0] for sentence in sentences]
        if isinstance(cause, str) or len(names) == 1:
            told.append(sentences[0])
        else:
            told.append(
                f"{len(names)} runs - {cause.sentence}. {cause.advice} ({', '.join(names)})"
            )
    return told


def _named(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}" if names else "nothing"


def _print_json(outcome: CampaignResult, settings: CampaignSettings) -> None:
    data = {
        "results": rows(outcome.records),
        "checks": check_rows(outcome.checks),
        "conclusions": list(outcome.conclusions),
        "failures": list(outcome.failures),
        "findings": list(outcome.findings),
        "left_out": list(outcome.left_out),
        "report": str(outcome.report),
        "out": str(settings.out),
        "exit_code": outcome.exit_code,
    }
    click.echo(json.dumps(data, indent=1, allow_nan=False))


def _print_results(records: Sequence[RunRecord]) -> None:
    """Print the columns of results.csv that fit a terminal.

    `replayed` is the terminal error after the judged replay.
    """
    content = rows(records)
    for row in content:
        if row["judged"] == "feedback":
            row["replay_terminal_error"] = row["tracked_replay_terminal_error"]
    cells = [[short(row[name], pattern) for name, _, pattern in _TITLES] for row in content]
    place = [name for name, _, _ in _TITLES].index("verdict")
    for line, stage in zip(
        cells, [stage for record in records for stage in record.stages], strict=True
    ):
        if stage.kind == "indirect" and stage.verdict == "violates":
            line[place] = "as expected: violates"
    print_table([title for _, title, _ in _TITLES], cells, _NUMBERS, drop=_DROPPED)

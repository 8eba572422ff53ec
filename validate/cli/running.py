"""Runs a campaign and tells of it: what `all` and `run` share."""

from __future__ import annotations

import json
import signal
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from models.errors import MachineError
from validate.cli.table import use_colour

if TYPE_CHECKING:
    from validate.execution.campaign import CampaignResult
    from validate.plan.runs import CampaignSettings

# Words of a command that the same command, typed again to go on, does without.
_ONCE = frozenset({"--fresh", "--lf", "--last-failed", "-x"})


def run_and_tell(settings: CampaignSettings, arguments: Sequence[str], as_json: bool) -> int:
    """Run it, progress on stderr, results on stdout; the exit code. arguments: the words of the command. Raises TouchstoneError."""
    from validate.cli.narrator import narrator
    from validate.execution.campaign import run_campaign
    from validate.store.provenance import command_line

    # A closed terminal and a polite kill end like Ctrl-C: children stopped, finished runs kept. What nohup ignores stays ignored.
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    teller = narrator()
    resume = command_line([word for word in arguments if word not in _ONCE])
    try:
        outcome = run_campaign(settings, teller)
        if settings.stop_early and teller.stored + teller.done < teller.total:
            click.echo(f"stopped at the first failure (-x): {teller.so_far(settings.out)}", err=True)
        if as_json:
            _print_json(outcome, settings)
        else:
            _print_table(outcome, settings, resume)
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


def _print_table(outcome: CampaignResult, settings: CampaignSettings, resume: str) -> None:
    from validate.cli.table import one_line, results_table

    colour = use_colour()
    if outcome.records:
        click.echo(results_table(outcome.records), color=colour)
        click.echo()
    for kind in dict.fromkeys(record.kind for record in outcome.examinations):
        passed = [record.passed for record in outcome.examinations if record.kind == kind]
        click.echo(f"{kind}: {sum(passed)} of {len(passed)} checks passed")
    if settings.quick:
        click.echo(f"left out by --quick: {', '.join(outcome.left_out) or 'nothing'}")
    for sentence in outcome.failures:
        click.echo(click.style("fails: ", fg="red") + one_line(sentence), color=colour)
    for sentence in outcome.findings:
        click.echo(f"found: {one_line(sentence)}", color=colour)
    if outcome.records and all(record.outcome == "refused" for record in outcome.records):
        click.echo("nothing was judged: no method applies to its scene, for the reasons in the report")
    elif not outcome.failures:
        click.echo("all required checks passed")
    click.echo(f"report:  {outcome.report}")
    click.echo(f"results: {settings.out / 'results.csv'}")
    click.echo(f"again:   {resume}   (stored runs are used again; --fresh runs them anew)")


def _print_json(outcome: CampaignResult, settings: CampaignSettings) -> None:
    from validate.store.results import examination_rows, rows

    data = {
        "results": rows(outcome.records),
        "examinations": examination_rows(outcome.examinations),
        "failures": list(outcome.failures),
        "findings": list(outcome.findings),
        "left_out": list(outcome.left_out),
        "report": str(outcome.report),
        "out": str(settings.out),
        "exit_code": outcome.exit_code,
    }
    click.echo(json.dumps(data, indent=1, allow_nan=False))

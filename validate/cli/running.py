"""Runs a campaign and says what came of it: what `all` and `run` share."""

from __future__ import annotations

import json
import shlex
import signal
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from models.errors import MachineError
from validate.cli.table import one_line, results_table, say, table, use_colour

if TYPE_CHECKING:
    from reports.causes import Cause
    from reports.records.record import RunRecord
    from validate.execution.campaign import CampaignResult
    from validate.plan.runs import CampaignSettings

# Words of a command that the same command, typed again to go on, does without.
_ONCE = frozenset({"--fresh", "--lf", "--last-failed", "-x"})
# So many of what --quick left out are named.
_NAMED = 6


def run_and_tell(settings: CampaignSettings, arguments: Sequence[str], *, as_json: bool, as_table: bool) -> int:
    """Run it, progress on stderr, results on stdout; the exit code. arguments: the words of the command. Raises TouchstoneError."""
    from validate.cli.narrator import narrator
    from validate.execution.campaign import run_campaign

    # A closed terminal and a polite kill end like Ctrl-C: children stopped, finished runs kept. What nohup ignores stays ignored.
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    teller = narrator()
    resume = typed([word for word in arguments if word not in _ONCE])
    try:
        outcome = run_campaign(settings, teller)
        if settings.stop_early and teller.stored + teller.done < teller.total:
            click.echo(f"stopped at the first failure (-x): {teller.so_far(settings.out)}", err=True)
        if as_json:
            _print_json(outcome, settings)
        else:
            if as_table and outcome.records:
                click.echo(results_table(outcome.records), color=use_colour())
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
    """The command as it was typed, fit for any shell: zsh takes an unquoted =word for the path of a program."""
    words = (f"'{word}'" if word.startswith("=") and shlex.quote(word) == word else shlex.quote(word) for word in arguments)
    return " ".join([str(click.get_current_context().find_root().info_name), *words])


def _print_summary(outcome: CampaignResult, settings: CampaignSettings) -> None:
    from reports.rule import fails

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
    """Why runs that should hold do not, although nothing is wrong with touchstone: each cause once, with what to do."""
    from reports.causes import by_cause

    rows = [[str(len(mine)), one_line(cause.sentence), one_line(cause.advice)] for cause, mine in by_cause(runs)]
    if rows:
        click.echo(table(["runs", "why they do not hold", "what to do"], rows, ("runs",), drop=("what to do",)))
        click.echo()


def _grouped(outcome: CampaignResult) -> list[str]:
    """Why the campaign fails: a sentence for each cause that several runs share, and for each failure that is alone with its cause."""
    from reports.causes import cause_of
    from reports.rule import failures

    causes = {sentence: cause for run in outcome.records if (cause := cause_of(run)) for sentence in failures([run])[:1]}
    groups: dict[Cause | str, list[str]] = {}
    for sentence in outcome.failures:
        groups.setdefault(causes.get(sentence, sentence), []).append(sentence)
    return [
        sentences[0] if len(sentences) == 1 or isinstance(cause, str) else _shared(cause, sentences) for cause, sentences in groups.items()
    ]


def _shared(cause: Cause, sentences: Sequence[str]) -> str:
    names = [sentence.partition(": ")[0] for sentence in sentences]
    return f"{len(names)} runs - {cause.sentence}. {cause.advice} ({', '.join(names)})"


def _named(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}" if names else "nothing"


def _print_json(outcome: CampaignResult, settings: CampaignSettings) -> None:
    from validate.store.results import check_rows, rows

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

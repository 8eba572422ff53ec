"""`all`: the campaign."""

from __future__ import annotations

import json
import signal
import textwrap
from pathlib import Path

import click

from reports.rule import RESULTS, RULE
from validate.cli.campaign_options import campaign_options
from validate.cli.table import use_colour


def _wrapped(text: str) -> str:
    return textwrap.fill(text, width=77, initial_indent="  ", subsequent_indent="  ")


_RULE = "\n\n".join(
    [
        "\b\nA campaign fails (exit code 1) if\n" + ";\n".join(_wrapped(line) for line in RULE) + ".",
        "\b\n" + "\n".join(_wrapped(line) for line in RESULTS),
    ]
)
_EPILOG = f"""{_RULE}

\b
What is stored is used again, except cells that crashed or ran out of a
shorter time limit than they would have now. A cell's key is the hash of its
content: scene, pipeline with all options, our sources, library versions.

\b
Examples:
  python -m validate all                               everything
  python -m validate all --quick                       three pipelines
  python -m validate all -k FMU                        only our FMUs, checked
  python -m validate all -k hard                       only the hard cases
  python -m validate all -k "strict and not relaxed"   some
  python -m validate all --scene my/own_scene.py       a scene of your own

\b
Exit codes: 0 all that must hold holds; 1 something does not; 2 usage,
configuration or nothing selected; 3 this machine cannot; 130 interrupted.
"""


@click.command(epilog=_EPILOG)
@campaign_options
@click.option("--json", "as_json", is_flag=True, help="The results as JSON on stdout instead of a table.")
@click.pass_obj
def command(
    arguments: tuple[str, ...],
    quick: bool,
    fresh: bool,
    expression: str,
    jobs: int,
    scenes: tuple[str, ...],
    out: Path,
    time_limit: float,
    as_json: bool,
    tools: str,
) -> int:
    """Run every scene by every pipeline, replay and score each plan, write the report.

    Progress goes to stderr; the table of results and the path of the report to stdout. DIR then holds report.html,
    results.csv (one row a stage), examinations.csv (one row an examination, such as the check of a scene's FMU), violation.csv,
    starts.csv (one row a start), front.csv (one row a terminal tolerance), campaign.json and, for each cell, runs/<key>.
    """
    from validate.campaign import Settings, run_campaign
    from validate.cli.narrator import narrator
    from validate.provenance import command_line

    settings = Settings(
        out=out,
        scenes=scenes,
        quick=quick,
        expression=expression,
        jobs=jobs,
        fresh=fresh,
        time_limit=time_limit,
        tools=tools,
        command=command_line(arguments),
    )
    # A closed terminal and a polite kill end like Ctrl-C: children stopped, finished cells kept. What nohup ignores stays ignored.
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    teller = narrator()
    resume = command_line([word for word in arguments if word != "--fresh"])
    try:
        outcome = run_campaign(settings, teller)
    except KeyboardInterrupt:
        done = teller.stored + teller.done
        kept = f"{done} of {teller.total} cells are stored in {out}" if teller.total else "nothing was run yet"
        click.echo(f"interrupted: {kept}; resume with: {resume}", err=True)
        return 130
    if as_json:
        _print_json(outcome, settings)
    else:
        _print_table(outcome, settings, resume)
    return outcome.exit_code


def _print_table(outcome, settings, resume: str) -> None:
    from validate.cli.table import one_line, results_table

    colour = use_colour()
    if outcome.records:
        click.echo(results_table(outcome.records), color=colour)
        click.echo()
    for kind in dict.fromkeys(record.kind for record in outcome.examinations):
        passed = [record.passed for record in outcome.examinations if record.kind == kind]
        click.echo(f"{kind}: {sum(passed)} of {len(passed)} examinations passed")
    if settings.quick:
        click.echo(f"left out by --quick: {', '.join(outcome.left_out) or 'nothing'}")
    for sentence in outcome.failures:
        click.echo(click.style("fails: ", fg="red") + one_line(sentence), color=colour)
    if outcome.records and all(record.outcome == "refused" for record in outcome.records):
        click.echo("nothing was judged: every method refused its scene, for the reasons in the report")
    elif not outcome.failures:
        click.echo("the campaign does not fail: all that must hold holds")
    click.echo(f"report:  {outcome.report}")
    click.echo(f"results: {settings.out / 'results.csv'}")
    click.echo(f"again:   {resume}   (stored cells are used again; --fresh runs them anew)")


def _print_json(outcome, settings) -> None:
    from validate.results import examination_rows, rows

    data = {
        "results": rows(outcome.records),
        "examinations": examination_rows(outcome.examinations),
        "failures": list(outcome.failures),
        "left_out": list(outcome.left_out),
        "report": str(outcome.report),
        "out": str(settings.out),
        "exit_code": outcome.exit_code,
    }
    click.echo(json.dumps(data, indent=1, allow_nan=False))

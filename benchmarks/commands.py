"""The commands of `python -m benchmarks`: every benchmark by its name."""

from __future__ import annotations

import click

from validate.cli.group import LazyGroup

_COMMANDS = {
    "suite": ("suite.command", "CPU seconds of each stage, beside what people would use instead."),
    "plans": ("suite.plans", "Exact plans of random rows of carts, by several pipelines."),
    "ablate": ("ablate.command", "Planners without one of their rules: what gets worse."),
    "strangers": ("strangers.command", "Scenes drawn by a seed: which have a plan that holds."),
    "mpec-sets": ("mpec.sets", "MPECs as .nl files: answers, certificates, published optima."),
    "verdicts": ("verdicts.command", "Plans whose verdict is known, and a search for cheats."),
    "kills": ("kills", "Campaigns killed at random moments and resumed: nothing is lost."),
    "field": ("field.command", "Published plans, solved again, judged, and beside our own."),
    "golden": ("golden", "A full campaign frozen as data, and what a change moved."),
    "rejudge": ("rejudge", "The stored plans of a campaign, judged again."),
    "account": ("account", "Where the seconds of a campaign went."),
    "report": ("report", "Size of a campaign's report, and seconds until a browser shows it."),
    "house": ("house", "How large and how tangled the code is."),
}
_EPILOG = """\b
Examples:
  python -m benchmarks suite --size 3x50 --rounds 2
  python -m benchmarks verdicts exact --scene three_cart

\b
Peers are measured if they are installed: pip install -e '.[bench,bench-drake]'.
Exit codes are those of `python -m validate`; a trial that finds a fault ends with 1.
"""


@click.group(
    cls=LazyGroup,
    lazy={name: (f"benchmarks.{module}", words) for name, (module, words) in _COMMANDS.items()},
    epilog=_EPILOG,
    context_settings={"help_option_names": ["-h", "--help"]},
)
def group() -> None:
    """Measure touchstone and try it. Needs a checkout of the sources."""

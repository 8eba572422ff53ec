"""The commands of `python -m benchmarks`: every benchmark by its name."""

from __future__ import annotations

import click

from validate.cli.group import LazyGroup

_COMMANDS = {
    "suite": ("suite.command", "How fast each stage is, beside what people would use instead."),
    "plans": (
        "suite.plans",
        "Exact plans by every pipeline, on scenes with friction and random rows of carts.",
    ),
    "mpec-sets": (
        "mpec.sets",
        "A folder of MPECs as `.nl` files: answers, certificates, published optima.",
    ),
    "proof": ("proof", "What can be proved about contact plans, and how soon."),
    "verdicts": (
        "verdicts.command",
        "Plans whose verdict is known without the judge, and a search for ones that cheat it.",
    ),
    "kills": (
        "kills",
        "Campaigns, and what runs for them, killed at random moments and resumed: nothing is lost.",
    ),
    "report": ("report", "What a campaign's report weighs, and how soon a browser shows it."),
    "golden": ("golden", "What a full campaign found, frozen as data, and what a change moved."),
    "account": ("account", "Where the seconds of a campaign went."),
    "rejudge": ("rejudge", "The stored plans of a campaign, judged anew."),
    "house": ("house", "How large and how tangled the code is."),
}
_EPILOG = """\b
Examples:
  python -m benchmarks suite --quick
  python -m benchmarks verdicts exact --scene three_cart

\b
Peers are measured if they are installed: pip install -e '.[bench]' drake.
Exit codes are those of `python -m validate`; a trial that finds a fault ends with 1.
"""


@click.group(
    cls=LazyGroup,
    lazy={name: (f"benchmarks.{module}", words) for name, (module, words) in _COMMANDS.items()},
    epilog=_EPILOG,
    context_settings={"help_option_names": ["-h", "--help"]},
)
def group() -> None:
    """What is measured about touchstone, and what it is tried on.

    Needs a checkout of the sources.
    """

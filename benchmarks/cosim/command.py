"""`cosim`: what it costs to split a scene into FMUs, contacts in FMUs of their own."""

from __future__ import annotations

import math
from pathlib import Path

import click

from benchmarks.cosim.study import EVERY, MACRO_STEPS, cases, study
from benchmarks.options import POSITIVE, out_option
from benchmarks.results import store


def _dividing(
    context: click.Context, parameter: click.Parameter, steps: tuple[float, ...]
) -> tuple[float, ...]:
    for h in steps:
        if not h <= EVERY or not math.isclose(round(EVERY / h) * h, EVERY, rel_tol=1e-9):
            raise click.BadParameter(
                f"{h:g} s does not divide {EVERY:g} s, the times at which motions are compared.",
                context,
                parameter,
            )
    return steps


@click.command()
@click.option(
    "--step", "steps", type=POSITIVE, multiple=True, default=MACRO_STEPS, callback=_dividing,
    help="A macro step [s] that divides 0.01 s; may be repeated.",
)  # fmt: skip
@out_option
def command(steps: tuple[float, ...], out: Path) -> int:
    """Energy, momentum and CPU time of a split scene against the macro step; 5 CPU minutes.

    Masters: Jacobi, contact first (Gauss-Seidel), force extrapolated, iterated with rollback - all
        ours -, libcosim with fixed steps and with
    ECCO (where [fmu-check] is installed), and the whole scene as one FMU. docs/cosimulation.md says
        what was found.
    """
    told = [study(case, steps, lambda line: click.echo(line, err=True)) for case in cases()]
    for case in told:
        click.echo(f"{case['title']}: omega = {case['frequency']:.4g} rad/s")
        click.echo(f"  {'':16}" + "".join(f"{h:>12g}" for h in steps))
        for master in case["masters"]:
            errors = "".join(f"{row['energy_error']:>+12.2e}" for row in master["rows"])
            click.echo(f"  {master['name']:16}{errors} {master['failed']}")
    store(out, "cosim", {"kind": "cosim", "cases": told})
    return 0

"""The strict three carts (T = 500) and small MacMPEC problems: ours beside CasADi + Ipopt, pympcc, mpecss and nosnoc, all in one run.

Every solve is a process of its own (one thread, a limit of CPU seconds): what is told is the CPU
time of the whole process, imports, model and derivatives included. All start from the same seeded
rollouts; one function in NumPy (mpec/judge.py) recomputes cost and residual of every point that a
peer believes on its way (its own time left out), so that peers can be compared at equal residual:
the CPU seconds until the residual is at most 1e-6, and 1e-10. Residual: largest violation of any
equation, in SI units, of min(lam, lam - k phi) too. A peer that tells nothing on its way (ours,
mpecss, nosnoc) is charged its whole time. docs/mpec_peers.md holds a measured table.
"""

from __future__ import annotations

import json
import math
import statistics
from pathlib import Path
from typing import Any

import click

from benchmarks.mpec.process import reached, run_one
from benchmarks.options import POSITIVE, out_option
from benchmarks.records import Table
from benchmarks.results import store_tables, tables_of

Row = dict[str, Any]
PEERS = ("mpcc", "mpec_ipopt", "casadi_scholtes", "nosnoc", "pympcc", "mpecss")
GENERAL = PEERS[1:]
PACKAGES = PEERS[3:]
# Small problems whose conditions have one bound on each side, so that every peer can be given them.
MACMPEC = (
    "bard1", "bilin", "dempe", "desilva", "df1", "gauvin", "jr1", "kth3", "outrata31", "ralph1",
    "scholtes1", "scholtes3", "scholtes4", "scholtes5",
    "stackelberg1",
)  # fmt: skip
# Residuals at which the carts are compared; on MacMPEC the one of a point, and the distance from
# the published optimum (relative) that counts as reaching it: a relaxation at eps = 1e-8 can have
# 1e-4 where both sides of a pair are small.
_EQUAL = (1e-6, 1e-10)
_LOOSE = 1e-3
_REACHED = 1e-4


def carts_table(caption: str, rows: list[Row]) -> Table:
    """A row a peer: cost and last residual of the runs that have a point.

    CPU seconds until a residual, medians of all runs (never: more than

    half did not reach it), and how many did.
    """
    lines = []
    for peer in dict.fromkeys(row["peer"] for row in rows):
        mine = [row for row in rows if row["peer"] == peer]
        points = [row for row in mine if "residual" in row]
        reasons = [row["reason"] for row in mine if "reason" in row]
        remark = "; ".join(f"{reasons.count(reason)}: {reason}" for reason in sorted(set(reasons)))
        cost, residual, miss = (
            [row[key] for row in points] for key in ("cost", "residual", "miss")
        )
        figures: tuple[float | None, ...] = (None,) * 5
        if points:
            figures = (
                min(cost),
                statistics.median(cost),
                max(cost),
                statistics.median(residual),
                statistics.median(miss),
            )
        cpu = [row["cpu_s"] for row in mine]
        equal = []
        for limit in _EQUAL:
            seconds = [reached(row, limit) for row in mine]
            middle = statistics.median(seconds)
            equal += [
                f"{middle:.1f}" if math.isfinite(middle) else "never",
                f"{sum(map(math.isfinite, seconds))}/{len(mine)}",
            ]
        lines.append(
            (
                peer,
                len(mine),
                *figures,
                f"{statistics.median(cpu):.1f} ({min(cpu):.1f}-{max(cpu):.1f})",
                *equal,
                remark,
            )
        )
    columns = (
        "peer", "runs", "cost: best", "median", "worst", "last residual: median", "miss: median",
        "CPU s: median (range)", "CPU s to 1e-6", "reached",
        "CPU s to 1e-10", "reached", "remark",
    )  # fmt: skip
    return Table(caption=caption, columns=columns, rows=tuple(lines))


def macmpec_table(rows: list[Row]) -> Table:
    """A row a problem: cost, residual, CPU seconds of each peer.

    And how many reached the published optimum.
    """
    peers = list(dict.fromkeys(row["peer"] for row in rows))
    lines = []
    for name in dict.fromkeys(row["problem"] for row in rows):
        mine = {row["peer"]: row for row in rows if row["problem"] == name}
        optimum = next((row["optimum"] for row in mine.values() if "optimum" in row), None)
        cells = [
            f"{row['cost']:.6g}, {row['residual']:.0e}, {row['cpu_s']:.1f}"
            if "cost" in row
            else row["reason"][:60]
            for row in (mine[peer] for peer in peers)
        ]
        lines.append((name, optimum, *cells))
    notes = []
    for peer in peers:
        mine = [row for row in rows if row["peer"] == peer]
        count = sum(
            "cost" in row
            and row["residual"] <= _LOOSE
            and abs(row["cost"] - row["optimum"]) <= _REACHED * max(1.0, abs(row["optimum"]))
            for row in mine
        )
        exact = sum(row.get("residual", math.inf) <= _EQUAL[1] for row in mine)
        cpu = statistics.median(row["cpu_s"] for row in mine)
        notes.append(
            f"{peer}: published optimum reached by {count} of {len(mine)}; residual <= 1e-10 in {exact}; CPU s, median {cpu:.1f}"
        )
    columns = ("problem", "published", *(f"{peer}: cost, residual, CPU s" for peer in peers))
    return Table(
        caption="Small MacMPEC problems.", columns=columns, rows=tuple(lines), notes=tuple(notes)
    )


def tables(rows: list[Row]) -> list[Table]:
    carts, problems = (
        [row for row in rows if (row["problem"] == "three_cart") is on] for on in (True, False)
    )
    told = [
        carts_table(
            "From the paper's first guess (start held, no force).",
            [row for row in carts if row["seed"] < 0],
        ),
        carts_table("From random starts.", [row for row in carts if row["seed"] >= 0]),
    ]
    return [*told, macmpec_table(problems)] if problems else told


@click.command()
@click.option(
    "--seeds",
    type=click.IntRange(min=0),
    default=20,
    show_default=True,
    help="Random starts a peer.",
)
@click.option(
    "--package-seeds",
    type=click.IntRange(min=0),
    default=20,
    show_default=True,
    help=f"Random starts for {', '.join(PACKAGES)}.",
)
@click.option(
    "--limit",
    type=POSITIVE,
    default=60.0,
    show_default=True,
    metavar="SECONDS",
    help="CPU seconds of one solve.",
)
@click.option("--no-macmpec", is_flag=True, help="The carts alone.")
@out_option
def command(seeds: int, package_seeds: int, limit: float, no_macmpec: bool, out: Path) -> int:
    """Strict complementarity on three carts and small MacMPEC problems, ours beside other people's.

    Runs that are in DIR already are kept.
    """
    record = tables_of(out, "mpec-peers")
    rows: list[Row] = [] if record is None else [dict(run) for run in record.runs]
    asked = [
        (peer, "three_cart", seed)
        for seed in (-1, *range(seeds))
        for peer in PEERS
        if peer not in PACKAGES or seed < package_seeds
    ] + [(peer, name, 0) for name in (() if no_macmpec else MACMPEC) for peer in GENERAL]
    done = {(row["peer"], row["problem"], row["seed"]) for row in rows}
    about = (__doc__ or "").split("\n\n")[0]
    for peer, problem, seed in asked:
        if (peer, problem, seed) not in done:
            rows.append(run_one(peer, problem, seed, limit))
            click.echo(
                json.dumps({key: value for key, value in rows[-1].items() if key != "path"}),
                err=True,
            )
            store_tables(
                out,
                "mpec-peers",
                "Strict complementarity beside other solvers",
                about,
                tables(rows),
                rows,
                quiet=True,
            )
    store_tables(
        out, "mpec-peers", "Strict complementarity beside other solvers", about, tables(rows), rows
    )
    return 0

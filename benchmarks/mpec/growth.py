"""How `mpec_ipopt` grows: control of a membrane over an obstacle, a pair a grid point, on square grids of 10, 32 and 55 points a side.

min over y, u of h^2 (|y - target|^2 + 1e-2 |u|^2) / 2 with 0 <= y - obstacle complementary to -h^2
Laplace(y) - h^2 (force + u) >= 0 on the unit square, y = 0 around it, |u| <= 20. Every size is a
process of its own (one thread): CPU seconds of all of it and its largest memory, what the
certificate says, and the exponent of growth from size to size.
"""

from __future__ import annotations

import json
import math
import resource
import sys
from pathlib import Path
from typing import Any

import click
import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

from benchmarks.measure import run_child
from benchmarks.options import COUNT, out_option
from benchmarks.records import Table
from benchmarks.results import store_tables

_FORCE = -10.0
_CONTROL = 20.0
_WEIGHT = 1e-2


def membrane(side: int) -> pyo.ConcreteModel:
    """The model, `side` inner points a side: side**2 pairs; started at rest on y = 0."""
    h = 1.0 / (side + 1)
    m = pyo.ConcreteModel(name=f"membrane of {side} x {side}")
    m.points = pyo.Set(initialize=[(i, j) for i in range(side) for j in range(side)])
    m.y = pyo.Var(m.points, initialize=0.0)
    m.u = pyo.Var(m.points, initialize=0.0, bounds=(-_CONTROL, _CONTROL))

    def place(i: int, j: int) -> tuple[float, float]:
        return (i + 1) * h, (j + 1) * h

    def pressed(m: Any, i: int, j: int) -> Any:
        around = sum(
            m.y[a, b]
            for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1))
            if (a, b) in m.points
        )
        return 4 * m.y[i, j] - around - h**2 * (_FORCE + m.u[i, j])

    def obstacle(i: int, j: int) -> float:
        s, t = place(i, j)
        return -0.1 - 0.5 * ((s - 0.5) ** 2 + (t - 0.5) ** 2)

    def target(i: int, j: int) -> float:
        s, t = place(i, j)
        return 0.2 * math.sin(2 * math.pi * s) * math.sin(math.pi * t)

    m.pressure = pyo.Expression(m.points, rule=pressed)
    m.contact = Complementarity(
        m.points,
        rule=lambda m, i, j: complements(m.y[i, j] >= obstacle(i, j), m.pressure[i, j] >= 0),
    )
    m.cost = pyo.Objective(
        expr=h**2 / 2 * sum((m.y[p] - target(*p)) ** 2 + _WEIGHT * m.u[p] ** 2 for p in m.points)
    )
    return m


def solve(side: int) -> dict[str, Any]:
    from formulations.mpec import solve_mpec

    result = solve_mpec(membrane(side))
    certificate = result.certificate
    told = {
        "side": side,
        "outcome": result.outcome.name,
        "cost": result.objective,
        "iterations": result.iterations,
        "strategy": result.strategy,
    }
    if certificate is not None:
        told |= {
            "primal": certificate.primal, "complementarity": certificate.complementarity,
            "letter": certificate.stationarity.letter,
            "b_stationary": bool(certificate.b_stationary),
            "contact": sum(bool(pair.first <= 0.0) for pair in result.pairs),
        }  # fmt: skip
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return {**told, "cpu_s": usage.ru_utime + usage.ru_stime, "memory_mib": usage.ru_maxrss / 1024}


@click.command()
@click.option(
    "--side",
    "sides",
    type=COUNT,
    multiple=True,
    default=(10, 32, 55),
    show_default=True,
    help="Grid points a side; may be repeated.",
)
@click.option(
    "--limit",
    type=COUNT,
    default=300,
    show_default=True,
    metavar="SECONDS",
    help="CPU seconds of one size.",
)
@out_option
def command(sides: tuple[int, ...], limit: int, out: Path) -> int:
    """How `mpec_ipopt` grows with the number of pairs: a membrane over an obstacle."""
    rows: list[dict[str, Any]] = []
    for side in dict.fromkeys(sides):
        done = run_child("benchmarks.mpec.growth", str(side), cpu_limit=limit)
        if done.returncode:
            reason = done.stderr.strip().splitlines()[-1:] or [f"no answer within {limit} CPU s"]
            rows.append({"side": side, "outcome": reason[0]})
        else:
            rows.append(json.loads(done.stdout.splitlines()[-1]))
        click.echo(f"{side**2} pairs: {rows[-1]['outcome']}", err=True)
    lines, before = [], None
    for row in rows:
        grown = None
        if before is not None and "cpu_s" in row:
            grown = math.log(row["cpu_s"] / before["cpu_s"]) / math.log(
                (row["side"] / before["side"]) ** 2
            )
        letter = f"{row.get('letter', '-')}{', B' if row.get('b_stationary') else ''}"
        figures = (row.get(name) for name in ("iterations", "cost", "contact", "complementarity"))
        lines.append(
            (
                str(row["side"] ** 2),
                row.get("cpu_s"),
                row.get("memory_mib"),
                grown,
                *figures,
                f"{row['outcome']} {letter}",
            )
        )
        before = row if "cpu_s" in row else before
    columns = (
        "pairs",
        "CPU s",
        "memory [MiB]",
        "exponent of CPU",
        "iterations",
        "cost",
        "in contact",
        "complementarity",
        "class",
    )
    told_table = Table(
        caption="A pair a grid point; CPU time and memory of the whole process.",
        columns=columns,
        rows=tuple(lines),
    )
    about = "Control of a membrane over an obstacle, by mpec_ipopt with its default settings."
    store_tables(out, "mpec-growth", "Growth with the number of pairs", about, [told_table], rows)
    return 0


if __name__ == "__main__":
    click.echo(json.dumps(solve(int(sys.argv[1])), default=float))

"""How `mpec_ipopt` grows: control of a membrane over an obstacle, a pair a grid point, on square grids of 10, 32 and 55 points a side.

    python benchmarks/bench_mpec_obstacle.py [--sides 10 32 55] [--limit 300]

min over y, u of h^2 (|y - target|^2 + 1e-2 |u|^2) / 2 with 0 <= y - obstacle complementary to -h^2 Laplace(y) - h^2 (force + u) >= 0 on the unit
square, y = 0 around it, |u| <= 20. Every size is a process of its own (one thread): CPU seconds of all of it and its largest memory, what the
certificate says, and the exponent of growth from size to size.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import subprocess
import sys
from typing import Any

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

_FORCE, _CONTROL, _WEIGHT = -10.0, 20.0, 1e-2


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
        around = sum(m.y[a, b] for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)) if (a, b) in m.points)
        return 4 * m.y[i, j] - around - h**2 * (_FORCE + m.u[i, j])

    def obstacle(i: int, j: int) -> float:
        s, t = place(i, j)
        return -0.1 - 0.5 * ((s - 0.5) ** 2 + (t - 0.5) ** 2)

    def target(i: int, j: int) -> float:
        s, t = place(i, j)
        return 0.2 * math.sin(2 * math.pi * s) * math.sin(math.pi * t)

    m.pressure = pyo.Expression(m.points, rule=pressed)
    m.contact = Complementarity(m.points, rule=lambda m, i, j: complements(m.y[i, j] >= obstacle(i, j), m.pressure[i, j] >= 0))
    m.cost = pyo.Objective(expr=h**2 / 2 * sum((m.y[p] - target(*p)) ** 2 + _WEIGHT * m.u[p] ** 2 for p in m.points))
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
            "primal": certificate.primal,
            "complementarity": certificate.complementarity,
            "letter": certificate.stationarity.letter,
            "b_stationary": bool(certificate.b_stationary),
            "contact": sum(bool(pair.first <= 0.0) for pair in result.pairs),
        }
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return {**told, "cpu_s": usage.ru_utime + usage.ru_stime, "memory_mib": usage.ru_maxrss / 1024}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", type=int, nargs="+", default=[10, 32, 55], help="grid points a side (default 10 32 55)")
    parser.add_argument("--limit", type=int, default=300, help="CPU seconds of one size (default 300)")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(json.dumps(solve(asked.one), default=float))
        return
    print("| pairs | CPU s | memory, MiB | exponent of CPU | iterations | cost | in contact | complementarity | class |\n|" + "---:|" * 9)
    before: dict[str, Any] | None = None
    for side in asked.sides:
        child = subprocess.run(
            [sys.executable, __file__, "--one", str(side)], capture_output=True, text=True, check=False,
            env={**os.environ, **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")},
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (asked.limit, asked.limit + 1)),
        )  # fmt: skip
        if child.returncode:
            reason = child.stderr.strip().splitlines()[-1:] or [f"no answer within {asked.limit} CPU s"]
            print(f"| {side**2} | {reason[0]} |", flush=True)
            continue
        row = json.loads(child.stdout.splitlines()[-1])
        grown = "" if before is None else f"{math.log(row['cpu_s'] / before['cpu_s']) / math.log((side / before['side']) ** 2):.2f}"
        stationarity = f"{row.get('letter', '-')}{', B' if row.get('b_stationary') else ''}"
        print(
            f"| {side**2} | {row['cpu_s']:.1f} | {row['memory_mib']:.0f} | {grown} | {row['iterations']} | {row['cost']:.8g} | {row.get('contact', '-')} | "
            f"{row.get('complementarity', math.nan):.1e} | {row['outcome']} {stationarity} |",
            flush=True,
        )
        before = row


if __name__ == "__main__":
    main()

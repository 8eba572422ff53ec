"""`mpec-sets`: the MPECs of a folder of `.nl` files, each solved in a child with limits, beside the published optima and CasADi with Ipopt.

    python -m benchmarks mpec-sets --from DIR --optima optima.csv

The optima are a CSV of `name, .., published_optimum`. A certificate recomputes rows, bounds, pairs
and stationarity from the values of the variables. If rows are linear and the objective is convex,
and the published value is not reached, a tree of convex programs bounds the global optimum
(`benchmarks.mpec.proved`). With `--peer N`, CasADi and Ipopt solve each problem of at most N pairs
too (`benchmarks.mpec.peer`).
"""

from __future__ import annotations

import csv
import json
import math
import os
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import click

from benchmarks.measure import run_child
from benchmarks.mpec.proved import prove
from benchmarks.options import COUNT, POSITIVE, out_option
from benchmarks.results import as_markdown
from validate.cli.options import FiniteRange, write, written_to
from validate.processes.disk import make_folder, temporary_folder

# A published value is reached within this, relative to max(1, |value|).
REACHED = 1e-4
# CPU seconds for reading the model and judging the point.
_BESIDE = 30.0
_COLUMNS = ("problem", "variables", "rows", "pairs", "status", "objective", "published",
            "against it", "bound", "stationary", "primal", "complementarity", "dual",
            "CPU s", "strategy", "peer's objective", "peer's CPU s", "remark")  # fmt: skip
_PAGE = ("problem", "pairs", "status", "objective", "published", "against it", "stationary",
         "primal, complementarity, dual", "CPU s", "by",
         "CasADi + Ipopt", "its CPU s")  # fmt: skip


def solve_one(model: Any, proof_seconds: float, published: float = math.nan) -> dict[str, Any]:
    """What is found of one problem, as JSON data."""
    import pyomo.environ as pyo
    from pyomo.mpec import Complementarity

    from formulations.mpec import certify, solve_mpec
    from formulations.mpec import load as take

    sizes = {
        "variables": len(list(model.component_data_objects(pyo.Var))),
        "rows": len(list(model.component_data_objects(pyo.Constraint, active=True))),
        "pairs": len(list(model.component_data_objects(Complementarity, active=True))),
    }
    began = time.process_time()
    result = solve_mpec(model)
    told: dict[str, Any] = {
        **sizes, "status": result.outcome.name.lower(), "message": result.message,
        "strategy": result.strategy, "sense": result.sense,
        "solve_s": time.process_time() - began,
    }  # fmt: skip
    if result.has_point:
        take(result)
        found = certify(model)
        told |= {
            "objective": sum(pyo.value(item) for item in model.component_data_objects(pyo.Objective,
                active=True)),
            "stationary": "S" if found.strong else "B" if found.b_stationary else "-",
            "b_stationary": found.b_stationary, "feasible": found.feasible,
            "primal": found.primal, "complementarity": found.complementarity, "dual": found.dual,
            "biactive": found.biactive,
        }  # fmt: skip
    best = told["objective"] if told.get("feasible") else math.inf
    bound = (
        None if _away(best, published) == 0.0 else prove(model, best=best, seconds=proof_seconds)
    )
    if bound is not None:
        told |= {"bound": bound.bound, "proved": bound.complete}
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in told.items()
    }


def solve_by_peer(model: Any) -> dict[str, Any]:
    """What CasADi and Ipopt find of one problem, judged by the same certificate, as JSON data."""
    import numpy as np
    import pyomo.environ as pyo

    from benchmarks.mpec.peer import casadi_scholtes, of_pyomo
    from formulations.mpec import certify

    began = time.process_time()
    try:
        program, variables = of_pyomo(model)
        point = casadi_scholtes(program)
    except Exception as error:  # noqa: BLE001 - whatever a peer raises stands in its row
        return {"peer_reason": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}
    seconds = time.process_time() - began
    if not np.all(np.isfinite(point)):
        return {"peer_reason": "the point holds numbers that are not finite"}
    for variable, number in zip(variables, point.tolist(), strict=True):
        variable.set_value(number, skip_validation=True)
    found = certify(model)
    cost = sum(pyo.value(item) for item in model.component_data_objects(pyo.Objective, active=True))
    return {
        "peer_objective": cost if math.isfinite(cost) else None,
        "peer_feasible": found.feasible,
        "peer_s": seconds,
    }


def _published(path: Path) -> dict[str, float]:
    with path.open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))
    found: dict[str, float] = {}
    for row in rows:
        try:
            found[row["name"]] = float(row["published_optimum"])
        except (KeyError, TypeError, ValueError):
            continue  # stated as infeasible, or not yet known
    return found


def _away(objective: float, published: float) -> float:
    """How far an objective is from the published one, relative to max(1, |value|).

    0 where it is reached, NaN where none is published.
    """
    difference = (objective - published) / max(1.0, abs(published))
    return 0.0 if abs(difference) <= REACHED else difference


def _against(row: dict[str, Any], published: float | None) -> str:
    """How an answer stands to the published value; empty where one of the two is not there."""
    if published is None:
        return ""
    if row.get("proved") and row.get("bound") is None and row["status"] == "infeasible":
        return "proved infeasible"
    if row.get("objective") is None or not row.get("feasible"):
        return ""
    difference = row["sense"] * _away(row["objective"], published)
    if difference > 0 and row.get("bound") is not None:
        gap = row["sense"] * (row["objective"] - row["bound"]) / max(1.0, abs(published))
        if gap <= REACHED:
            return "proved optimal: the published value is of other data"
    if difference == 0.0:
        return "reached"
    return "better" if difference < 0 else f"worse by {difference:.2g}"


def _run(
    path: Path, limit: float, proof: float, published: float, peer: int | None, folder: Path
) -> dict[str, Any]:
    told, reason = _child(path, folder, (f"{proof:g}", repr(published)), limit + proof + _BESIDE)
    row = {"problem": path.stem, "status": "no answer", "sense": 1, "message": reason, **told}
    if peer is not None and row.get("pairs", 0) <= peer:
        told, reason = _child(path, folder, (), limit + _BESIDE)
        row |= told or {"peer_reason": reason}
    return row


def _child(
    path: Path, folder: Path, limits: tuple[str, ...], cpu_limit: float
) -> tuple[dict[str, Any], str]:
    """What a child wrote, or nothing and why."""
    target = folder / f"{path.stem}-{len(limits)}.json"
    done = run_child("benchmarks.mpec.sets", str(path), str(target), *limits, cpu_limit=cpu_limit)
    if target.exists():
        return json.loads(target.read_text(encoding="utf-8")), ""
    last = (done.stderr.strip().splitlines() or ["no word"])[-1]
    ended = f"ended with code {done.returncode}: {last[:200]}"
    return {}, f"stopped after {cpu_limit:g} CPU s" if done.returncode == -signal.SIGXCPU else ended


def _line(row: dict[str, Any], published: float | None) -> tuple[str | float | None, ...]:
    return (
        row["problem"], row.get("variables"), row.get("rows"), row.get("pairs"), row["status"],
        row.get("objective"), published,
        _against(row, published), row.get("bound"), row.get("stationary"), row.get("primal"),
        row.get("complementarity"), row.get("dual"), row.get("solve_s"), row.get("strategy"),
        row.get("peer_objective") if row.get("peer_feasible") else row.get("peer_reason",
            "infeasible" if "peer_s" in row else None), row.get("peer_s"),
        "" if row["status"] == "solved" else row["message"][:160],
    )  # fmt: skip


def _page(line: tuple[str | float | None, ...]) -> tuple[str | float | None, ...]:
    """A row of the table in `docs`: objectives in eight digits, the rest in two."""
    row = dict(zip(_COLUMNS, line, strict=True))
    residuals = [row[name] for name in ("primal", "complementarity", "dual")]
    shown = " ".join(f"{value:.0e}" for value in residuals if value is not None)
    ours, its = (
        None if row[name] is None else f"{row[name]:.1f}" for name in ("CPU s", "peer's CPU s")
    )
    first = (row[name] for name in _PAGE[:7])
    return (*first, shown, ours, row["strategy"], row["peer's objective"], its)


def _notes(rows: list[dict[str, Any]], published: dict[str, float]) -> list[str]:
    compared = [row for row in rows if row["problem"] in published]
    verdicts = [_against(row, published[row["problem"]]) for row in compared]
    good = sum(word in ("reached", "better") for word in verdicts)
    proved = sum(word.startswith("proved") for word in verdicts)
    false = [
        row["problem"]
        for row in rows
        if row["status"] == "solved" and not (row.get("feasible") and row.get("b_stationary"))
    ]
    return [
        f"published value reached to {REACHED:g} or beaten: {good} of {len(compared)} ({verdicts.count('better')} beaten); published values that no "
        f"point of the file has, by proof: {proved}",
        f"'solved' without a feasible, B-stationary point by the certificate: {len(false)} {', '.join(false)}".rstrip(),
        f"CPU seconds of all: {sum(row.get('solve_s') or 0.0 for row in rows):.0f}",
    ]


@click.command()
@click.option(
    "--from",
    "folder",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    required=True,
    metavar="DIR",
    help="The `.nl` files.",
)
@click.option(
    "--optima",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="CSV",
    help="Their published optima.",
)
@click.option(
    "--limit",
    type=POSITIVE,
    default=120.0,
    show_default=True,
    metavar="SECONDS",
    help="CPU seconds of one problem.",
)
@click.option(
    "--proof",
    type=FiniteRange(min=0.0),
    default=10.0,
    show_default=True,
    metavar="SECONDS",
    help="CPU seconds of the proof of one global bound.",
)
@click.option(
    "--peer",
    type=click.IntRange(min=0),
    metavar="PAIRS",
    help="CasADi with Ipopt solves problems of at most so many pairs too.",
)
@click.option("-k", "part", default="", metavar="TEXT", help="Only problems whose name holds this.")
@click.option(
    "-j",
    "jobs",
    type=COUNT,
    default=os.cpu_count() or 1,
    show_default=True,
    help="So many at a time.",
)
@written_to("--markdown", "markdown", "FILE.md", "the table of all problems")
@out_option
def command(
    folder: Path, optima: Path | None, limit: float, proof: float, peer: int | None, part: str,
    jobs: int, markdown: Path | None, out: Path,
) -> int:  # fmt: skip
    """Solve the MPECs of a folder of `.nl` files: status, objective, certificate and time of each."""
    paths = [path for path in sorted(folder.glob("*.nl")) if part in path.stem]
    if not paths:
        raise click.UsageError(f"{folder} holds no `.nl` file whose name holds '{part}'.")
    published = _published(optima) if optima is not None else {}
    make_folder(out)
    rows = []
    with temporary_folder("touchstone-sets-") as work, ThreadPoolExecutor(jobs) as pool:
        for row in pool.map(
            lambda path: _run(path, limit, proof, published.get(path.stem, math.nan), peer, work),
            paths,
        ):
            against = _against(row, published.get(row["problem"]))
            told = (row["problem"], row["status"], row.get("objective"), against)
            click.echo("  ".join(map(str, told)))
            rows.append(row)
    lines = tuple(_line(row, published.get(row["problem"])) for row in rows)
    with (out / f"mpec-sets-{folder.name}.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([_COLUMNS, *lines])
    write(markdown, lambda: as_markdown(_PAGE, [_page(line) for line in lines]))
    click.echo("\n".join(_notes(rows, published)))
    return 0


if __name__ == "__main__":
    from formulations.ampl import read_nl

    source, target, *limits = sys.argv[1:]
    model = read_nl(Path(source), relax_integers=True)
    told = solve_one(model, *map(float, limits)) if limits else solve_by_peer(model)
    Path(target).write_text(json.dumps(told), encoding="utf-8")

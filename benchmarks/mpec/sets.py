"""`mpec-sets`: a folder of MPECs, each solved in a child with limits, with what a certificate says of every answer and the best value published.

    python -m benchmarks mpec-sets --from DIR --optima optima.csv

DIR holds `.nl` files, or Python files that define `model` or a function `model()`. The optima are a CSV of `name, .., published_optimum`.
The child's own answer is not believed: rows, bounds, pairs and stationarity are recomputed from the values of the model's variables, and where rows are
linear and the objective is convex a tree of convex programs bounds the global optimum (`benchmarks.mpec.proved`).
"""

from __future__ import annotations

import csv
import importlib.util
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
from benchmarks.records import Table
from benchmarks.results import store_tables
from validate.cli.options import FiniteRange
from validate.store.disk import temporary_folder

# A published value is reached within this, relative to max(1, |value|).
REACHED = 1e-4
# CPU seconds for reading the model and judging the point.
_BESIDE = 30.0
_COLUMNS = ("problem", "variables", "rows", "pairs", "status", "objective", "published", "against it", "bound", "class", "primal", "complementarity", "dual",
            "CPU s", "remark")  # fmt: skip


def load(path: Path) -> Any:
    """The Pyomo model of a file. Raises NlError, ImportError, or whatever the file raises."""
    if path.suffix == ".nl":
        from formulations.ampl import read_nl

        return read_nl(path, relax_integers=True)
    spec = importlib.util.spec_from_file_location(path.stem.replace("-", "_"), path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found = getattr(module, "model", None)
    return found() if callable(found) and not hasattr(found, "component_data_objects") else found


def solve_one(path: Path, limit: float, proof_seconds: float) -> dict[str, Any]:
    """What is found of one problem, as JSON data."""
    import pyomo.environ as pyo
    from pyomo.mpec import Complementarity

    from formulations.mpec import certify, solve_mpec
    from formulations.mpec import load as take

    model = load(path)
    sizes = {
        "variables": len(list(model.component_data_objects(pyo.Var))),
        "rows": len(list(model.component_data_objects(pyo.Constraint, active=True))),
        "pairs": len(list(model.component_data_objects(Complementarity, active=True))),
    }
    began = time.process_time()
    result = solve_mpec(model, time_limit=limit)
    told: dict[str, Any] = {
        **sizes, "status": result.outcome.name.lower(), "message": result.message, "strategy": result.strategy, "sense": result.sense,
        "solve_s": time.process_time() - began,
    }  # fmt: skip
    if result.has_point:
        take(result)
        found = certify(model)
        told |= {
            "objective": sum(pyo.value(item) for item in model.component_data_objects(pyo.Objective, active=True)), "class": found.stationarity.letter, "b_stationary": found.b_stationary, "feasible": found.feasible,
            "primal": found.primal, "complementarity": found.complementarity, "dual": found.dual, "biactive": found.biactive,
        }  # fmt: skip
    bound = prove(model, best=told["objective"] if told.get("feasible") else math.inf, seconds=proof_seconds)
    if bound is not None:
        told |= {"bound": bound.bound, "proved": bound.complete}
    return {name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in told.items()}


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


def _against(row: dict[str, Any], published: float | None) -> str:
    """How an answer stands to the published value; empty where one of the two is not there."""
    if published is None:
        return ""
    if row.get("proved") and row.get("bound") is None and row["status"] == "infeasible":
        return "proved infeasible"
    if row.get("objective") is None or not row.get("feasible"):
        return ""
    difference = row["sense"] * (row["objective"] - published) / max(1.0, abs(published))
    if difference > REACHED and row.get("bound") is not None:
        gap = row["sense"] * (row["objective"] - row["bound"]) / max(1.0, abs(published))
        if gap <= REACHED:
            return "proved optimal: the published value is of other data"
    if abs(difference) <= REACHED:
        return "reached"
    return "better" if difference < 0 else f"worse by {difference:.2g}"


def _run(path: Path, limit: float, proof: float, folder: Path) -> dict[str, Any]:
    target = folder / f"{path.stem}.json"
    done = run_child("benchmarks.mpec.sets", str(path), str(target), f"{limit:g}", f"{proof:g}", cpu_limit=limit + proof + _BESIDE)
    if target.exists():
        return {"problem": path.stem, **json.loads(target.read_text(encoding="utf-8"))}
    last = (done.stderr.strip().splitlines() or ["no word"])[-1]
    reason = (
        f"stopped after {limit + 20:g} CPU s" if done.returncode == -signal.SIGXCPU else f"ended with code {done.returncode}: {last[:200]}"
    )
    return {"problem": path.stem, "status": "no answer", "message": reason}


def _line(row: dict[str, Any], published: float | None) -> tuple[str | float | None, ...]:
    return (
        row["problem"], row.get("variables"), row.get("rows"), row.get("pairs"), row["status"], row.get("objective"), published,
        _against(row, published), row.get("bound"), row.get("class"), row.get("primal"), row.get("complementarity"), row.get("dual"), row.get("solve_s"),
        "" if row["status"] == "solved" else row["message"][:160],
    )  # fmt: skip


def _notes(rows: list[dict[str, Any]], published: dict[str, float]) -> list[str]:
    compared = [row for row in rows if row["problem"] in published]
    verdicts = [_against(row, published[row["problem"]]) for row in compared]
    good = sum(word in ("reached", "better") for word in verdicts)
    proved = sum(word.startswith("proved") for word in verdicts)
    false = [row["problem"] for row in rows if row["status"] == "solved" and not (row.get("feasible") and row.get("b_stationary"))]
    return [
        f"published value reached to {REACHED:g} or beaten: {good} of {len(compared)} ({verdicts.count('better')} beaten); published values that no "
        f"point of the file has, by proof: {proved}",
        f"'solved' without a feasible, B-stationary point by the certificate: {len(false)} {', '.join(false)}".rstrip(),
        f"CPU seconds of all: {sum(row.get('solve_s') or 0.0 for row in rows):.0f}",
    ]


@click.command()
@click.option(
    "--from", "folder", type=click.Path(path_type=Path, exists=True, file_okay=False), required=True, metavar="DIR", help="The problems."
)
@click.option("--optima", type=click.Path(path_type=Path, exists=True, dir_okay=False), metavar="CSV", help="Their published optima.")
@click.option("--limit", type=POSITIVE, default=120.0, show_default=True, metavar="SECONDS", help="Of one problem.")
@click.option(
    "--proof", type=FiniteRange(min=0.0), default=10.0, show_default=True, metavar="SECONDS", help="Of the proof of one global bound."
)
@click.option("-k", "part", default="", metavar="TEXT", help="Only problems whose name holds this.")
@click.option("-j", "jobs", type=COUNT, default=os.cpu_count() or 1, show_default=True, help="So many at a time.")
@out_option
def command(folder: Path, optima: Path | None, limit: float, proof: float, part: str, jobs: int, out: Path) -> int:
    """A folder of MPECs (`.nl`, or Pyomo models in Python files): status, objective, certificate and time of each."""
    files = sorted(path for path in folder.iterdir() if path.suffix in (".nl", ".py") and part in path.stem)
    if not files:
        raise click.UsageError(f"{folder} holds no .nl or .py file whose name holds '{part}'.")
    published = _published(optima) if optima is not None else {}
    with temporary_folder("touchstone-sets-") as work, ThreadPoolExecutor(jobs) as pool:
        rows = []
        for row in pool.map(lambda path: _run(path, limit, proof, work), files):
            click.echo(
                "  ".join(
                    str(word)
                    for word in (row["problem"], row["status"], row.get("objective"), _against(row, published.get(row["problem"])))
                )
            )
            rows.append(row)
    table = Table(
        caption=f"{len(rows)} problems of {folder.name}.",
        columns=_COLUMNS,
        rows=tuple(_line(row, published.get(row["problem"])) for row in rows),
        notes=tuple(_notes(rows, published)),
    )
    store_tables(out, f"mpec-sets-{folder.name}", f"MPECs of {folder.name}", (__doc__ or "").split("\n\n")[0], [table], rows, quiet=True)
    with (out / f"mpec-sets-{folder.name}.csv").open("w", encoding="utf-8", newline="") as lines:
        csv.writer(lines).writerows([_COLUMNS, *table.rows])
    click.echo("\n".join(table.notes))
    return 0


if __name__ == "__main__":
    told = solve_one(Path(sys.argv[1]), float(sys.argv[3]), float(sys.argv[4]))
    Path(sys.argv[2]).write_text(json.dumps(told), encoding="utf-8")

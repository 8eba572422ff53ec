"""`mpec-sets`: a folder of MPECs, each solved in a child with limits, with what a certificate says of every answer and the best value published.

    python -m benchmarks mpec-sets --from DIR --optima optima.csv

DIR holds `.nl` files, or Python files that define `model` or a function `model()`. The optima are a
CSV of `name, .., published_optimum`. Where models are abstract, `--problems` is a CSV of `name,
model, data`: which file with which data is which problem. With `--peer N`, CasADi and Ipopt are
given each problem of at most N pairs too (Scholtes, `benchmarks.mpec.peer`), and a performance
profile stands beside the table. The child's own answer is not believed: rows, bounds, pairs and
stationarity are recomputed from the values of the model's variables, and where rows are linear and
the objective is convex a tree of convex programs bounds the global optimum
(`benchmarks.mpec.proved`), unless the published value is reached. A `.nl` file is solved by the
command `touchstone-mpec` too, as AMPL calls it, and what its `.sol` says, read by Pyomo, is held
against that answer.
"""

from __future__ import annotations

import csv
import importlib.util
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from benchmarks.measure import run_child
from benchmarks.mpec.proved import prove
from benchmarks.options import COUNT, POSITIVE, out_option
from benchmarks.records import Table
from benchmarks.results import as_markdown, store_tables
from validate.cli.options import FiniteRange, write, written_to
from validate.store.disk import temporary_folder

# A published value is reached within this, relative to max(1, |value|).
REACHED = 1e-4
# CPU seconds for reading the model and judging the point.
_BESIDE = 30.0
_COLUMNS = ("problem", "variables", "rows", "pairs", "status", "objective", "published",
            "against it", "bound", "class", "primal", "complementarity", "dual",
            "CPU s", "strategy", "peer's objective", "peer's CPU s", "command", "remark")  # fmt: skip
_PAGE = ("problem", "pairs", "status", "objective", "published", "against it", "class",
         "primal, complementarity, dual", "CPU s", "by",
         "CasADi + Ipopt", "its CPU s")  # fmt: skip
# Times of the faster one at which a performance profile is told.
_TIMES = (1.0, 2.0, 4.0, 8.0, 16.0, math.inf)


def load(path: Path, data: Path | None = None) -> Any:
    """The Pyomo model of a file, and of its data where it is abstract.

    Raises NlError, ImportError, or whatever the file raises.
    """
    if path.suffix == ".nl":
        from formulations.ampl import read_nl

        return read_nl(path, relax_integers=True)
    spec = importlib.util.spec_from_file_location(path.stem.replace("-", "_"), path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: Any = getattr(module, "model", None)
    if not hasattr(found, "component_data_objects"):
        return found() if callable(found) else found
    return (
        found
        if data is None and found.is_constructed()
        else found.create_instance(None if data is None else str(data))
    )


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
                active=True)), "class": found.stationarity.letter,
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


# Of AMPL's codes, those of each status from so many to ninety-nine more.
_CODES = {
    "solved": 0,
    "stalled": 100,
    "infeasible": 200,
    "diverged": 300,
    "iteration_limit": 400,
    "time_limit": 400,
}


def by_command(path: Path, model: Any, status: str, has_point: bool, folder: Path) -> str:
    """Whether `touchstone-mpec STUB -AMPL` says the same of a `.nl` file, to the last bit of every variable; else by how much it differs.

    model: of that file, with the values of the answer that is compared, if there is one.
    """
    import pyomo.environ as pyo
    from pyomo.opt.plugins.sol import ResultsReader_sol

    stub = str(folder / f"{path.stem}-command")
    shutil.copy(path, f"{stub}.nl")
    command = [
        str(Path(sys.executable).with_name("touchstone-mpec")),
        stub,
        "-AMPL",
        "relax_integers=1",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return (
            f"code {done.returncode}: {(done.stderr.strip().splitlines() or ['no word'])[-1][:160]}"
        )
    answer = ResultsReader_sol()(f"{stub}.sol", suffixes=[])
    if int(answer.solver.id) // 100 * 100 != _CODES.get(status, 500):
        return f"AMPL's code {answer.solver.id}"
    found = (
        [entry["Value"] for entry in answer.solution(0).variable.values()]
        if len(answer.solution)
        else []
    )
    values = (
        [pyo.value(item) for item in model.component_data_objects(pyo.Var)] if has_point else []
    )
    if len(found) != len(values):
        return f"{len(found)} of {len(values)} values"
    return (
        "equal"
        if found == values
        else f"{max(abs(a - b) for a, b in zip(found, values, strict=True)):.1e} away"
    )


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


def _profile(rows: list[dict[str, Any]]) -> Table:
    """Share of the problems on which a solver has the better answer (to REACHED) within so many times the CPU seconds of the faster that has it."""
    times: dict[str, list[float]] = {"mpec_ipopt": [], "casadi_scholtes": []}
    for row in rows:
        if "peer_s" not in row and "peer_reason" not in row:
            continue
        answers = {
            "mpec_ipopt": (
                row.get("objective") if row["status"] == "solved" else None,
                row.get("solve_s"),
            ),
            "casadi_scholtes": (
                row.get("peer_objective") if row.get("peer_feasible") else None,
                row.get("peer_s"),
            ),
        }
        costs = [row["sense"] * cost for cost, _ in answers.values() if cost is not None]
        if not costs:
            continue
        good: dict[str, float] = {
            name: float(seconds or 0.0)
            for name, (cost, seconds) in answers.items()
            if cost is not None
            and row["sense"] * cost <= min(costs) + REACHED * max(1.0, abs(min(costs)))
        }
        for name, known in times.items():
            known.append(good[name] / min(good.values()) if name in good else math.inf)
    lines = [
        (
            name,
            *(
                f"{sum(ratio <= most and math.isfinite(ratio) for ratio in ratios) / len(ratios):.0%}"
                for most in _TIMES
            ),
        )
        for name, ratios in times.items()
        if ratios
    ]
    columns = (
        "solver",
        *(f"within {most:g} times" if math.isfinite(most) else "at all" for most in _TIMES),
    )
    return Table(
        caption=f"Performance profile of {len(times['mpec_ipopt'])} problems.",
        columns=columns,
        rows=tuple(lines),
    )


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


@dataclass(frozen=True)
class Problem:
    """name; path of its model; path of the data of an abstract model."""

    name: str
    path: Path
    data: Path | None = None


def _problems(folder: Path, listed: Path | None) -> list[Problem]:
    """Those of a list, else each file of the folder."""
    if listed is None:
        return [
            Problem(path.stem, path)
            for path in sorted(folder.iterdir())
            if path.suffix in (".nl", ".py")
        ]
    with listed.open(encoding="utf-8", newline="") as lines:
        rows = [
            {name: (value or "").strip() for name, value in row.items() if name}
            for row in csv.DictReader(lines)
        ]
    if not rows or not all(row.get("name") and row.get("model") for row in rows):
        raise click.UsageError(
            f"{listed} is no list of problems: it has the columns name, model, data, and a name and a model in every row."
        )
    files = {
        name
        for row in rows
        for name in (row["model"], row.get("data", ""))
        if name and not (folder / name).is_file()
    }
    if files:
        raise click.UsageError(
            f"{listed} names files that {folder} does not hold: {', '.join(sorted(files)[:5])}."
        )
    return [
        Problem(
            row["name"], folder / row["model"], folder / row["data"] if row.get("data") else None
        )
        for row in rows
    ]


def _run(
    problem: Problem, limit: float, proof: float, published: float, peer: int | None, folder: Path
) -> dict[str, Any]:
    told, reason = _child(problem, folder, (f"{proof:g}", repr(published)), limit + proof + _BESIDE)
    row = (
        {"problem": problem.name, **told}
        if told
        else {"problem": problem.name, "status": "no answer", "sense": 1, "message": reason}
    )
    if peer is not None and row.get("pairs", 0) <= peer:
        told, reason = _child(problem, folder, (), limit + _BESIDE)
        row |= told or {"peer_reason": reason}
    return row


def _child(
    problem: Problem, folder: Path, limits: tuple[str, ...], cpu_limit: float
) -> tuple[dict[str, Any], str]:
    """What a child wrote, or nothing and why."""
    target, data = (
        folder / f"{problem.name}-{len(limits)}.json",
        "" if problem.data is None else str(problem.data),
    )
    done = run_child(
        "benchmarks.mpec.sets", str(problem.path), data, str(target), *limits, cpu_limit=cpu_limit
    )
    if target.exists():
        return json.loads(target.read_text(encoding="utf-8")), ""
    last = (done.stderr.strip().splitlines() or ["no word"])[-1]
    ended = f"ended with code {done.returncode}: {last[:200]}"
    return {}, f"stopped after {cpu_limit:g} CPU s" if done.returncode == -signal.SIGXCPU else ended


def _line(row: dict[str, Any], published: float | None) -> tuple[str | float | None, ...]:
    return (
        row["problem"], row.get("variables"), row.get("rows"), row.get("pairs"), row["status"],
        row.get("objective"), published,
        _against(row, published), row.get("bound"), row.get("class"), row.get("primal"),
        row.get("complementarity"), row.get("dual"), row.get("solve_s"), row.get("strategy"),
        row.get("peer_objective") if row.get("peer_feasible") else row.get("peer_reason",
            "infeasible" if "peer_s" in row else None), row.get("peer_s"), row.get("command"),
        "" if row["status"] == "solved" else row["message"][:160],
    )  # fmt: skip


def _page(told: Table) -> Table:
    """What `docs` has of the table: objectives in eight digits, the rest in two."""
    lines = []
    for row in (dict(zip(told.columns, line, strict=True)) for line in told.rows):
        residuals = " ".join(
            f"{row[name]:.0e}"
            for name in ("primal", "complementarity", "dual")
            if row[name] is not None
        )
        seconds = (
            None if row[name] is None else f"{row[name]:.1f}" for name in ("CPU s", "peer's CPU s")
        )
        lines.append(
            (
                *(row[name] for name in _PAGE[:7]),
                residuals,
                next(seconds),
                row["strategy"],
                row["peer's objective"],
                next(seconds),
            )
        )
    return Table(caption=told.caption, columns=_PAGE, rows=tuple(lines))


def _notes(rows: list[dict[str, Any]], published: dict[str, float]) -> list[str]:
    compared = [row for row in rows if row["problem"] in published]
    verdicts = [_against(row, published[row["problem"]]) for row in compared]
    good = sum(word in ("reached", "better") for word in verdicts)
    proved = sum(word.startswith("proved") for word in verdicts)
    asked = [row for row in rows if "command" in row]
    same = [
        f"the command touchstone-mpec gives the same status and every variable to the last bit: {sum(row['command'] == 'equal' for row in asked)} of {len(asked)}"
    ]
    false = [
        row["problem"]
        for row in rows
        if row["status"] == "solved" and not (row.get("feasible") and row.get("b_stationary"))
    ]
    return [
        f"published value reached to {REACHED:g} or beaten: {good} of {len(compared)} ({verdicts.count('better')} beaten); published values that no "
        f"point of the file has, by proof: {proved}",
        f"'solved' without a feasible, B-stationary point by the certificate: {len(false)} {', '.join(false)}".rstrip(),
        *(same if asked else ()),
        f"CPU seconds of all: {sum(row.get('solve_s') or 0.0 for row in rows):.0f}",
    ]


def _tell(
    out: Path,
    name: str,
    rows: list[dict[str, Any]],
    published: dict[str, float],
    markdown: Path | None,
) -> None:
    """The record, the CSV and the page of all rows."""
    lines = tuple(_line(row, published.get(row["problem"])) for row in rows)
    table = Table(
        caption=f"{len(rows)} problems.",
        columns=_COLUMNS,
        rows=lines,
        notes=tuple(_notes(rows, published)),
    )
    tables = (
        [table, _profile(rows)]
        if any("peer_s" in row or "peer_reason" in row for row in rows)
        else [table]
    )
    store_tables(
        out, name, f"MPECs: {name}", (__doc__ or "").split("\n\n")[0], tables, rows, quiet=True
    )
    with (out / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([_COLUMNS, *lines])
    write(markdown, lambda: "\n".join(as_markdown(told) for told in (_page(table), *tables[1:])))
    click.echo("\n".join(table.notes))


@click.command()
@click.option(
    "--from",
    "folder",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    required=True,
    metavar="DIR",
    help="The problems.",
)
@click.option(
    "--optima",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="CSV",
    help="Their published optima.",
)
@click.option(
    "--problems",
    "listed",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="CSV",
    help="Which model with which data.",
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
    help="Of the proof of one global bound.",
)
@click.option(
    "--peer",
    type=click.IntRange(min=0),
    metavar="PAIRS",
    help="CasADi with Ipopt beside ours, with up to so many pairs.",
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
@written_to("--markdown", "markdown", "FILE.md", "the tables, as docs/mpec_sets.md has them")
@out_option
def command(
    folder: Path, optima: Path | None, listed: Path | None, limit: float, proof: float,
    peer: int | None, part: str, jobs: int, markdown: Path | None,
    out: Path,
) -> int:  # fmt: skip
    """A folder of MPECs (`.nl`, or Pyomo models in Python files): status, objective, certificate and time of each."""
    problems = [problem for problem in _problems(folder, listed) if part in problem.name]
    if not problems:
        raise click.UsageError(
            f"{folder if listed is None else listed} holds no problem whose name holds '{part}'."
        )
    published = _published(optima) if optima is not None else {}
    with temporary_folder("touchstone-sets-") as work, ThreadPoolExecutor(jobs) as pool:
        rows = []
        for row in pool.map(
            lambda p: _run(p, limit, proof, published.get(p.name, math.nan), peer, work), problems
        ):
            told = (
                row["problem"],
                row["status"],
                row.get("objective"),
                _against(row, published.get(row["problem"])),
            )
            click.echo("  ".join(map(str, told)))
            rows.append(row)
    _tell(out, f"mpec-sets-{folder.name}", rows, published, markdown)
    return 0


if __name__ == "__main__":
    source, data, target, *limits = sys.argv[1:]
    given = load(Path(source), Path(data) if data else None)
    told = solve_one(given, *map(float, limits)) if limits else solve_by_peer(given)
    if limits and Path(source).suffix == ".nl":
        told["command"] = by_command(
            Path(source), given, told["status"], "objective" in told, Path(target).parent
        )
    Path(target).write_text(json.dumps(told), encoding="utf-8")

"""`python -m benchmarks field`: solve a published problem again, judge its plans, plan beside them.

1. Solve each instance as published and corrected, in CasADi with Ipopt; compare the published cost.
2. Judge all plans by a campaign: own time step, own equations, physics.
3. Plan some of the instances with our pipelines, by a second campaign.
4. Write table.csv.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import csv
import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.options import COUNT, FOLDER
from models.errors import TouchstoneError
from validate.campaign.campaign import run_campaign
from validate.campaign.read import read_campaign
from validate.campaign.results import table_text
from validate.cli.narrator import narrator
from validate.cli.table import say
from validate.processes.disk import write_durably

HOME = Path(__file__).parent
PROBLEMS = tuple(sorted(path.parent.name for path in HOME.glob("*/problem.py")))
FORMS = ("published", "corrected")
# A problem that is typed again is the published one if its cost is the published cost to this share.
IDENTITY = 1e-6
# Instances that our pipelines plan: the first ten and ten more.
PLANNED = (*range(10), *range(50, 60))
PIPELINES = ("softplus_dc+strict", "best_exact")
_CAMPAIGN = """title = "{title}"
time_limit = 600
{pipelines}
"""
_PLANS = """
[[plans]]
name = "{name}"
scene = "{home}/scene.py"
instances = "{instances}"
"""
_OF_FORM = """plans = "{form}/{{name}}.csv"
time_step = "{home}/steps.py:{form}"
"""


@click.command()
@click.argument("problem", type=click.Choice(PROBLEMS))
@click.option("--instances", "most", type=COUNT, help="Only the first N.  [default: all]")
@click.option("--planned/--no-planned", default=True, help="Run our pipelines too.")
@click.option(
    "--pipeline",
    "pipelines",
    multiple=True,
    type=click.Choice(PIPELINES),
    default=PIPELINES,
    help="Of our pipelines only this one; may be repeated.",
)
@click.option("-j", "--jobs", type=COUNT, help="Runs at a time.  [default: the number of cores]")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of plans, campaigns and table.csv.  [default: runs/benchmarks/PROBLEM]",
)
def command(
    problem: str,
    most: int | None,
    planned: bool,
    pipelines: tuple[str, ...],
    jobs: int | None,
    out: Path | None,
) -> int:
    """Rebuild the table of a published problem from its parameters."""
    out = FOLDER / problem if out is None else out
    published = _read(HOME / problem / "published.csv")[:most]
    solved = _solved(problem, published, out)
    _write_instances(out / "instances.csv", problem, published)
    judged = _run(out, "judged", _judged_text(problem), jobs)
    ours: list[dict[str, str]] = []
    if planned:
        chosen = [published[place] for place in PLANNED if place < len(published)]
        _write_instances(out / "planned.csv", problem, chosen)
        ours = _run(out, "planned", _planned_text(problem, pipelines), jobs)
    rows = _table(published, solved, judged, ours)
    write_durably(out / "table.csv", table_text(list(rows[0]), rows))
    for line in _summary(rows):
        say(line)
    say(f"table:   {out / 'table.csv'}")
    return 0 if all(row["identity"] for row in rows) else 1


def _read(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _parameters(problem: str) -> tuple[str, ...]:
    return importlib.import_module(f"benchmarks.field.{problem}.problem").PARAMETERS


def _write_instances(path: Path, problem: str, published: Sequence[Mapping[str, str]]) -> None:
    names = ("name", *_parameters(problem))
    rows = [{name: row[name] for name in names} for row in published]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_durably(path, table_text(names, rows))


def _solved(
    problem: str, published: Sequence[Mapping[str, str]], out: Path
) -> dict[tuple[str, str], dict[str, Any]]:
    """Solve each instance in each form, unless an earlier call did; write the plans."""
    module = importlib.import_module(f"benchmarks.field.{problem}.problem")
    figures = out / "solved.csv"
    known = {(row["name"], row["form"]): row for row in _read(figures)} if figures.exists() else {}
    for row in published:
        for form in FORMS:
            key = (row["name"], form)
            plan = out / form / f"{row['name']}.csv"
            if key in known and plan.exists():
                continue
            numbers = {name: float(row[name]) for name in _parameters(problem)}
            found = module.solve(numbers, module.Form(form))
            if not found.success:
                raise TouchstoneError(f"{row['name']}, {form}: Ipopt ended with {found.status}.")
            plan.parent.mkdir(parents=True, exist_ok=True)
            rows = zip(*(map(float, values) for values in found.columns.values()), strict=True)
            columns = list(found.columns)
            write_durably(
                plan, table_text(columns, [dict(zip(columns, line, strict=True)) for line in rows])
            )
            known[key] = {
                "name": row["name"],
                "form": form,
                "cost": found.cost,
                "iterations": found.iterations,
                "cpu_s": found.seconds,
            }
            write_durably(figures, table_text(list(known[key]), known.values()))
    return known


def _judged_text(problem: str) -> str:
    home = HOME / problem
    text = _CAMPAIGN.format(title=f"{problem}: published and corrected", pipelines="")
    for form in FORMS:
        text += _PLANS.format(name=form, home=home, instances="instances.csv")
        text += _OF_FORM.format(form=form, home=home)
        if form == "published":
            text += f'model = "{home}/own_equations.py"\n'
    return text


def _planned_text(problem: str, pipelines: Sequence[str]) -> str:
    names = ", ".join(f'"{name}"' for name in pipelines)
    text = _CAMPAIGN.format(title=f"{problem}: our plans", pipelines=f"pipelines = [{names}]")
    return text + _PLANS.format(name="plan", home=HOME / problem, instances="planned.csv")


def _run(out: Path, name: str, text: str, jobs: int | None) -> list[dict[str, str]]:
    """Run a campaign; return the rows of its results.csv, and of its plans.csv beside them."""
    file = out / f"{name}.toml"
    write_durably(file, text)
    settings = read_campaign(file, out=out / name, jobs=jobs, worlds=False)
    run_campaign(settings, narrator())
    table = "plans.csv" if name == "judged" else "results.csv"
    return _read(out / name / table)


def _table(
    published: Sequence[Mapping[str, str]],
    solved: Mapping[tuple[str, str], Mapping[str, Any]],
    judged: Sequence[Mapping[str, str]],
    ours: Sequence[Mapping[str, str]],
) -> list[dict[str, Any]]:
    answers = {(row["instance"], row["plan"]): row for row in judged}
    rows = []
    for row in published:
        name = row["name"]
        again, right = (solved[name, form] for form in FORMS)
        cost, reference = float(again["cost"]), float(row["ipopt_cost"])
        own, physics = answers[name, "published"], answers[name, "corrected"]
        found: dict[str, Any] = {
            "instance": name,
            "published_cost": row["ipopt_cost"],
            "cost": again["cost"],
            "relative_difference": f"{abs(cost - reference) / reference:.1e}",
            "identity": abs(cost - reference) <= IDENTITY * reference,
            "own_time_step": own["own_time_step"],
            "own_equations": own["own_equations"],
            "physics": own["physics"],
            "meaning": own["meaning"],
            "off_own_equations": own["own_replay_error"],
            "off_physics": own["replay_error"],
            "corrected_cost": right["cost"],
            "corrected_own_time_step": physics["own_time_step"],
            "corrected_physics": physics["physics"],
            "corrected_meaning": physics["meaning"],
            "off_corrected": physics["replay_error"],
            "casadi_cpu_s": f"{float(right['cpu_s']):.3g}",
        }
        for pipeline in PIPELINES:
            stages = [
                item for item in ours if (item["scene"], item["pipeline"]) == (name, pipeline)
            ]
            spent = sum(float(item["stage_cpu_s"] or 0.0) for item in stages)
            last = stages[-1] if stages else {}
            price = last.get("cost", "")
            found |= {
                f"{pipeline}_outcome": last.get("outcome", ""),
                f"{pipeline}_verdict": last.get("verdict", ""),
                f"{pipeline}_cost_ratio": f"{float(price) / float(right['cost']):.4g}"
                if price
                else "",
                f"{pipeline}_cpu_ratio": f"{spent / float(right['cpu_s']):.3g}" if stages else "",
            }
        rows.append(found)
    return rows


def _summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    def counted(column: str) -> str:
        values = [row[column] for row in rows if row[column] != ""]
        return ", ".join(f"{values.count(value)} {value}" for value in dict.fromkeys(values))

    def spread(column: str) -> str:
        values = sorted(float(row[column]) for row in rows if row[column] != "")
        if not values:
            return "none"
        return f"median {values[len(values) // 2]:.3g}, largest {values[-1]:.3g}"

    lines = [
        f"identity with the published cost: {sum(row['identity'] for row in rows)} of {len(rows)}; "
        f"relative difference {spread('relative_difference')}",
        f"published: own time step {counted('own_time_step')}; own equations {counted('own_equations')}; physics {counted('physics')}",
        f"corrected: own time step {counted('corrected_own_time_step')}; physics {counted('corrected_physics')}",
    ]
    for pipeline in PIPELINES:
        if outcomes := counted(f"{pipeline}_outcome"):
            lines.append(
                f"{pipeline}: {outcomes}; {counted(f'{pipeline}_verdict')}; cost ratio {spread(f'{pipeline}_cost_ratio')}; CPU ratio {spread(f'{pipeline}_cpu_ratio')}"
            )
    return lines

"""`truth`: the contact truth suite: every problem with every engine at four steps.

    found = measure(("fmu", "mujoco"), jobs=2, tell=print)
    found[0].problem, found[0].engine, found[0].levels[-1].error, found[0].order

The suite measures error, order, energy and time. Only times differ between two runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path

import click
import numpy as np

from models.dynamics import derive
from models.results.check import ChartRecord
from models.results.engines import LevelRecord, TruthRecord, TruthRow
from models.results.stored import to_json
from models.scene import Scene
from reports.pages.simulators import as_markdown, cell, truth_page
from validate.campaign.results import table_text
from validate.cli.options import write, written_to
from validate.cli.table import print_table, say, wide_option
from validate.judge.engines.simulator import (
    REFERENCE,
    Came,
    Drive,
    EngineAnswer,
    SimulatedMotion,
    Simulator,
    describe_engine,
    engine_names,
    named_engines,
    run_engine,
)
from validate.processes.process import usable_cores
from validate.store.provenance import command_line, installed
from validate.stress.case import chart
from validate.truth.problems import TruthProblem, problems

# Columns of the CSV that come from the row of a problem and an engine.
_OF_ROWS = ("phenomenon", "problem", "engine", "came", "worst", "order", "why")
_OF_LEVELS = ("step", "tolerance", "error", "energy", "microseconds", "seconds")
# Problems whose error is drawn against CPU time, by phenomenon: one with a closed form of each kind
# of contact.
_DRAWN = ("rebound", "two-body collision", "grazing contact", "stick-slip")
# Largest error of the reference against every answer [-]. The error that its tolerance leaves after
# 1000 bounces is a hundredth of this.
NEAR = 1e-7
# Errors below this share are rounding, and have no order.
_ROUNDING = 1e-11


@click.command(
    epilog="""\b
Examples:
  python -m validate truth
  python -m validate truth --engine fmu,mujoco --out runs/truth

Exit codes: 0 our reference is right to 1e-7 on every problem; 1 it is not; 2 a
mistake; 3 a named engine is not installed, or a system requirement is missing.
"""
)
@click.option(
    "--engine",
    "engines",
    metavar="NAME,..",
    help="Compare only these engines.  [default: all]",
)
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="Solve N problems at a time.  [default: the number of cores]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write truth.html, truth.csv and truth.json to this folder.",
)
@written_to("--markdown", "markdown", "FILE.md", "the table of errors (docs/truth.md)")
@wide_option
@click.pass_obj
def command(
    arguments: tuple[str, ...],
    engines: str | None,
    jobs: int | None,
    out: Path | None,
    markdown: Path | None,
) -> int:
    """Compare our FMU and other simulators with exact answers of contact problems.

    The phenomena, from a rebound to stick-slip, are simulated at four steps: error, order, energy
    and time. docs/engines.md describes the input of each engine.
    """
    asked = named_engines(engines) if engines else engine_names()
    found = measure(
        asked, jobs=jobs or usable_cores(), tell=lambda text: click.echo(text, err=True)
    )
    record = recorded(asked, found)
    if out is not None:
        write(out / "truth.html", lambda: truth_page(record, command_line(arguments)))
        write(out / "truth.csv", lambda: as_csv(record))
        write(out / "truth.json", lambda: to_json(record, 1))
    write(markdown, lambda: as_markdown(record, command_line(arguments)))
    shown = [[f"{of[0].phenomenon}: {of[0].problem}", *map(cell, of)] for of in record.problems]
    print_table(["problem", *asked], shown, tuple(asked))
    click.echo()
    say(record.summary)
    return 0 if reference_is_right(record.rows) else 1


def reference_is_right(rows: Sequence[TruthRow]) -> bool:
    """Return whether the reference, if it was run, is within NEAR of every answer."""
    return all(
        row.error is not None and row.error <= NEAR for row in rows if row.engine == REFERENCE
    )


def recorded(engines: tuple[str, ...], rows: Sequence[TruthRow]) -> TruthRecord:
    """Return the record that is written."""
    about = {name: describe_engine(name) for name in engines}
    versions = {
        name: installed(item.package, "") if item.package else "" for name, item in about.items()
    }
    told = {
        name: f"{item.title} {versions[name]}".rstrip() + f"; {item.law}"
        for name, item in about.items()
    }
    summary = f"{len({row.phenomenon for row in rows})} phenomena in {len(rows) // len(engines)} problems, by {', '.join(engines)}."
    own = [row.error for row in rows if row.engine == REFERENCE and row.error is not None]
    if own:
        summary += (
            f" Our reference is within {max(own):.1g} of every answer ({NEAR:g} is asked of it)."
        )
    charts = tuple(chart for name in _DRAWN if (chart := _chart(name, rows)) is not None)
    return TruthRecord(engines=told, rows=tuple(rows), summary=summary, charts=charts)


def _chart(phenomenon: str, rows: Sequence[TruthRow]) -> ChartRecord | None:
    """Return the chart of error against CPU time of a phenomenon's first problem.

    Each engine has a curve.
    """
    of = [row for row in rows if row.phenomenon == phenomenon]
    drawn = {
        row.engine: (
            [level.seconds for level in row.levels],
            [math.nan if level.error is None else level.error for level in row.levels],
        )
        for row in of
        if row.problem == of[0].problem and row.levels
    }
    if not drawn:
        return None
    words = "Down and to the left is better: less error for less time. Each curve is one engine at four steps or tolerances."
    return chart(
        f"{phenomenon}, {of[0].problem}",
        ("CPU time", "s"),
        ("error", ""),
        drawn,
        log="xy",
        words=words,
    )


def as_csv(record: TruthRecord) -> str:
    """Return CSV of all measurements, one row a level.

    Times are the last columns, because nothing else differs between two runs.
    """
    content = [
        {name: getattr(row, name) for name in _OF_ROWS}
        | {name: getattr(level, name, None) for name in _OF_LEVELS}
        for row in record.rows
        for level in row.levels or (None,)
    ]
    return table_text((*_OF_ROWS, *_OF_LEVELS), content)


def measure(
    engines: Sequence[str], *, jobs: int = 1, tell: Callable[[str], None] = lambda text: None
) -> list[TruthRow]:
    """Run all problems with these engines, the longest first, `jobs` at a time.

    Each run has a child process. Raises UnknownNameError for an unknown engine, MachineError
    without a compiler or space.
    """
    asked = list(product(problems(), engines))
    ends = {problem.name: problem.end() for problem in dict(asked)}

    def one(item: tuple[TruthProblem, str]) -> TruthRow:
        problem, engine = item
        row = judged(
            problem,
            engine,
            run_engine(engine, drives(problem, describe_engine(engine))),
            ends[problem.name],
        )
        tell(f"{problem.phenomenon}, {problem.name}: {engine}: {cell(row)}")
        return row

    order = sorted(asked, key=lambda item: -item[0].nodes * item[0].parts[-1])
    with ThreadPoolExecutor(max_workers=jobs) as pool:
        rows = dict(zip(order, pool.map(one, order), strict=True))
    return [rows[item] for item in asked]


def drives(problem: TruthProblem, about: Simulator) -> list[Drive]:
    """Return the drives of the four levels of a problem."""
    start, tolerances = (
        np.array(problem.scene.task.start, dtype=float),
        about.tolerances or (1.0,) * len(problem.parts),
    )
    levels = zip(problem.parts, tolerances, strict=True)
    return [
        Drive(scene=problem.scene, plan=problem.plan, start=start, parts=parts, tolerance=tolerance)
        for parts, tolerance in levels
    ]


def judged(problem: TruthProblem, engine: str, answer: EngineAnswer, end: np.ndarray) -> TruthRow:
    """Return the row of an engine's answer to `drives` of a problem.

    end: (2 nq,) of `problem.end()` [m, m/s]. Raises UnknownNameError.
    """
    row = TruthRow(
        phenomenon=problem.phenomenon, problem=problem.name, source=problem.source, engine=engine,
        came=answer.came.value,
        why=answer.why.rstrip("."),
    )  # fmt: skip
    if answer.came is not Came.DONE:
        return row
    about, energy = describe_engine(engine), _energy_of(problem.scene)
    told = [_errors(problem, motion, end, energy) for motion in answer.motions]
    worst = [_worst(item, problem) for item in told]
    errors = [error for error, _ in worst]
    levels = tuple(
        LevelRecord(
            step=None if about.adaptive else drive.step,
            tolerance=drive.tolerance if about.adaptive else None,
            error=_finite(error),
            energy=_finite(item.get("energy", math.inf)),
            microseconds=None
            if about.adaptive
            else 1e6 * motion.seconds / (problem.nodes * drive.parts),
            seconds=motion.seconds,
        )
        for drive, item, error, motion in zip(
            drives(problem, about), told, errors, answer.motions, strict=True
        )
    )
    order = None if about.adaptive else observed_order(errors)
    return replace(row, worst=worst[-1][1], order=order, levels=levels)


def observed_order(errors: Sequence[float]) -> float | None:
    """Return the slope of log error over log step, each step half of the previous one.

    None if fewer than two errors exceed rounding.
    """
    halvings = [
        place for place, error in enumerate(errors) if math.isfinite(error) and error > _ROUNDING
    ]
    return (
        None
        if len(halvings) < 2
        else -float(np.polyfit(halvings, [math.log2(errors[place]) for place in halvings], 1)[0])
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _errors(
    problem: TruthProblem,
    motion: SimulatedMotion,
    end: np.ndarray,
    energy: Callable[[np.ndarray, np.ndarray], float],
) -> dict[str, float]:
    """Return the errors by quantity, as shares, and the error of the energy."""
    if not motion.finite:
        return {"the motion": math.inf}
    start = np.split(np.array(problem.scene.task.start, dtype=float), 2)
    true = (
        energy(*start)
        if problem.energy_kept
        else energy(*np.split(end, 2))
        if np.isfinite(end).all()
        else math.nan
    )
    share = abs(energy(motion.q[-1], motion.v[-1]) - true) / max(abs(energy(*start)), abs(true))
    found = problem.errors(problem.plan.t, motion.q, motion.v, end)
    return found | ({"energy": share} if math.isfinite(share) else {})


def _worst(told: dict[str, float], problem: TruthProblem) -> tuple[float, str]:
    """Return the largest error and its quantity.

    The energy may be almost zero, so its error decides only if energy is conserved.
    """
    return max(
        (error, name) for name, error in told.items() if name != "energy" or problem.energy_kept
    )


def _energy_of(scene: Scene) -> Callable[[np.ndarray, np.ndarray], float]:
    """Return the kinetic, potential and contact energy [J] as a function of q, v (nq,) [m, m/s]."""
    d = derive(scene)
    plain, contact = (
        d.function([d.kinetic_energy + d.potential_energy], d.q, d.v),
        d.function([d.penetration, d.stiffness], d.q),
    )

    def energy(q: np.ndarray, v: np.ndarray) -> float:
        """Return the energy [J] at q, v (nq,) [m, m/s]. Raises nothing."""
        depth, stiffness = np.split(contact(q).ravel(), 2)
        return float(plain(q, v).item() + (stiffness * np.maximum(depth, 0.0) ** 2).sum() / 2)

    return energy

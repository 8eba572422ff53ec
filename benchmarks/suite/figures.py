"""The figures that were set as targets, from the rows: ratios of rounds that stood beside each other, seconds, and exponents of growth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from benchmarks.records import SuiteFigure, SuiteRow
from benchmarks.suite.cases import OURS, YARDSTICK

_Key = tuple[str, str]
# Ratios of the paper's scene are the ones with targets: n = 3; and sizes from here on, because
# below fixed costs are all there is.
_CARTS = 3
_LEAST_STEPS = 500
# Memory of a stage below this [MiB] is the bookkeeping of the process.
_LEAST_MEMORY = 1.0
_SIZES_FOR_GROWTH = 3


@dataclass(frozen=True)
class Ratio:
    """CPU time of the stages `over`, added up, by that of `under`."""

    name: str
    what: str
    target: float
    over: tuple[_Key, ...]
    under: _Key


_CHAIN = "softplus chain of three eps, from Scene to plans, against"
RATIOS = (
    Ratio("chain_against_casadi", f"{_CHAIN} CasADi and Ipopt by hand", 0.8,
          (("softplus_chain", OURS),), ("softplus_chain", "casadi")),
    Ratio("chain_against_drake", f"{_CHAIN} Drake and SNOPT", 1 / 20, (("softplus_chain", OURS),),
          ("softplus_chain", "drake_snopt")),
    Ratio(  # a loss of one's own is kept, by PyTorch's gradients; the rest is compiled
        "gd_against_pytorch", "iteration of gradient descent against the paper's PyTorch loop",
        1 / 150,
        (("gd_iteration", OURS),), ("gd_iteration", "pytorch_loop"),
    ),
    Ratio(
        "gd_against_c",
        "compiled rollout and adjoint against an iteration of this scene by hand in C", 1.5,
        (("gd_kernel", OURS),), ("gd_iteration", "hand_written_c"),
    ),
    Ratio(
        "pyomo_share", "Pyomo build and translation as a share of the softplus chain", 0.5,
        (("pyomo_build", OURS), ("translate", OURS)), ("softplus_chain", OURS),
    ),
    Ratio("eps_step", "a step of eps against building and solving cold", 1 / 5,
          (("eps_step", OURS),), ("cold_step", OURS)),
    Ratio(
        "replay_against_fmpy", "one Co-Simulation against FMPy's simulate_fmu, same FMU and step",
        1 / 3,
        (("cs_replay", OURS),), ("cs_replay", "fmpy"),
    ),
)  # fmt: skip
# stage -> (target [s], what)
SECONDS = {
    "list": (0.5, "listing: python -m validate list"),
    "report": (5.0, "reporting a stored campaign: python -m validate report"),
    "all_quick": (180.0, "a quick campaign on two cores: python -m validate all --quick"),
    "all_again": (15.0, "the quick campaign again, everything stored"),
}
# How a stage ends that was not cut off.
_ENDED = ("ok", "solved", "completed")
# Exponent of n T: (target, what)
GROWTH = {"time": (1.15, "growth of CPU time with T"), "memory": (1.05, "growth of memory with T")}


def figures(rows: Sequence[SuiteRow]) -> tuple[SuiteFigure, ...]:
    """Every figure of which something was measured, a ratio at each size."""
    found = [figure for ratio in RATIOS for figure in _ratio(ratio, rows)]
    found += [
        figure
        for stage, (target, what) in SECONDS.items()
        for figure in _seconds(stage, target, what, rows)
    ]
    found += [
        figure
        for kind, (target, what) in GROWTH.items()
        for figure in _growth(kind, target, what, rows)
    ]
    return tuple(found)


def _ratio(ratio: Ratio, rows: Sequence[SuiteRow]) -> list[SuiteFigure]:
    table = {(row.stage, row.by, row.n, row.steps): row for row in rows}
    found = []
    for n, steps in dict.fromkeys((row.n, row.steps) for row in rows if row.n):
        over, under = (
            [table.get((*key, n, steps)) for key in ratio.over],
            table.get((*ratio.under, n, steps)),
        )
        if under is None or any(row is None for row in over):
            continue
        above = [row for row in over if row is not None]
        samples = tuple(
            sum(tops) / below
            for *tops, below in zip(*(row.cpu_s for row in above), under.cpu_s, strict=False)
            if below > 0
        )
        why = next((row.failed for row in (*above, under) if row.failed), "")
        stopped = [
            f"{row.by} ended with {row.outcome!r}"
            for row in (*above, under)
            if row.outcome not in _ENDED
        ]
        if n != _CARTS or steps < _LEAST_STEPS:
            set_here, why = False, why or f"the target is set for n = {_CARTS}, T >= {_LEAST_STEPS}"
        else:
            set_here, why = True, why or "; ".join(stopped)
        found.append(
            _figure(
                ratio.name, ratio.what, n, steps, ratio.target, "", samples, why, set_here=set_here
            )
        )
    return found


def _seconds(stage: str, target: float, what: str, rows: Sequence[SuiteRow]) -> list[SuiteFigure]:
    found = []
    for row in rows:
        if row.stage == stage and row.by == OURS:
            why = row.failed or ("" if row.outcome == "ok" else row.outcome)
            figure = _figure(stage, what, 0, 0, target, f"s ({row.clock})", row.cpu_s, why)
            if row.outcome.startswith("imports ") and figure.met:
                figure = figure.model_copy(update={"met": False})
            found.append(figure)
    return found


def _growth(kind: str, target: float, what: str, rows: Sequence[SuiteRow]) -> list[SuiteFigure]:
    """The largest exponent of all our stages, each over the T of one n.

    Its samples are the exponents of the rounds. What was cut off is left out:

    how long that took says nothing of its T.
    """
    worst: tuple[float, str, int, tuple[float, ...], int] | None = None
    cut = dict.fromkeys(
        row.stage
        for row in rows
        if row.by == OURS and row.n and not row.failed and row.outcome not in _ENDED
    )
    for stage, n in dict.fromkeys(
        (row.stage, row.n) for row in rows if row.by == OURS and row.n and row.stage != YARDSTICK
    ):
        known = sorted(
            (
                row
                for row in rows
                if (row.stage, row.by, row.n) == (stage, OURS, n)
                and not row.failed
                and row.outcome in _ENDED
            ),
            key=lambda row: row.steps,
        )
        columns = [(row.steps, row.cpu_s if kind == "time" else row.memory_mib) for row in known]
        columns = [
            (steps, samples)
            for steps, samples in columns
            if samples and (kind == "time" or median(samples) >= _LEAST_MEMORY)
        ]
        if len(columns) < _SIZES_FOR_GROWTH:
            continue
        logs = np.log([steps for steps, _ in columns])
        exponents = tuple(
            float(np.polyfit(logs, np.log(values), 1)[0])
            for values in zip(*(samples for _, samples in columns), strict=False)
            if min(values) > 0
        )
        if exponents and (worst is None or median(exponents) > worst[0]):
            worst = (median(exponents), stage, n, exponents, int(columns[0][0]))
    if worst is None:
        return []
    _, stage, n, exponents, first = worst
    why = f"the steepest is {stage}" + (
        f"; cut off in some size, and left out there: {', '.join(cut)}" if cut else ""
    )
    set_here = first >= _LEAST_STEPS
    why += "" if set_here else f"; the target is set for T >= {_LEAST_STEPS}"
    return [_figure(f"growth_{kind}", what, n, 0, target, "", exponents, why, set_here=set_here)]


def _figure(
    name: str,
    what: str,
    n: int,
    steps: int,
    target: float,
    unit: str,
    samples: tuple[float, ...],
    why: str,
    *,
    set_here: bool = True,
) -> SuiteFigure:
    measured = median(samples) if samples else None
    met = None if measured is None or not set_here else measured <= target
    return SuiteFigure(
        name=name,
        what=what,
        n=n,
        steps=steps,
        target=target,
        unit=unit,
        samples=samples,
        measured=measured,
        met=met,
        why=why,
    )

"""Plan a drawn scene by pipelines, judge the plans, and name the reason of each failure.

    rows = attempt({"seed": 1, "number": 0, "pipelines": ["best_exact"], "time_limit": 20.0}, {})

| reason | means |
|---|---|
| crash | the method or the judge ended with an error |
| step too coarse | the step is unstable in contact, or the plan solves its grid and the motion departs |
| scale | in units of the scene's own size the same pipeline has a plan that holds |
| local optimum | the search converged where no plan is, although the witness is one |
| solver | the search was cut off: iterations, time, numbers that are not finite |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import monotonic
from typing import Any

from benchmarks.strangers.draw import Stranger, stranger
from benchmarks.strangers.units import in_units
from formulations.grids import departure, scene_of
from formulations.method import Leg
from formulations.pipelines import (
    BEST_EXACT,
    find_pipeline,
    load_method,
    solve_stages,
)
from formulations.solution import Outcome, Solution
from models.scene import Scene
from models.stability import step_stability
from validate.judge import judge

CRASH = "crash"
COARSE = "step too coarse"
SCALE = "scale"
LOCAL = "local optimum"
SOLVER = "solver"
REFUSED = "not applicable"
HOLD = ("holds", "holds with feedback")
_NO_PLAN = "no plan"
_CONVERGED = (Outcome.INFEASIBLE, Outcome.STALLED)

Row = dict[str, Any]


def attempt(request: Mapping[str, Any], arrays: Mapping[str, Any]) -> list[Row]:
    """Return a row for each pipeline; runs in a child process."""
    drawn = stranger(request["seed"], request["number"])
    return rows_of(drawn, request["pipelines"], request["time_limit"])


def rows_of(drawn: Stranger, pipelines: Sequence[str], time_limit: float) -> list[Row]:
    """Return a row for each pipeline on a drawn scene. time_limit: of a pipeline [s]."""
    size = drawn.size
    own = {"length": size.length, "mass": size.mass, "time": size.horizon}
    rows = []
    natural: Scene | None = None
    stored: dict[str, list[Solution]] = {}
    for name in pipelines:
        row = _run(drawn.scene, name, time_limit, stored)
        if row["reason"] in (LOCAL, SOLVER):
            natural = natural or in_units(drawn.scene, **own)
            again = _run(natural, name, time_limit, {})
            row["reason"] = SCALE if again["verdict"] in HOLD else row["reason"]
        head = {
            "scene": drawn.scene.name,
            "family": drawn.family,
            "length": size.length,
            "mass": size.mass,
            "stiffness": size.stiffness,
            "omega_h": round(size.turn, 2),
            "pipeline": name,
        }
        rows.append({**head, **row, "witness": float((drawn.witness**2).sum())})
    return rows


def _run(scene: Scene, name: str, time_limit: float, stored: dict[str, list[Solution]]) -> Row:
    """Plan and judge. stored: stages of earlier pipelines by legs, which best_exact reads."""
    began = monotonic()
    row: Row = {"outcome": "", "verdict": _NO_PLAN, "reason": "", "cost": None, "words": ""}
    first = find_pipeline(name).legs[0]
    refusal = load_method(first.method).accepts(scene)
    if refusal is not None:
        return {**row, "verdict": REFUSED, "words": refusal, "seconds": 0.0}
    try:
        found = _solved(scene, name, time_limit, stored)
        row |= {"outcome": found.outcome.name.lower(), "cost": found.cost, "words": found.message}
        if found.trajectory is not None:
            judged = judge(scene, found.trajectory)
            row |= {"verdict": judged.verdict.value, "words": judged.score.why}
        if row["verdict"] not in HOLD:
            row["reason"] = _reason(scene, found)
            row["words"] = f"{row['words']} | {found.message}"
    except Exception as error:  # noqa: BLE001 - a crash is what is looked for
        row |= {"reason": CRASH, "words": f"{type(error).__name__}: {error}"}
    return {**row, "seconds": round(monotonic() - began, 1)}


def _solved(
    scene: Scene, name: str, time_limit: float, stored: dict[str, list[Solution]]
) -> Solution:
    """Return the last stage of a pipeline, and store its stages."""
    pipeline = find_pipeline(name)
    if name == BEST_EXACT:
        with load_method(name).open(scene) as session:
            session.use_stored(lambda legs: stored.get(_key(legs)))
            return session.solve(eps=None, warm_start=None, time_limit=time_limit)
    stages = list(solve_stages(scene, pipeline, time_limit=time_limit))
    left = list(stages)
    for number, leg in enumerate(pipeline.legs, start=1):
        of_leg, left = left[: len(leg.schedule)], left[len(leg.schedule) :]
        if len(of_leg) == len(leg.schedule):
            stored[_key(pipeline.legs[:number])] = of_leg
    return stages[-1]


def _key(legs: Sequence[Leg]) -> str:
    return repr([(leg.method, leg.schedule, dict(leg.options), leg.stage_options) for leg in legs])


def _reason(scene: Scene, found: Solution) -> str:
    """Return why a solution is no plan that holds."""
    if not step_stability(scene).is_stable:
        return COARSE
    if found.outcome is not Outcome.SOLVED or found.trajectory is None:
        return LOCAL if found.outcome in _CONVERGED else SOLVER
    grid = scene_of(scene, found.trajectory)
    return COARSE if departure(grid, found.trajectory) > 1.0 else SOLVER

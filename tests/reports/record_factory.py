"""Records for the tests of the report: three carts pushed by hand-made inputs, a plan by softplus contact and a replay by the true law.

Not a solver: the motions are simulated, so that they look like motions, but costs and errors are
those of the inputs chosen here. `store` writes them into the NetCDF files of the stages that have a
plan, as a campaign does; `write_motion` writes others over them.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import h5py
import numpy as np

from models.results.run import (
    CampaignRecord,
    ContactRecord,
    EquationRecord,
    ProvenanceRecord,
    QuantityRecord,
    ReplayRecord,
    RunRecord,
    SceneRecord,
    Seconds,
    ShapeRecord,
    StageRecord,
    ViolationPoint,
    stage_files,
)
from models.results.stored import from_data, to_json
from models.results.verdict import Answer, Metric, Question
from reports.paper import TABLE_1
from reports.traces import Motion, Trace, read_motion

STEP = 0.01
STEPS = 500
STIFFNESS = 30.0
DAMPING = 2.0
LENGTH = 0.5
HOSTILE = "</script></style><img src=x onerror=\"document.title='owned'\"><b>'&\u202e"


def quantity(
    name: str, unit: str, description: str = "", value: float | None = None
) -> QuantityRecord:
    return QuantityRecord(name=name, unit=unit, description=description, value=value)


def contact(
    name: str, unit: str, description: str = "", bodies: tuple[str, str] = ("", "")
) -> ContactRecord:
    return ContactRecord(name=name, unit=unit, description=description, bodies=bodies)


def scene(
    name: str = "three_cart", title: str = "Three carts: the outer two push the middle one"
) -> SceneRecord:
    return SceneRecord(
        name=name,
        title=title,
        source="Suh and Wang, section V",
        coordinates=tuple(quantity(f"q{i}", "m", f"position of cart {i}") for i in (1, 2, 3)),
        velocities=tuple(quantity(f"v{i}", "m/s", f"velocity of cart {i}") for i in (1, 2, 3)),
        inputs=tuple(quantity(f"u{i}", "N", f"force on cart {i}") for i in (1, 3)),
        contacts=(
            contact("left", "N", "left cart against middle cart", ("left", "middle")),
            contact("right", "N", "middle cart against right cart", ("middle", "right")),
        ),
        parameters=(
            quantity("k", "N/m", "contact stiffness", STIFFNESS),
            quantity("d", "m", "length of a cart", LENGTH),
        ),
        start=(2.0, 3.0, 4.0, 0.0, 0.0, 0.0),
        goal=(2.5, 3.5, 4.5, 0.0, 0.0, 0.0),
        step=STEP,
        steps=STEPS,
        equations=(
            EquationRecord(
                caption="acceleration of the left cart",
                mathml='<math xmlns="http://www.w3.org/1998/Math/MathML" display="block"><mi>m</mi><msub><mover><mi>q</mi><mo>¨</mo></mover><mn>1</mn></msub>'
                "<mo>=</mo><msub><mi>u</mi><mn>1</mn></msub><mo>−</mo><mi>c</mi><msub><mi>v</mi><mn>1</mn></msub><mo>−</mo><msub><mi>λ</mi><mn>1</mn></msub></math>",
            ),
        ),
        absent=(
            "no friction: no tangential force is formed",
            "a constant mass matrix: it is factorised once",
        ),
        answers=(
            quantity(
                "best known cost of an exact plan",
                "1",
                "convex QP with fixed contact windows",
                490.5495305,
            ),
        ),
        shapes=tuple(
            ShapeRecord(name=word, kind="box", size=(LENGTH, LENGTH))
            for word in ("left", "middle", "right")
        ),
    )


def _relu(phi: float) -> float:
    return STIFFNESS * max(phi, 0.0)


def _softplus(eps: float):
    sharp = abs(math.log(eps))
    return lambda phi: (
        STIFFNESS / sharp * (max(sharp * phi, 0.0) + math.log1p(math.exp(-abs(sharp * phi))))
    )


def _inputs(t: float, push: float) -> tuple[float, float]:
    u1 = push * math.sin(math.pi * t / 3.2) if t < 3.2 else -0.6 * math.exp(-(t - 3.2))
    u3 = 0.9 * push * math.sin(math.pi * (t - 2.4) / 2.6) if t > 2.4 else 0.0
    return u1, u3


@cache
def simulate(eps: float | None, push: float, every: int = 2) -> Mapping[str, Sequence[float]]:
    """Columns of a file: the motion under these inputs by softplus contact at eps, or by the true law (None), at every so many steps."""
    law = _relu if eps is None else _softplus(eps)
    q, v = [2.0, 3.0, 4.0], [0.0, 0.0, 0.0]
    names = (
        "q1",
        "q2",
        "q3",
        "v1",
        "v2",
        "v3",
        "u1",
        "u3",
        "lam_left",
        "lam_right",
        "gap_left",
        "gap_right",
    )
    columns: dict[str, list[float]] = {name: [] for name in ("t", *names)}
    for step in range(STEPS + 1):
        t = step * STEP
        u = _inputs(t, push)
        phi = (LENGTH - (q[1] - q[0]), LENGTH - (q[2] - q[1]))
        lam = (law(phi[0]), law(phi[1]))
        if step % every == 0:
            for name, value in zip(columns, (t, *q, *v, *u, *lam, -phi[0], -phi[1]), strict=True):
                columns[name].append(value)
        force = (u[0] - lam[0], lam[0] - lam[1], u[1] + lam[1])
        v = [speed + STEP * (pull - DAMPING * speed) for speed, pull in zip(v, force, strict=True)]
        q = [place + STEP * speed for place, speed in zip(q, v, strict=True)]
    nothing = [0.0] * len(columns["t"])
    for place, name in enumerate(("q1", "q2", "q3"), 1):
        columns |= {
            f"pose_x_{place}": columns[name],
            f"pose_y_{place}": [LENGTH / 2] * len(nothing),
            f"pose_angle_{place}": nothing,
        }
    return columns


def _motions(stage: StageRecord) -> dict[str, Mapping[str, Sequence[float]]]:
    """What the files of a stage hold, by kind."""
    cost = stage.cost if stage.cost is not None and abs(stage.cost) < 1e4 else 490.0
    push = 2.0 + cost / 490.0
    plan = simulate((stage.eps or None) if stage.method != "relaxed_lcp" else None, push)
    replay = simulate(None, push + 0.02)
    away = [
        max(abs(replay[name][row] - plan[name][row]) for name in ("q1", "q2", "q3"))
        for row in range(len(plan["t"]))
    ]
    replay |= {"knots": list(range(len(away))), "position_error": away}
    found = {"trajectory": plan}
    if stage.replay is not None:
        found["replay"] = replay
        if stage.replay.tracked is not None:
            found["tracked"] = {
                **replay,
                **{f"applied_{name}": plan[name] for name in ("u1", "u3")},
            }
    return found


def write_motion(path: Path, columns: Mapping[str, Sequence[float]]) -> None:
    """A file of these columns alone."""
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values


def motion(folder: Path, run: RunRecord, stage: StageRecord) -> Motion:
    """What is read of a stage's files; folder: of the campaign."""
    return read_motion(folder / "runs" / run.key, run, stage)


def trace(t: Sequence[float], **columns: Sequence[float]) -> Trace:
    return Trace(
        np.asarray(t, float), {name: np.asarray(values, float) for name, values in columns.items()}
    )


def questions(**answers: Answer) -> tuple[tuple[Question, Answer], ...]:
    """Answered yes unless given by number: q3="no"."""
    asked = [question for question in Question if question.value]
    return tuple((question, answers.get(f"q{question.number}", "yes")) for question in asked)


def _metric(
    name: str,
    value: float | None,
    unit: str,
    limit: float | None = None,
    number: int | None = None,
    error: float = 0.0,
) -> Metric:
    return Metric(
        question=Question.SHOWN if number is None else list(Question)[number - 1], error=error, name=name, value=value, unit=unit,
        meaning=f"what {name} means, in words", limit=limit,
        reason="the reason of the limit" if limit is not None else "",
        ok=None if limit is None or value is None else value <= limit,
    )  # fmt: skip


PAPER = {
    (row.methods[-1], row.eps, row.methods[0] if len(row.methods) > 1 else None): row.numbers
    for row in TABLE_1
}
# cost, terminal error of the plan, on the grid, after the replay, physics: near what PAPER.md says
# was measured.
OURS = {
    ("strict_lcp", None, None): (496.63, 2e-10, 3e-8, 4.1e-3, 4e-6),
    ("relu_gd", None, None): (542.5604, 0.04, 0.04, 0.041, 0.0),
    ("relaxed_lcp", 1e-2, None): (489.83, 1e-10, 1.1e-2, 1.4e-2, 2.99),
    ("relaxed_lcp", 1e-3, None): (489.2, 1e-10, 1.2e-3, 5e-3, 0.31),
    ("relaxed_lcp", 1e-4, None): (491.64, 1e-10, 2e-4, 4.2e-3, 0.03),
    ("strict_lcp", None, "relaxed_lcp"): (491.96, 1e-10, 2e-8, 4.0e-3, 2e-6),
    ("relu_gd", None, "relaxed_lcp"): (490.1, 3e-3, 3e-3, 6e-3, 0.0),
    ("softplus_dc", 1e-3, None): (197.863, 2e-10, 0.4491, 0.4512, 2445.9),
    ("softplus_dc", 1e-5, None): (261.228, 2e-10, 0.2649, 0.2666, 625.14),
    ("softplus_dc", 1e-7, None): (339.524, 2e-10, 0.1189, 0.1201, 239.53),
    ("strict_lcp", None, "softplus_dc"): (490.83, 2e-10, 2e-8, 4.0e-3, 3e-6),
    ("relu_gd", None, "softplus_dc"): (360.31, 0.047, 0.047, 0.048, 0.0),
    ("softplus_gd", 1e-3, None): (149.17, 0.31, 0.411, 0.412, 2180.0),
    ("softplus_gd", 1e-5, None): (166.45, 0.21, 0.273, 0.274, 510.0),
    ("softplus_gd", 1e-7, None): (215.14, 0.15, 0.196, 0.197, 190.0),
    ("strict_lcp", None, "softplus_gd"): (490.57, 2e-10, 2e-8, 4.0e-3, 3e-6),
    ("relu_gd", None, "softplus_gd"): (309.42, 0.047, 0.047, 0.049, 0.0),
}  # fmt: skip
SCHEDULES = {
    "relaxed_lcp": (1e-2, 1e-3, 1e-4),
    "softplus_dc": (1e-3, 1e-5, 1e-7),
    "softplus_gd": (1e-3, 1e-5, 1e-7),
}
PIPELINES = (
    ("strict", None, "strict_lcp"), ("relu_gd", None, "relu_gd"),
    ("relaxed+strict", "relaxed_lcp", "strict_lcp"),
    ("relaxed+relu_gd", "relaxed_lcp", "relu_gd"),
    ("softplus_dc+strict", "softplus_dc", "strict_lcp"),
    ("softplus_dc+relu_gd", "softplus_dc", "relu_gd"),
    ("softplus_gd+strict", "softplus_gd", "strict_lcp"),
    ("softplus_gd+relu_gd", "softplus_gd", "relu_gd"),
)  # fmt: skip


def stage(
    index: int, method: str, eps: float | None, before: str | None, total: float, **changes: object
) -> StageRecord:
    cost, planned, grid, replayed, physics = OURS[method, eps, before]
    theirs = PAPER[method, eps, before]
    kind = "direct" if method in ("strict_lcp", "relu_gd") else "indirect"
    violates = kind == "indirect"
    iterations = 20 + 3 * index
    values = {
        "index": index,
        "method": method,
        "method_title": method.replace("_", " ").capitalize(),
        "kind": kind,
        "eps": eps,
        "outcome": "solved",
        "advice": "Solved: the method's own stopping rule was met.",
        "cost": cost,
        "iterations": iterations,
        "residuals": {"defect": 2e-13, "complementarity": 4e-9, "terminal": planned},
        "options": {
            "tolerance": 1e-8,
            "max_iterations": 3000,
            "hessian": "exact",
            "bounds": [0.1, 0.1],
        },
        "history": {
            "objective": tuple(cost * (1 + 2.0 * 0.8**place) for place in range(iterations)),
            "inf_pr": tuple(10.0 * 0.4**place for place in range(iterations)),
        },
        "seconds": Seconds(
            build=0.08,
            translate=0.05,
            evaluate=0.2,
            linear_algebra=0.4,
            wall=0.73,
            cpu=0.71,
            total=total + 0.73,
            replay=0.5,
        ),
        "metrics": (
            _metric("physics", physics, "N^2"),
            _metric("physics_scaled", physics * STEP / 225.0, "s", 1e-6, 3),
            _metric("defect", 1e-13, "1", 1e-6, 6),
            _metric("terminal_error", planned, "m"),
            _metric("discrete_terminal_error", grid, "m"),
            _metric("replay_terminal_error", replayed, "m, m/s"),
            _metric("replay_terminal_position_error", 0.8 * replayed, "m", 0.06, 4, 3e-9),
            _metric("replay_terminal_velocity_error", 0.6 * replayed, "m/s", 0.06, 4, 3e-9),
            _metric("replay_error", 0.009, "m", 0.02, 4, 3e-9),
            _metric("ghost_impulse", 0.02 if violates else 1e-4, "N s", 0.01, 5),
        ),
        "questions": questions(**({"q3": "no"} if violates else {})),
        "verdict": "violates" if violates else "holds",
        "why": f"physics scaled is {physics * STEP / 225.0:.2g} s, but at most 1e-06 s holds."
        if violates
        else "",
        "cause": "physics_scaled" if violates else "",
        "replay": ReplayRecord(
            error_estimate=3e-9,
            tolerance_difference=2e-9,
            step_difference=4e-5,
            everyday_difference=4e-5,
            events=6,
            seconds_reference=0.31,
            seconds_everyday=0.09,
            fmu="0f3c" * 16,
        ),
        "has_plan": True,
        "paper": theirs,
    }
    return from_data(StageRecord, values | changes)


def provenance(**changes: object) -> ProvenanceRecord:
    values = {
        "touchstone": "0.1.0", "commit": "a" * 40, "python": "3.11.7",
        "platform": "Linux-6.1-x86_64", "cpu": "Some Processor 2.6 GHz",
        "cores": 2, "threads": 1, "packages": {"numpy": "2.4.6", "pyomo": "6.10.1"},
        "compiler": "gcc 12.2.0", "seed": 1,
        "started": "2025-01-02T03:04:05Z", "command": "python -m validate all",
    }  # fmt: skip
    return from_data(ProvenanceRecord, values | changes)


def run(pipeline: str, before: str | None, last: str, **changes: object) -> RunRecord:
    stages, total = [], 0.0
    for eps in SCHEDULES.get(before or "", ()):
        stages.append(stage(len(stages), str(before), eps, None, total))
        total += 0.73
    stages.append(stage(len(stages), last, None, before, total))
    values = {
        "key": f"{pipeline.replace('+', '-')}-0123456789abcdef",
        "scene": scene(),
        "pipeline": pipeline,
        "pipeline_title": f"{before or 'cold start'}, then {last}",
        "stages": tuple(stages),
        "outcome": "solved",
        "verdict": stages[-1].verdict,
        "must_hold": True,
        "wall_seconds": 4.2,
        "cpu_seconds": 4.0,
        "provenance": provenance(),
        "log_tail": "iteration 1 objective 600\niteration 2 objective 500\nEXIT: Optimal Solution Found.",
    }
    return from_data(RunRecord, values | changes)


def judged(name: str, value: float | None, unit: str = "m", **changes: object) -> Metric:
    """One metric, without a limit unless given."""
    return from_data(
        Metric, {"name": name, "value": value, "unit": unit, "meaning": name} | changes
    )


def ran(
    name: str,
    *metrics: Metric,
    cpu: float = 1.0,
    of: SceneRecord | None = None,
    **changes: object,
) -> RunRecord:
    """A run of one stage by a method of the pipeline's name, with these metrics alone and no row of the paper beside it."""
    first = stage(0, "strict_lcp", None, None, 0.0)
    said = {
        "method": name, "method_title": name.capitalize(), "paper": {}, "metrics": metrics,
        "seconds": replace(first.seconds, cpu=cpu),
    }  # fmt: skip
    one = replace(first, **(said | changes))
    return run(
        name,
        None,
        "strict_lcp",
        stages=(one,),
        key=f"{name}-key",
        verdict=one.verdict,
        scene=of or scene(),
    )


def runs() -> list[RunRecord]:
    return [run(*pipeline) for pipeline in PIPELINES]


def violation() -> tuple[ViolationPoint, ...]:
    points = []
    for power in range(1, 13):
        eps = 10.0**-power
        form = (STIFFNESS * math.log(2) / math.log(eps)) ** 2
        points.append(
            ViolationPoint(law="softplus", eps=eps, measured=form * (1 + 1e-9), closed_form=form)
        )
        points.append(ViolationPoint(law="relaxed_lcp", eps=eps, measured=eps, closed_form=eps))
    return tuple(points)


def campaign(records: list[RunRecord], **changes: object) -> CampaignRecord:
    values = {
        "title": "touchstone: all of Table I", "command": "python -m validate all --out runs/all",
        "started": "2025-01-02T03:04:05Z",
        "keys": tuple(record.key for record in records), "violation": violation(),
        "provenance": provenance(),
    }  # fmt: skip
    return from_data(CampaignRecord, values | changes)


def store(folder: Path, records: list[RunRecord], record: CampaignRecord | None = None) -> Path:
    """Write the records, and the motions of their stages, as the campaign does."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.json").write_text(to_json(record or campaign(records)))
    for one in records:
        place = folder / "runs" / one.key
        place.mkdir(parents=True, exist_ok=True)
        with warnings.catch_warnings(action="ignore"):  # tests name a verdict by its word
            (place / "record.json").write_text(to_json(one))
        for stage in getattr(one, "stages", ()):
            for what, columns in _motions(stage).items() if stage.has_plan else ():
                write_motion(place / stage_files(stage.index, len(one.stages))[what], columns)
    return folder

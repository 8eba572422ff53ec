"""Records for the tests of the report: three carts pushed by hand-made inputs, a plan by softplus contact and a replay by the true law.

Not a solver: the motions are simulated, so that traces look like traces, but costs and errors are those of the inputs chosen here.
"""

from __future__ import annotations

import math
from pathlib import Path

from reports.record import (
    CampaignRecord,
    EquationRecord,
    FigureRecord,
    ProvenanceRecord,
    QuantityRecord,
    ReplayRecord,
    RunRecord,
    SceneRecord,
    SecondsRecord,
    ShapeRecord,
    StageRecord,
    TraceRecord,
    ViolationPoint,
)

STEP, STEPS, STIFFNESS, DAMPING, LENGTH = 0.01, 500, 30.0, 2.0, 0.5
HOSTILE = "</script></style><img src=x onerror=\"document.title='owned'\"><b>'&\u202e"


def _quantity(name: str, unit: str, description: str = "", value: float | None = None) -> QuantityRecord:
    return QuantityRecord(name=name, unit=unit, description=description, value=value)


def scene(name: str = "three_cart", title: str = "Three carts: the outer two push the middle one") -> SceneRecord:
    return SceneRecord(
        name=name,
        title=title,
        source="Suh and Wang, section V",
        coordinates=tuple(_quantity(f"q{i}", "m", f"position of cart {i}") for i in (1, 2, 3)),
        velocities=tuple(_quantity(f"v{i}", "m/s", f"velocity of cart {i}") for i in (1, 2, 3)),
        inputs=tuple(_quantity(f"u{i}", "N", f"force on cart {i}") for i in (1, 3)),
        contacts=(_quantity("left", "N", "left cart against middle cart"), _quantity("right", "N", "middle cart against right cart")),
        parameters=(_quantity("k", "N/m", "contact stiffness", STIFFNESS), _quantity("d", "m", "length of a cart", LENGTH)),
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
        absent=("no friction: no tangential force is formed", "a constant mass matrix: it is factorised once"),
        answers=(_quantity("best known cost of an exact plan", "1", "convex QP with fixed contact windows", 490.5495305),),
        shapes=tuple(ShapeRecord(name=word, kind="box", size=(LENGTH, LENGTH)) for word in ("left", "middle", "right")),
    )


def _relu(phi: float) -> float:
    return STIFFNESS * max(phi, 0.0)


def _softplus(eps: float):
    sharp = abs(math.log(eps))
    return lambda phi: STIFFNESS / sharp * (max(sharp * phi, 0.0) + math.log1p(math.exp(-abs(sharp * phi))))


def _inputs(t: float, push: float) -> tuple[float, float]:
    u1 = push * math.sin(math.pi * t / 3.2) if t < 3.2 else -0.6 * math.exp(-(t - 3.2))
    u3 = 0.9 * push * math.sin(math.pi * (t - 2.4) / 2.6) if t > 2.4 else 0.0
    return u1, u3


def simulate(law, push: float, every: int = 2) -> TraceRecord:
    q, v = [2.0, 3.0, 4.0], [0.0, 0.0, 0.0]
    names = ("q1", "q2", "q3", "v1", "v2", "v3", "u1", "u3", "lam_left", "lam_right", "gap_left", "gap_right")
    columns: dict[str, list[float]] = {name: [] for name in names}
    times: list[float] = []
    for step in range(STEPS + 1):
        t = step * STEP
        u = _inputs(t, push)
        phi = (LENGTH - (q[1] - q[0]), LENGTH - (q[2] - q[1]))
        lam = (law(phi[0]), law(phi[1]))
        if step % every == 0:
            times.append(t)
            for name, value in zip(names, (*q, *v, *u, *lam, -phi[0], -phi[1]), strict=True):
                columns[name].append(value)
        force = (u[0] - lam[0], lam[0] - lam[1], u[1] + lam[1])
        v = [speed + STEP * (pull - DAMPING * speed) for speed, pull in zip(v, force, strict=True)]
        q = [place + STEP * speed for place, speed in zip(q, v, strict=True)]
    poses = {
        word: tuple((x, LENGTH / 2, 0.0) for x in columns[name]) for word, name in (("left", "q1"), ("middle", "q2"), ("right", "q3"))
    }
    return TraceRecord(t=tuple(times), columns={name: tuple(values) for name, values in columns.items()}, poses=poses)


def _figure(name: str, value: float | None, unit: str, limit: float | None = None) -> FigureRecord:
    return FigureRecord(
        name=name,
        value=value,
        unit=unit,
        meaning=f"what {name} means, in words",
        limit=limit,
        reason="the reason of the limit" if limit is not None else "",
        ok=None if limit is None or value is None else value <= limit,
    )


PAPER = {
    ("strict_lcp", None, None): (40779.28, 0.0, 0.0, 31.56),
    ("relu_gd", None, None): (542.56, 0.04, 0.16, 49.59),
    ("relaxed_lcp", 1e-2, None): (484.21, 0.0, 2.99, 1407.9),
    ("relaxed_lcp", 1e-3, None): (561.0, 0.0, 0.34, 580.77),
    ("relaxed_lcp", 1e-4, None): (469.94, 0.0, 0.03, 430.16),
    ("strict_lcp", None, "relaxed_lcp"): (46415.2, 0.0, 0.0, 20.73),
    ("relu_gd", None, "relaxed_lcp"): (492.06, 0.0, 0.2, 0.27),
    ("softplus_dc", 1e-3, None): (197.86, 0.0, 2445.98, 11.64),
    ("softplus_dc", 1e-5, None): (261.23, 0.0, 625.11, 9.78),
    ("softplus_dc", 1e-7, None): (339.53, 0.0, 239.5, 12.4),
    ("strict_lcp", None, "softplus_dc"): (16619.35, 0.0, 0.0, 100.07),
    ("relu_gd", None, "softplus_dc"): (360.31, 0.0, 0.2, 1.43),
    ("softplus_gd", 1e-3, None): (149.18, 0.41, 0.01, 4.07),
    ("softplus_gd", 1e-5, None): (166.45, 0.27, 0.11, 3.77),
    ("softplus_gd", 1e-7, None): (215.14, 0.2, 0.12, 2.94),
    ("strict_lcp", None, "softplus_gd"): (3748.3, 0.0, 0.0, 151.54),
    ("relu_gd", None, "softplus_gd"): (309.42, 0.05, 0.21, 2.38),
}
# cost, terminal error of the plan, on the grid, after the replay, physics: near what PAPER.md says was measured.
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
}
SCHEDULES = {"relaxed_lcp": (1e-2, 1e-3, 1e-4), "softplus_dc": (1e-3, 1e-5, 1e-7), "softplus_gd": (1e-3, 1e-5, 1e-7)}
PIPELINES = (
    ("strict", None, "strict_lcp"),
    ("relu_gd", None, "relu_gd"),
    ("relaxed+strict", "relaxed_lcp", "strict_lcp"),
    ("relaxed+relu_gd", "relaxed_lcp", "relu_gd"),
    ("softplus_dc+strict", "softplus_dc", "strict_lcp"),
    ("softplus_dc+relu_gd", "softplus_dc", "relu_gd"),
    ("softplus_gd+strict", "softplus_gd", "strict_lcp"),
    ("softplus_gd+relu_gd", "softplus_gd", "relu_gd"),
)


def stage(index: int, method: str, eps: float | None, before: str | None, total: float, **changes: object) -> StageRecord:
    cost, planned, grid, replayed, physics = OURS[method, eps, before]
    theirs = PAPER[method, eps, before]
    kind = "direct" if method in ("strict_lcp", "relu_gd") else "indirect"
    push = 2.0 + cost / 490.0
    law = _softplus(eps) if eps is not None and method != "relaxed_lcp" else _relu
    plan, replay = simulate(law, push), simulate(_relu, push + 0.02)
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
        "options": {"tolerance": 1e-8, "max_iterations": 3000, "hessian": "exact", "bounds": [0.1, 0.1]},
        "history": {"objective": tuple(cost * (1 + 2.0 * 0.8**place) for place in range(iterations)), "inf_pr": tuple(10.0 * 0.4**place for place in range(iterations))},
        "seconds": SecondsRecord(build=0.08, translate=0.05, evaluate=0.2, linear_algebra=0.4, solve=0.6, stage=0.73, stage_cpu=0.71, total=total + 0.73, replay=0.5),
        "figures": (
            _figure("physics", physics, "N^2"),
            _figure("physics_scaled", physics * STEP / 225.0, "s", 1e-6),
            _figure("defect", 1e-13, "1", 1e-6),
            _figure("terminal_error", planned, "m"),
            _figure("discrete_terminal_error", grid, "m", 0.05),
            _figure("replay_terminal_error", replayed, "m", 0.06),
            _figure("replay_error", 0.009, "m", 0.02),
            _figure("ghost_impulse", 0.02 if violates else 1e-4, "N s"),
        ),
        "verdict": "violates" if violates else "holds",
        "why": f"physics scaled is {physics * STEP / 225.0:.2g} s, but at most 1e-06 s holds." if violates else "",
        "replay": ReplayRecord(error_estimate=3e-9, tolerance_difference=2e-9, step_difference=4e-5, everyday_difference=4e-5, events=6, seconds_reference=0.31, seconds_everyday=0.09, fmu="0f3c" * 16),
        "plan_trace": plan,
        "replay_trace": replay,
        "paper": dict(zip(("cost", "stability", "physics", "time"), theirs, strict=True)),
    }
    return StageRecord.model_validate(values | changes)


def provenance(**changes: object) -> ProvenanceRecord:
    values = {
        "touchstone": "0.1.0",
        "commit": "a" * 40,
        "python": "3.11.7",
        "platform": "Linux-6.1-x86_64",
        "cpu": "Some Processor 2.6 GHz",
        "cores": 2,
        "threads": 1,
        "packages": {"numpy": "2.4.6", "pyomo": "6.10.1"},
        "compiler": "gcc 12.2.0",
        "seed": 1,
        "started": "2025-01-02T03:04:05Z",
        "command": "python -m validate all",
    }
    return ProvenanceRecord.model_validate(values | changes)


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
    return RunRecord.model_validate(values | changes)


def runs() -> list[RunRecord]:
    return [run(*pipeline) for pipeline in PIPELINES]


def crashed() -> RunRecord:
    return run("crashing", None, "strict_lcp", key="crashing-0", stages=(), outcome="crashed", message="The process ended with signal 11.", verdict="no plan", log_tail="\x1b[31mSegmentation fault\x1b[0m")


def out_of_time() -> RunRecord:
    bare = {"plan_trace": None, "replay_trace": None, "replay": None, "figures": (), "history": {}, "residuals": {}, "cost": None, "verdict": "no plan"}
    late = stage(0, "strict_lcp", None, None, 0.0, outcome="time_limit", advice="Stopped at its time limit; allow more time, or start it warm.", why="there is no plan to score.", **bare)
    return run("late", None, "strict_lcp", key="late-0", stages=(late,), outcome="time_limit", verdict="no plan", log_tail="")


def refused() -> RunRecord:
    return run("refusing", None, "strict_lcp", key="refusing-0", stages=(), outcome="refused", message="The scene has friction, which this method does not know.", verdict="no plan", must_hold=False)


def hostile() -> RunRecord:
    """Every string that a scene, a method or a log can bring, made of markup."""
    bad = stage(0, "strict_lcp", None, None, 0.0)
    trace = bad.plan_trace
    assert trace is not None
    bad = bad.model_copy(
        update={
            "method": HOSTILE,
            "method_title": HOSTILE,
            "outcome": HOSTILE,
            "advice": HOSTILE,
            "message": HOSTILE,
            "why": HOSTILE,
            "options": {HOSTILE: HOSTILE},
            "residuals": {HOSTILE: 1.0},
            "history": {HOSTILE: (3.0, 2.0, 1.0)},
            "figures": (FigureRecord(name=HOSTILE, value=None, unit=HOSTILE, meaning=HOSTILE, reason=HOSTILE),),
            "paper": {},
            "plan_trace": trace.model_copy(update={"poses": {HOSTILE: trace.poses["left"]}}),
        }
    )
    where = scene(HOSTILE, HOSTILE).model_copy(
        update={
            "source": HOSTILE,
            "contacts": (_quantity(HOSTILE, HOSTILE, HOSTILE),),
            "equations": (EquationRecord(caption=HOSTILE, mathml=f"<math><mi>{HOSTILE}</mi></math>"), EquationRecord(caption="script", mathml="<math><script>document.title='owned'</script></math>")),
            "absent": (HOSTILE,),
            "answers": (_quantity(HOSTILE, HOSTILE, HOSTILE, 1.0),),
            "shapes": (ShapeRecord(name=HOSTILE, kind=HOSTILE, size=(1.0,)),),
        }
    )
    origin = provenance(commit=HOSTILE, cpu=HOSTILE, platform=HOSTILE, command=HOSTILE, packages={HOSTILE: HOSTILE})
    return run("strict", None, "strict_lcp", key="hostile-0", pipeline_title=HOSTILE, scene=where, stages=(bad,), outcome=HOSTILE, message=HOSTILE, provenance=origin, log_tail=HOSTILE).model_copy(
        update={"pipeline": HOSTILE}
    )


def violation() -> tuple[ViolationPoint, ...]:
    points = []
    for power in range(1, 13):
        eps = 10.0**-power
        form = (STIFFNESS * math.log(2) / math.log(eps)) ** 2
        points.append(ViolationPoint(law="softplus", eps=eps, measured=form * (1 + 1e-9), closed_form=form))
        points.append(ViolationPoint(law="relaxed_lcp", eps=eps, measured=eps, closed_form=eps))
    return tuple(points)


def campaign(records: list[RunRecord], **changes: object) -> CampaignRecord:
    values = {
        "title": "touchstone: all of Table I",
        "command": "python -m validate all --out runs/all",
        "started": "2025-01-02T03:04:05Z",
        "keys": tuple(record.key for record in records),
        "violation": violation(),
        "provenance": provenance(),
    }
    return CampaignRecord.model_validate(values | changes)


def store(folder: Path, records: list[RunRecord], record: CampaignRecord | None = None) -> Path:
    """Write the records as the campaign does."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.json").write_text((record or campaign(records)).model_dump_json())
    for one in records:
        place = folder / "runs" / one.key
        place.mkdir(parents=True, exist_ok=True)
        (place / "record.json").write_text(one.model_dump_json())
    return folder

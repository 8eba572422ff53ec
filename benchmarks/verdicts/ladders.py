"""Ladders of plans that get worse from rung to rung: no word may get better on the way down.

Inputs are scaled towards nothing, with the plan's states and without; states are displaced; planned
friction is scaled. All of it starts from a good plan of the scene, written with all its digits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.verdicts.plans import NoPlanError, Plan, as_plan, found, judged_in_time, scene_of
from benchmarks.verdicts.search import GOOD, HOLDS, WITH_FEEDBACK
from models.scene import Scene

# The ladder of the verdict, the worst word first.
WORDS = ("violates", "undecided", WITH_FEEDBACK, HOLDS)
RUNGS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.0)


def ladders(scene: Scene, plan: Plan) -> Iterator[tuple[str, list[Plan]]]:
    """Yield each ladder of a plan: its name, and the plan at each rung."""
    yield "inputs", [plan.but(u=(1.0 - off) * plan.u) for off in RUNGS]
    alone = plan.but(q=None, v=None, lam=None, friction=None, scheme="")
    yield "inputs alone", [alone.but(u=(1.0 - off) * plan.u) for off in RUNGS]
    if plan.q is not None:
        nominal = np.array([item.nominal for item in scene.coordinates])
        bump = np.sin(np.pi * np.linspace(0.0, 1.0, len(plan.t)))[:, None] * nominal
        bare = plan.but(lam=None, friction=None, scheme="", v=None)
        yield "states", [bare.but(q=plan.q + off * bump) for off in RUNGS]
    if plan.friction is not None and plan.friction.any():
        bare = plan.but(scheme="")
        yield "friction", [bare.but(friction=(1.0 + off) * plan.friction) for off in RUNGS]


def run(scenes: list[str]) -> dict[str, Any]:
    """Judge every ladder of these scenes, and tell which are not monotone."""
    rows: list[dict[str, Any]] = []
    for reference in scenes:
        scene = scene_of(reference)
        try:
            good = as_plan(found(reference, GOOD.get(reference, "strict"))[-1], scene)
        except NoPlanError as error:
            print(f"ladders {reference}: skipped, {error}")
            continue
        for name, plans in ladders(scene, good):
            with tempfile.TemporaryDirectory() as folder:
                said = [
                    judged_in_time(scene, plan.write(Path(folder) / "plan.csv", scene)).verdict
                    for plan in plans
                ]
            ranks = [WORDS.index(word) if word in WORDS else -1 for word in said]
            is_monotone = -1 not in ranks and all(np.diff(ranks) <= 0)
            print(f"{'ok' if is_monotone else '!! ladder':12}{reference} {name}: {', '.join(said)}")
            rows.append({"scene": reference, "ladder": name, "said": said, "monotone": is_monotone})
    odd = sum(not row["monotone"] for row in rows)
    print(f"ladders: {len(rows)} ladders, {odd} not monotone")
    return {"ladders": rows, "not_monotone": odd}

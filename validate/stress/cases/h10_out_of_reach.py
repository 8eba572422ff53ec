"""A goal out of reach, 20 m in 1 s instead of 3: direct methods must report `infeasible`."""

from __future__ import annotations

import time

from formulations.solution import Outcome
from models.catalog import load_scene
from validate.stress.case import Found, StressCase, at_most, finding, none_of
from validate.stress.motion import solved

FAR = 20.0
STEPS = 100
BUDGET = 20.0
# Eps of one method of each kind: smooth, exact, by windows.
METHODS = {"softplus_dc": 1e-3, "relaxed_lcp": 1e-2, "strict_lcp": None, "mpcc": None}


def measure() -> Found:
    """Measure the case."""
    scene = load_scene("three_cart").with_task(
        goal=(FAR, FAR + 1.0, FAR + 2.0, 0.0, 0.0, 0.0), steps=STEPS
    )
    wrong, endings, slowest = [], [], 0.0
    for name, eps in METHODS.items():
        begin = time.perf_counter()
        solution = solved(scene, name, eps, seconds=BUDGET)
        slowest = max(slowest, time.perf_counter() - begin)
        endings.append(f"{name}: {solution.outcome.name.lower()}")
        if solution.outcome is not Outcome.INFEASIBLE:
            wrong.append(f"{name} ends as {solution.outcome.name.lower()}: {solution.message}")
        if solution.outcome is Outcome.SOLVED or (
            solution.outcome is Outcome.INFEASIBLE and solution.trajectory is not None
        ):
            wrong.append(f"{name} hands back a plan")
    return finding(
        f"{', '.join(endings)}; the slowest took {slowest:.1f} s.",
        none_of("methods that do not say so", wrong, reason="outcome infeasible, no plan"),
        at_most("the slowest method", slowest, BUDGET, "s", reason="the time limit it was given"),
    )


CASE = StressCase(
    title="Goal out of reach",
    expected="`infeasible` within its budget, no plan marked valid.",
    scenes=("three_cart",),
    methods=("softplus_dc", "relaxed_lcp", "strict_lcp", "mpcc"),
)

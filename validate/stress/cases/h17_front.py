"""Terminal tolerance from 0 to 0.1: the least cost within each, as a front.

A larger tolerance is never dearer, and every point ends where it says.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from formulations.mpec import certify_solution
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene.goal import distance, goal_state
from validate.stress.case import Found, StressCase, at_most, chart, finding, none_of
from validate.stress.motion import solved

TOLERANCES = (0.0, 1e-2, 0.1)


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    scene = load_scene("three_cart")
    best = next(
        answer.value for answer in scene.answers if answer.quantity.startswith("best known cost")
    )
    kernel, goal = load_kernel(scene), goal_state(scene.task)
    front = certify_solution(
        scene, solved(scene, "mpcc_front", seconds=90.0, tolerances=TOLERANCES, search=False)
    ).front
    costs, over, wrong = [], [0.0], []
    for point in front:
        plan, cost = point.solution.trajectory, point.solution.cost
        costs.append(math.nan if cost is None else cost)
        if plan is None:
            wrong.append(f"{point.tolerance:g}: {point.solution.message}")
            continue
        # the inputs through the true law, not the plan's own word
        true = kernel.rollout(np.array(scene.task.start), plan.u, scene.task.step)
        over.append(distance(np.concatenate([true.q[-1], true.v[-1]]), goal) - point.tolerance)
        certificate = point.solution.certificate
        if certificate is None or not certificate.feasible:
            wrong.append(
                f"{point.tolerance:g}: {'no certificate' if certificate is None else certificate.sentence}"
            )
    rises = [late - early for early, late in pairwise(costs)]
    return finding(
        f"Cost {costs[0]:.2f} at the goal itself, {costs[-1]:.2f} within {TOLERANCES[-1]:g}.",
        none_of("tolerances without a certified plan", wrong, reason="each can be met"),
        at_most(
            "cost at the goal itself above the best known, relative",
            costs[0] / best - 1.0,
            1e-3,
            reason="without the search for cheaper contact windows: 490.558 of 490.5495",
        ),
        at_most(
            "largest rise of the cost with the tolerance",
            max(rises, default=math.nan),
            1e-6,
            reason="a plan within a tolerance is within every larger one",
        ),
        at_most(
            "end beyond its tolerance, true contact law",
            max(over),
            1e-7,
            reason="the residual of an exactly solved quadratic program",
        ),
        charts=(
            chart(
                "Least cost within a terminal tolerance",
                x=("terminal tolerance (0 drawn at 1e-4)", ""),
                y=("cost", ""),
                series={
                    "three carts, exact contact": (
                        [max(tolerance, 1e-4) for tolerance in TOLERANCES],
                        costs,
                    )
                },
                log="x",
            ),
        ),
    )


CASE = StressCase(
    title="Terminal tolerance 0 .. 0.1",
    expected="Cost against terminal error as a front.",
    scenes=("three_cart",),
    methods=("mpcc_front", "mpcc"),
)

"""Rescaled units, mm, tonnes and N/mm: equal forces and costs, positions times 1000."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.catalog import load_scene
from models.scene import Scene
from validate.stress.case import Found, StressCase, at_most, finding, none_of
from validate.stress.motion import at_nodes, replayed, rolled, solved

LENGTH = 1e3


def _in_millimetres(scene: Scene) -> Scene:
    """Return three carts with q * 1e3; N = tonne mm/s^2 keeps forces, and `length` is scaled."""
    values = {parameter.name: parameter.value for parameter in scene.parameters}
    scaled = scene.with_parameters(
        m=values["m"] / LENGTH,
        c=values["c"] / LENGTH,
        k=values["k"] / LENGTH,
        d=values["d"] * LENGTH,
    )
    goal = [None if value is None else value * LENGTH for value in scene.task.goal]
    scaled = replace(scaled, length=scene.length * LENGTH)
    return scaled.with_task(
        start=tuple(value * LENGTH for value in scene.task.start), goal=tuple(goal)
    )


def measure() -> Found:
    """Measure the case."""
    metres = load_scene("three_cart")
    small = _in_millimetres(metres)
    u = np.random.default_rng(16).uniform(-5.0, 5.0, size=(300, 2)) + np.array([2.0, -2.0])
    plans = [rolled(scene, u=u) for scene in (metres, small)]
    step = float(
        max(
            np.abs(plans[1].q / LENGTH - plans[0].q).max(),
            np.abs(plans[1].lam - plans[0].lam).max(),
        )
    )
    truths = [replayed(scene, plan) for scene, plan in zip((metres, small), plans, strict=True)]
    replay_difference = (
        float(np.abs(at_nodes(truths[1]) / LENGTH - at_nodes(truths[0])).max())
        if all(item.ok for item in truths)
        else np.inf
    )
    solutions = [solved(scene, "mpcc", seconds=20.0, search=False) for scene in (metres, small)]
    costs = [np.inf if solution.cost is None else solution.cost for solution in solutions]
    wrong = [
        f"{name}: {item.outcome.name.lower()}, {item.message}"
        for name, item in zip(("m", "mm"), solutions, strict=True)
        if item.trajectory is None
    ]
    return finding(
        f"Cost {costs[0]:.6f} in metres, {costs[1]:.6f} in millimetres; motions differ by {max(step, replay_difference):.0e} m.",
        at_most(
            "plan's step: difference after rescaling", step, 1e-11, reason="rounding of 300 steps"
        ),
        at_most(
            "replay: difference after rescaling",
            replay_difference,
            1e-8,
            reason="ten times what the replay says of its own error",
        ),
        none_of("units in which no plan is found", wrong, reason="the same task"),
        at_most(
            "relative difference of the costs",
            abs(costs[1] / costs[0] - 1.0),
            1e-6,
            reason="one problem, solved exactly for the windows found",
        ),
    )


CASE = StressCase(
    title="Units rescaled (q * 1e3, k * 1e-3)",
    expected="The same answer after rescaling.",
    scenes=("three_cart",),
    methods=("mpcc",),
)

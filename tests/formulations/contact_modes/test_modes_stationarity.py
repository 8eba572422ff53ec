"""Classes of biactive pairs, and the signs of multipliers against costs: a negative one names the mode that is cheaper."""

import numpy as np
import pytest

from formulations.contact_modes.linear import linear_scene
from formulations.contact_modes.quadratic import ModesProblem, classify
from formulations.contact_modes.search import closed_steps
from models.catalog import load_scene

SCENE = load_scene("three_cart")


@pytest.mark.parametrize(
    ("pairs", "letter", "least"),
    [
        ([(1.0, 2.0), (0.0, 3.0)], "S", 0.0), ([(1.0, 2.0), (0.0, -3.0)], "M", -3.0), ([(-1.0, -2.0), (1.0, 1.0)], "C", -2.0),
        ([(-1.0, 2.0), (1.0, 1.0)], "A", -1.0), ([(-1.0, 2.0), (-1.0, -1.0)], "W", -1.0), ([], "S", 0.0),
    ],
)  # fmt: skip
def test_classes(pairs: list[tuple[float, float]], letter: str, least: float) -> None:
    force, separation = np.full((8, 1), 50.0), np.full((8, 1), -50.0)  # of pairs that are not biactive: they do not count
    biactive = np.zeros((8, 1), dtype=bool)
    for t, (of_force, of_separation) in enumerate(pairs):
        force[t], separation[t], biactive[t] = of_force, of_separation, True
    found = classify(force, separation, biactive)
    assert (found.letter, found.biactive, found.least) == (letter, len(pairs), least)


@pytest.mark.parametrize(("contact", "shift"), [(0, -2), (0, 2), (1, -2), (1, 2)])
def test_a_negative_multiplier_names_a_cheaper_mode(contact: int, shift: int) -> None:
    """Intervals that begin wrongly: where the pair that touches has a negative multiplier, the other mode there is cheaper."""
    intervals = [[131, 179], [276, 307]]
    intervals[contact][0] += shift
    problem = ModesProblem(linear_scene(SCENE))
    answer = problem.solve(closed_steps(tuple(((first, stop),) for first, stop in intervals), 500))
    assert answer.cost > 490.5495306
    negative = [
        (t, c)
        for t, c in zip(*np.nonzero(answer.active.touching), strict=True)
        if (answer.of_force if not answer.closed[t, c] else answer.of_separation)[t, c] < -1e-6
    ]
    costs = []
    for t, c in negative:
        closed = answer.closed.copy()
        closed[t, c] = not closed[t, c]
        other = problem.solve(closed)
        costs.append(np.inf if other is None else other.cost)
    assert negative
    assert min(costs) < answer.cost

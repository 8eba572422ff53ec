"""Which points of a line may be left out: each limit from both sides, and nothing that can be seen."""

from itertools import pairwise

import numpy as np
import pytest

from reports.plots import seen


@pytest.mark.parametrize(
    ("xs", "ys", "kept"),
    [
        ([], [], []), ([0], [5], [0]), ([0, 1], [5, 9], [0, 1]), ([0, 1, 2], [0, 0, 0], [0, 2]),
        # Nine tenths of 0.1 are a point's that is alone.
        ([0, 1, 2], [0, 0.089, 0], [0, 2]), ([0, 1, 2], [0, 0.091, 0], [0, 1, 2]), ([0, 1, 2], [0, -0.089, 0], [0, 2]), ([0, 1, 2], [0, -0.091, 0], [0, 1, 2]),
        ([0, 2, 4], [1, 1.089, 1], [0, 2]), ([0, 2, 4], [1, 1.091, 1], [0, 1, 2]), ([0, 1, 2, 3, 4], [0, 0, 1, 0, 0], [0, 1, 2, 3, 4]),
        # Slopes from the first point may lie from 0.005 to 0.095 after the third.
        ([0, 1, 2, 3], [0, 0.08, 0.1, 0.02], [0, 3]), ([0, 1, 2, 3], [0, 0.08, 0.1, 0.01], [0, 2, 3]), ([0, 1, 2, 3], [0, 0.08, 0.1, 0.28], [0, 3]),
        ([0, 1, 2, 3], [0, 0.08, 0.1, 0.3], [0, 2, 3]), ([0, 1, 2, 3], [0, -0.08, -0.1, -0.28], [0, 3]), ([0, 1, 2, 3], [0, -0.08, -0.1, -0.3], [0, 2, 3]),
        ([0, 1, 10, 11], [0, 0.08, 0.0, 0.5], [0, 2, 3]),
        # Jumps are kept, what is less than a line's width is not.
        ([0, 1, 1, 2], [0, 0, 5, 5], [0, 1, 2, 3]), ([0, 1, 1, 2], [0, 0, -5, -5], [0, 1, 2, 3]), ([0, 1, 1, 2], [0, 0, 0.089, 0], [0, 3]),
        ([0, 1, 1, 2], [0, 0, -0.089, 0], [0, 3]), ([0, 1, 1, 2], [0, 0, 0.091, 0], [0, 1, 2, 3]), ([0, 0, 1, 2], [0, 5, 5, 5], [0, 1, 3]),
        ([0, 1, 1, 1, 2], [0, 0, 5, 9, 9], [0, 1, 2, 3, 4]), ([0, 1, 1, 2, 3], [0, 0, 5, 6, 7], [0, 1, 2, 4]),
        ([3, 4, 5], [0, 1, 2], [0, 2]), ([3, 4, 5, 6], [7, 8, 8, 8], [0, 1, 3]),
    ],
)  # fmt: skip
def test_points_that_are_kept(xs: list[float], ys: list[float], kept: list[int]):
    assert seen(np.array(xs, float), np.array(ys, float), 0.1) == kept


def distances(xs: np.ndarray, ys: np.ndarray, kept: list[int]) -> float:
    """How far a point lies above or below what is drawn, at most; of a jump the nearest of its points counts."""
    far = 0.0
    for first, last in pairwise(kept):
        inside = slice(first, last + 1)
        run = xs[last] - xs[first]
        line = (
            ys[first] + (ys[last] - ys[first]) * (xs[inside] - xs[first]) / run
            if run > 0
            else np.clip(ys[inside], *sorted((ys[first], ys[last])))
        )
        far = max(far, float(np.abs(line - ys[inside]).max()))
    return far


@pytest.mark.parametrize("tolerance", [0.25, 0.01])
@pytest.mark.parametrize("shape", ["wave", "noise", "steps", "steep", "corner"])
def test_of_long_lines_nothing_that_is_seen_is_left_out_and_little_is_kept(shape: str, tolerance: float):
    random, xs = np.random.default_rng(3), np.linspace(54.0, 426.0, 1201)
    ys = {
        "wave": 100.0 * np.sin(xs / 30.0), "noise": np.cumsum(random.normal(size=1201)) * tolerance, "steps": 50.0 * np.floor(xs / 40.0),
        "steep": -3.0 * xs, "corner": np.abs(xs - 234.0625),
    }[shape]  # fmt: skip
    kept = seen(xs, ys, tolerance)
    assert (kept[0], kept[-1], sorted(set(kept))) == (0, 1200, kept)
    assert distances(xs, ys, kept) <= tolerance * 1.0001
    assert len(kept) <= {"wave": 450 if tolerance < 0.1 else 80, "noise": 900, "steps": 22, "steep": 2, "corner": 4}[shape]


def test_times_that_stand_still_keep_every_jump():
    xs = np.repeat(np.arange(20.0), 2)
    ys = np.tile([0.0, 9.0], 20)
    assert seen(xs, ys, 0.1) == list(range(40))

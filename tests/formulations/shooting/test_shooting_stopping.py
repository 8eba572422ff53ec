"""The stopping rule on sequences of losses whose right answer is known, beside the same rule written out once more."""

import itertools
import math

import pytest
from descent_in_python import progress as written_out

from formulations.shooting.descent import Losses, Progress


def _stops(losses, tolerance: float = 1e-4, limit: int = 100000) -> tuple[int, Progress]:
    """Iteration and verdict at which the rule stops on a sequence."""
    rule = Losses()
    for index, loss in enumerate(itertools.islice(losses, limit)):
        progress = rule.add(loss, tolerance)
        if index < 2000:
            assert progress.value == written_out(rule.values, tolerance)
        if progress is not Progress.DESCENDING:
            assert rule.best == min(rule.values)
            assert progress is Progress.RUNAWAY or rule.exhausted or rule.decrease() <= tolerance
            return index, progress
    return limit, Progress.DESCENDING


def _descent(rate: float, floor: float = 1.0):
    return (floor + math.exp(-rate * n) for n in itertools.count())


@pytest.mark.parametrize("rate", [0.1, 0.01, 0.001])
def test_stops_at_the_same_loss_whatever_the_learning_rate(rate: float):
    """Ten times smaller steps take ten times the iterations to the same place, and the rule waits for them."""
    index, progress = _stops(_descent(rate))
    assert progress is Progress.SETTLED
    assert math.exp(-rate * index) < 1e-3  # what is left to gain, relative to the floor


def test_does_not_depend_on_the_scale_of_the_loss():
    small, large = ((factor * loss for loss in _descent(0.02)) for factor in (1e-9, 1e9))
    assert _stops(small) == _stops(large)


def test_smaller_tolerance_goes_further():
    assert _stops(_descent(0.01), tolerance=1e-8)[0] > _stops(_descent(0.01), tolerance=1e-3)[0]


def test_a_loss_that_goes_to_zero_stops_when_nothing_is_left():
    index, progress = _stops(math.exp(-0.1 * n) for n in itertools.count())
    assert progress is Progress.SETTLED
    assert math.exp(-0.1 * index) == pytest.approx(1e-20, rel=0.2)


def test_nothing_to_do_stops_at_once():
    assert _stops(itertools.repeat(0.0)) == (0, Progress.SETTLED)


def test_climbing_is_called_runaway():
    index, progress = _stops(1.0 + 1.1**n for n in itertools.count())
    assert progress is Progress.RUNAWAY
    assert index <= 60


def test_one_bad_step_is_forgiven():
    losses = (1.0 + math.exp(-0.02 * n) + (1e3 if n in (40, 130) else 0.0) for n in itertools.count())
    assert _stops(losses)[1] is Progress.SETTLED


def test_swinging_about_the_best_settles():
    """A fixed step across a kink of the loss never comes to rest, but gains nothing either."""
    assert _stops(1.0 + math.exp(-0.05 * n) + 1e-3 * (n % 2) for n in itertools.count())[1] is Progress.SETTLED

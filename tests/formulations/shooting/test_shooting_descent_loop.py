"""The loop of gradient descent against the same written out in numpy; bounds, limits, interrupts; the stopping rule on sequences of losses whose right answer is known, beside the same rule written out once more."""

import itertools
import math
import signal

import numpy as np
import pytest
import torch
from descent_in_python import descend_in_python
from descent_in_python import progress as written_out
from example_scenes import example_scene
from wording import unsaid

from formulations.shooting.descent import Losses, Progress, descend
from formulations.shooting.objective import Objective, Weights
from formulations.shooting.options import DescentOptions
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw

TOLD = {
    "at limit": Outcome.ITERATION_LIMIT, "runaway": Outcome.DIVERGED, "not finite": Outcome.DIVERGED,
}  # fmt: skip


SOFTPLUS, RELU = ContactLaw.SOFTPLUS, ContactLaw.RELU


# scene, law, eps, options, size of the first inputs, how it ends, and how many digits of a chaotic descent two orders of summation share
CASES = {
    "the paper's descent": ("three_cart", SOFTPLUS, 1e-3, DescentOptions(learning_rate=500.0, iterations=300), 0.0, "at limit", 1e-9),
    "our own rule": ("three_cart", RELU, None, DescentOptions(learning_rate=500.0), 0.5, "settled", 1e-9),
    "at the bounds": ("three_cart", RELU, None, DescentOptions(learning_rate=5e4, max_iterations=400), 12.0, "runaway", 1e-3),
    "too long steps": ("three_cart", SOFTPLUS, 1e-5, DescentOptions(learning_rate=3e3, max_iterations=2000), 0.0, "runaway", 1e-3),
    "a mass matrix that turns": ("two_link_arm", RELU, None, DescentOptions(learning_rate=1.0, iterations=60), 0.1, "at limit", 1e-6),
    "a divergence": ("two_link_arm", RELU, None, DescentOptions(learning_rate=700.0, iterations=200), 0.0, "not finite", 1e-3),
    "a free end": ("three_cart", RELU, None, DescentOptions(learning_rate=100.0, iterations=40), 0.3, "at limit", 1e-10),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_it_is_the_descent_written_out_in_numpy(case: str):
    name, law, eps, settings, size, expected, digits = CASES[case]
    scene = example_scene(name)
    kernel = load_kernel(scene)
    goal = np.array(scene.task.goal, dtype=float)
    goal[0] = np.nan if case == "a free end" else goal[0]
    u0 = size * np.sin(np.arange(scene.task.steps * scene.nu, dtype=float)).reshape(scene.task.steps, scene.nu)
    told, last, best, rows = descend_in_python(kernel, law, eps, goal, (1.5, 1e-5), u0, settings)
    found = descend(Objective(kernel, law=law, eps=eps, weights=Weights(terminal=1.5, running=1e-5), goal=goal), u0, settings, 60.0)
    assert told == expected
    assert found.outcome is TOLD.get(told, found.outcome)
    assert told != "settled" or found.outcome in (Outcome.SOLVED, Outcome.STALLED)
    if digits < 1e-3:
        assert len(found.history["loss"]) == len(rows)
    first = min(20, len(rows))  # before a chaotic descent has made its own of a rounding
    for column, expectation in zip(found.history.values(), rows.T, strict=True):
        np.testing.assert_allclose(column[:first], expectation[:first], rtol=max(digits, 1e-9))
        if digits < 1e-3:
            np.testing.assert_allclose(column, expectation, rtol=digits, atol=1e-15)
    if found.u is not None:
        plan = best if settings.iterations is None else last
        assert np.abs(found.u - plan).max() <= 10.0 * digits * max(1.0, np.abs(plan).max())


def test_an_interrupt_is_obeyed_in_the_middle():
    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    objective = Objective(load_kernel(load_scene("three_cart")), law=ContactLaw.RELU)
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(KeyboardInterrupt):
            descend(objective, np.zeros((500, 2)), DescentOptions(learning_rate=1e-9, iterations=10**9), 1e9)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_a_time_limit_ends_it_with_the_plan_so_far():
    objective = Objective(load_kernel(load_scene("three_cart")), law=ContactLaw.RELU)
    found = descend(objective, np.zeros((500, 2)), DescentOptions(learning_rate=1e-9, iterations=10**9), 0.1)
    assert found.outcome is Outcome.TIME_LIMIT
    assert found.u is not None
    assert not unsaid(found.message, f"after {found.iterations} iterations … limit of 0.1 s")


def test_a_loss_of_ones_own_is_descended():
    """Changes of the inputs cost, instead of the inputs: a smoother plan, and the loss falls to where its gradient is small."""
    scene = load_scene("three_cart")
    kernel, goal = load_kernel(scene), torch.tensor(scene.task.goal, dtype=torch.float64)

    def smooth(plan, u):
        return (plan.end - goal).square().mean(-1) + 1e-3 * u.diff(dim=-2).square().sum((-2, -1))

    u0 = np.where(np.arange(500)[:, None] % 2 == 0, 3.0, -3.0) * np.ones((1, 2))
    own = descend(
        Objective(kernel, law=ContactLaw.SOFTPLUS, eps=1e-3, loss=smooth), u0, DescentOptions(learning_rate=100.0, iterations=300), 60.0
    )
    papers = descend(Objective(kernel, law=ContactLaw.SOFTPLUS, eps=1e-3), u0, DescentOptions(learning_rate=100.0, iterations=300), 60.0)
    assert own.u is not None
    assert papers.u is not None
    assert own.history["loss"][-1] < 0.1 * own.history["loss"][0]
    assert np.abs(np.diff(own.u, axis=0)).max() < 0.1 * np.abs(np.diff(papers.u, axis=0)).max()


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

"""The stability limit of the time step: closed forms, the step's Jacobian against differences, and motions that are unstable by themselves."""

import math

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scenes.cart_chain import cart_chain
from models.stability import spectral_radius, step_jacobian, step_stability


@pytest.mark.parametrize(("h", "c"), [(0.01, 2.0), (0.02, 2.0), (0.01, 0.0), (0.001, 50.0)])
def test_three_carts_have_the_limit_of_the_closed_form(h: float, c: float):
    """h^2 w^2 + 2 h c < 4 with w^2 = 3 k: both contacts closed, the middle cart against the outer two."""
    limit = (4.0 - 2.0 * h * c) / (3.0 * h**2)
    scene = load_scene("three_cart").with_task(step=h)
    below = step_stability(scene.with_parameters(k=0.999 * limit, c=c))
    above = step_stability(scene.with_parameters(k=1.001 * limit, c=c))
    assert below.is_stable
    assert below.sentence == ""
    assert not above.is_stable
    assert above.radius > 1.0
    assert above.contacts == ("left", "right")
    assert "left and right closed" in above.sentence
    # the step it advises is the root of the same form in h
    w2 = 3.0 * 1.001 * limit
    root = (-2.0 * c + math.sqrt(4.0 * c**2 + 16.0 * w2)) / (2.0 * w2)
    assert above.largest_step == pytest.approx(root, rel=1e-6)


def test_the_papers_limit_is_13200():
    scene = load_scene("three_cart")
    assert step_stability(scene.with_parameters(k=13199.0)).is_stable
    assert not step_stability(scene.with_parameters(k=13201.0)).is_stable


@pytest.mark.slow
def test_a_free_pair_and_a_long_chain():
    pair = load_scene("two_body_collision")
    w = math.sqrt(2000.0 / 0.75)
    assert step_stability(pair).largest_step == pytest.approx(2.0 / w, rel=1e-6)
    n = 20  # all contacts closed is a chain of springs, free at its ends
    chain = cart_chain(n)
    w2 = 4.0 * 30.0 * math.sin(math.pi * (n - 1) / (2 * n)) ** 2
    root = (-4.0 + math.sqrt(16.0 + 16.0 * w2)) / (2.0 * w2)
    assert step_stability(chain).largest_step == pytest.approx(root, rel=1e-5)


def test_contacts_that_exclude_each_other_are_not_closed_together():
    """The two walls are 2 m apart: both closed would be twice as stiff."""
    found = step_stability(load_scene("cart_pole_walls").with_parameters(k=2e5))
    assert len(found.contacts) == 1


@pytest.mark.parametrize("name", ["cart_pole_walls", "acrobot_limits"])
def test_a_motion_that_is_unstable_by_itself_is_not_the_steps_fault(name: str):
    found = step_stability(load_scene(name))
    assert found.is_stable
    assert found.radius > 1.001  # it does grow
    assert found.growth > 3.0


@pytest.mark.parametrize("name", ["three_cart", "cart_pole_walls", "two_discs"])
def test_the_jacobian_of_the_step_against_differences(name: str):
    scene = load_scene(name)
    kernel, task = load_kernel(scene), scene.task
    state = np.array(task.start) + np.random.default_rng(5).normal(scale=0.1, size=2 * scene.nq)
    u = np.full((1, scene.nu), 0.5)

    def after(x: np.ndarray) -> np.ndarray:
        plan = kernel.rollout(x, u, task.step)
        return np.concatenate([plan.q[-1], plan.v[-1]])

    columns = [(after(state + d) - after(state - d)) / 2e-6 for d in 1e-6 * np.eye(len(state))]
    assert step_jacobian(kernel, state, u[0], task.step) == pytest.approx(np.array(columns).T, abs=1e-8)


def test_past_the_limit_the_step_does_blow_up():
    """What the warning promises: contact that is closed once throws the carts out of every bound; below the limit it does not."""
    scene = load_scene("three_cart")
    start = np.array([2.5, 2.99, 3.48, 0.0, 0.0, 0.0])
    speeds = []
    for k in (13000.0, 15000.0):
        pressed = scene.with_parameters(k=k)
        matrix = step_jacobian(load_kernel(pressed), start, np.zeros(2), scene.task.step)
        speeds.append(spectral_radius(matrix))
    assert speeds[0] <= 1.0 + 1e-9
    assert speeds[1] > 1.5


def test_friction_does_not_limit_the_step():
    """The same stops without the belt, which the step treats implicitly."""
    scene = load_scene("transport")
    w2 = 1000.0 * (1.0 + 0.5)
    assert step_stability(scene).largest_step == pytest.approx(2.0 / math.sqrt(w2), rel=1e-6)

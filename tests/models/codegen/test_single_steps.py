"""Single steps: linearised one by one against finite differences, and run with feedback."""

from functools import cache

import numpy as np
import pytest
from example_scenes import example_scene

from models.catalog import load_scene
from models.codegen.kernel import KernelError, load_kernel
from models.codegen.steps import Steps, load_steps
from models.contact_law import ContactLaw

LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3))
# States in contact, away from kinks: (positions, velocities).
STATES = {
    "three_cart": (2.0, 2.4, 2.8, 0.3, -0.2, 0.1), "acrobot_limits": (0.3, -0.5, 0.7, -0.4), "transport": (2.2, 1.0, 0.5, -0.4),
    "cart_pole_walls": (0.7, 0.5, 0.2, -0.3), "damped_arm": (0.2, -0.06, 0.5, 0.3, -0.2, 0.4),
}  # fmt: skip


@cache
def steps_of(name: str) -> Steps:
    return load_steps(example_scene(name))


@pytest.mark.parametrize("name", STATES)
@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_jacobians_are_finite_differences_of_the_step(name: str, law: ContactLaw, eps: float | None):
    steps = steps_of(name)
    random = np.random.default_rng(1)
    x = np.array(STATES[name]) + 0.01 * random.normal(size=(3, len(STATES[name])))
    u = random.normal(size=(3, steps.scene.nu))
    h = 0.005
    found = steps.linearise(x, u, h, law, eps)
    assert found is not None
    delta = 1e-6
    for index in range(x.shape[1]):
        side = delta * np.eye(x.shape[1])[index]
        ends = [steps.linearise(x + sign * side, u, h, law, eps) for sign in (1.0, -1.0)]
        slope = (ends[0].next - ends[1].next) / (2 * delta)
        np.testing.assert_allclose(found.A[:, :, index], slope, rtol=1e-6, atol=1e-7)
    for index in range(steps.scene.nu):
        side = delta * np.eye(steps.scene.nu)[index]
        ends = [steps.linearise(x, u + sign * side, h, law, eps) for sign in (1.0, -1.0)]
        slope = (ends[0].next - ends[1].next) / (2 * delta)
        np.testing.assert_allclose(found.B[:, :, index], slope, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", STATES)
def test_steps_one_by_one_are_the_rollout_bit_for_bit(name: str):
    steps, scene = steps_of(name), example_scene(name)
    u = np.random.default_rng(2).normal(size=(40, scene.nu))
    whole = load_kernel(scene).rollout(np.array(STATES[name]), u, 0.005)
    x = np.hstack([whole.q, whole.v])
    alone = steps.linearise(x[:-1], u, 0.005)
    assert np.array_equal(alone.next, x[1:])
    assert np.array_equal(alone.lam, whole.lam)
    run = steps.follow(x[0], np.zeros((40, x.shape[1])), u, np.zeros((40, scene.nu, x.shape[1])), 0.005)
    assert np.array_equal(run.x, x)
    assert np.array_equal(run.u, u)
    assert not run.diverged


def test_feedback_jumps_and_bounds_are_what_the_docstring_says():
    steps, scene = steps_of("cart_pole_walls"), load_scene("cart_pole_walls")
    n, h, random = 20, scene.task.step, np.random.default_rng(3)
    x_plan, u_plan = random.normal(size=(n, 4)), 3.0 * random.normal(size=(n, 1))
    gain, jump = 5.0 * random.normal(size=(n, 1, 4)), 1e-3 * random.normal(size=(n, 4))
    run = steps.follow(np.array(scene.task.start), x_plan, u_plan, gain, h, jump=jump)
    asked = u_plan + np.einsum("tij,tj->ti", gain, run.x[:-1] - x_plan)
    np.testing.assert_allclose(run.u, np.clip(asked, -4.0, 4.0), rtol=1e-12)
    assert (np.abs(asked) > 4.0).any()
    assert (np.abs(asked) < 4.0).any()
    alone = steps.linearise(run.x[:-1], run.u, h)
    np.testing.assert_allclose(run.x[1:], alone.next + jump, rtol=1e-12, atol=1e-14)


def test_non_finite_steps_are_reported():
    steps = steps_of("three_cart")
    x = np.array([STATES["three_cart"]])
    assert steps.linearise(x, np.array([[np.inf, 0.0]]), 0.01) is None
    run = steps.follow(x[0], np.zeros((3, 6)), np.array([[0.0, 0.0], [np.nan, 0.0], [0.0, 0.0]]), np.zeros((3, 2, 6)), 0.01)
    assert run.diverged
    assert run.finite_steps == 1
    with pytest.raises(KernelError, match=r"x has shape \(1, 5\)"):
        steps.linearise(x[:, :5], np.zeros((1, 2)), 0.01)

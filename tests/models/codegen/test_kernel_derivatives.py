"""The adjoint of the compiled time step: against finite differences."""

from functools import cache

import numpy as np
import pytest
from example_scenes import example_scene

from models.codegen.kernel import Kernel, load_kernel
from models.contact_law import ContactLaw

NAMES = ("three_cart", "two_link_arm", "two_body_collision", "bouncing_mass", "oscillator")
LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3))
# A start in contact, away from the kink of the ReLU, for each scene.
STARTS = {
    "three_cart": (2.0, 2.4, 2.8, 0.3, -0.2, 0.1), "two_link_arm": (0.3, 0.4, -0.5, 0.7), "two_body_collision": (0.0, 0.15, 1.0, -1.0),
    "bouncing_mass": (-0.05, 0.3), "oscillator": (1.0, 0.2),
}  # fmt: skip


@cache
def kernel_of(name: str) -> Kernel:
    return load_kernel(example_scene(name))


def _loss(kernel: Kernel, start: np.ndarray, u: np.ndarray, h: float, law: ContactLaw, eps: float | None, bars: tuple) -> float:
    plan = kernel.rollout(start, u, h, law, eps)
    q_bar, v_bar, lam_bar, cost_bar = bars
    cost = kernel.cost(plan.q, plan.v, u)
    return float((q_bar * plan.q).sum() + (v_bar * plan.v).sum() + (lam_bar * plan.lam).sum() + cost_bar * cost)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_adjoint_is_the_finite_difference_of_a_loss_of_everything(name: str, law: ContactLaw, eps: float | None):
    """Every entry of u and start; the loss weighs every entry of q, v, lam and the running cost."""
    kernel = kernel_of(name)
    scene, steps, h = kernel.scene, 12, 0.002
    random = np.random.default_rng(4)
    u, start = random.normal(size=(steps, scene.nu)), np.array(STARTS[name])
    bars = (
        random.normal(size=(steps + 1, scene.nq)),
        random.normal(size=(steps + 1, scene.nq)),
        random.normal(size=(steps, scene.nc)),
        0.7,
    )
    plan = kernel.rollout(start, u, h, law, eps)
    assert not scene.nc or plan.lam.max() > 0.0
    u_bar, start_bar = kernel.adjoint(plan, u, bars[0], bars[1], bars[2], bars[3])

    delta = 1e-6  # central differences: error delta^2 of the curvature, rounding 1e-16/delta
    for gradient, point in ((u_bar, u), (start_bar, start)):
        for index in np.ndindex(point.shape):
            values = []
            for sign in (1.0, -1.0):
                moved = point.copy()
                moved[index] += sign * delta
                values.append(_loss(kernel, *((start, moved) if point is u else (moved, u)), h, law, eps, bars))
            assert gradient[index] == pytest.approx((values[0] - values[1]) / (2 * delta), rel=2e-6, abs=2e-6)


def test_adjoint_without_contact_force_derivatives_is_the_one_with_zeros():
    kernel = kernel_of("three_cart")
    u = np.ones((10, 2))
    plan = kernel.rollout(np.array(STARTS["three_cart"]), u, 0.01)
    bar = np.ones((11, 3))
    for left, right in zip(kernel.adjoint(plan, u, bar, bar), kernel.adjoint(plan, u, bar, bar, np.zeros((10, 2))), strict=True):
        assert (left == right).all()


def test_slope_of_both_laws_at_a_penetration_of_exactly_zero():
    """ReLU: 0, as in the plan's own model before it touches; softplus: half the stiffness."""
    kernel = kernel_of("bouncing_mass")
    plan_start, u, h = np.zeros(2), np.zeros((1, 0)), 0.1
    v_bar = np.array([[0.0], [1.0]])
    for law, eps, slope in ((ContactLaw.RELU, None, 0.0), (ContactLaw.SOFTPLUS, 1e-3, 0.5)):
        plan = kernel.rollout(plan_start, u, h, law, eps)
        _, start_bar = kernel.adjoint(plan, u, np.zeros((2, 1)), v_bar)
        assert start_bar[0] == pytest.approx(-h * slope * kernel.stiffness()[0], rel=1e-14)

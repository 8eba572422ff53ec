"""The compiled rollout as a PyTorch function: against the plain PyTorch reference, finite differences, and misuse."""

import numpy as np
import pytest
import torch
from example_scenes import example_scene

from formulations.shooting.reference import reference_rollout
from formulations.shooting.rollout import ShootingError, rollout
from models.contact_law import ContactLaw, RelaxationError
from models.scene import Scene

LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3), (ContactLaw.SOFTPLUS, 1e-7))
# A start in contact for each scene, so that the contact's derivatives are there to be compared.
STARTS = {
    "three_cart": (2.0, 2.4, 2.8, 0.3, -0.2, 0.1), "two_link_arm": (0.3, 0.4, -0.5, 0.7), "two_body_collision": (0.0, 0.15, 1.0, -1.0),
    "bouncing_mass": (-0.05, 0.3), "oscillator": (1.0, 0.2),
}  # fmt: skip
# Two orders of summation: each step rounds differently, and 60 steps carry it on.
ROUNDING = 1e-12


def _pattern(name: str, shape: tuple[int, ...]) -> torch.Tensor:
    count = torch.arange(int(np.prod(shape)), dtype=torch.float64).reshape(shape)
    if name == "random":
        return torch.from_numpy(np.random.default_rng(5).normal(size=shape))
    return {"zeros": count * 0.0, "ones": count * 0.0 + 1.0, "0101": count % 2, "0123": count / max(1, count.numel())}[name]


def _gradients(function, scene: Scene, start: torch.Tensor, u: torch.Tensor, law: ContactLaw, eps: float | None):
    """Values, and gradients of a loss that weighs every value differently."""
    u, start = u.clone().requires_grad_(), start.clone().requires_grad_()
    values = function(scene, u, start, step=0.005, law=law, eps=eps)[:3]
    loss = sum((value * torch.cos(torch.arange(value.numel(), dtype=torch.float64)).reshape(value.shape)).sum() for value in values)
    # A scene without inputs has a gradient of no entries, which autograd calls unused.
    bars = torch.autograd.grad(loss, (u, start), allow_unused=True)
    return [value.detach() for value in values], [
        torch.zeros_like(point) if bar is None else bar for bar, point in zip(bars, (u, start), strict=True)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("pattern", ["zeros", "ones", "0101", "0123", "random"])
@pytest.mark.parametrize("name", STARTS)
@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_values_and_gradients_are_those_of_plain_pytorch(name: str, pattern: str, law: ContactLaw, eps: float | None):
    scene = example_scene(name)
    start, u = torch.tensor(STARTS[name], dtype=torch.float64), _pattern(pattern, (60, scene.nu))
    found, expected = _gradients(rollout, scene, start, u, law, eps), _gradients(reference_rollout, scene, start, u, law, eps)
    assert not scene.nc or expected[0][2].max() > 0.0
    for left, right in zip((*found[0], *found[1]), (*expected[0], *expected[1]), strict=True):
        assert left.shape == right.shape
        assert left.numel() == 0 or (left - right).abs().max() <= ROUNDING * right.abs().max()


@pytest.mark.parametrize("name", ["three_cart", "two_link_arm"])
@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_gradients_are_finite_differences(name: str, law: ContactLaw, eps: float | None):
    """PyTorch's own check, of every output with respect to every entry of u and start."""
    scene = example_scene(name)
    u = _pattern("random", (6, scene.nu)).requires_grad_()
    start = torch.tensor(STARTS[name], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda u, start: rollout(scene, u, start, step=0.005, law=law, eps=eps), (u, start))


def test_composes_with_a_loss_of_ones_own():
    """Through operations before and after it, with the running cost, and with the scene's own start and step."""
    scene = example_scene("three_cart")
    knots = torch.full((50, 2), 0.5, dtype=torch.float64, requires_grad=True)
    plan = rollout(scene, torch.repeat_interleave(knots, 10, dim=0).tanh())
    loss = plan.q[:, 1].amax() + plan.lam.exp().mean() + 1e-3 * plan.cost
    loss.backward()
    assert knots.grad.abs().min() > 0.0

    u = torch.full((500, 2), 0.5, dtype=torch.float64).tanh()
    assert plan.cost.item() == pytest.approx(u.square().sum().item(), rel=1e-13)
    moved = knots.detach().clone()
    values = []
    for sign in (1.0, -1.0):
        moved[3, 0] = 0.5 + sign * 1e-6
        again = rollout(scene, torch.repeat_interleave(moved, 10, dim=0).tanh())
        values.append((again.q[:, 1].amax() + again.lam.exp().mean() + 1e-3 * again.cost).item())
    assert knots.grad[3, 0].item() == pytest.approx((values[0] - values[1]) / 2e-6, rel=1e-5)


def test_gradients_only_where_asked():
    scene = example_scene("three_cart")
    u, start = torch.zeros(5, 2, dtype=torch.float64), torch.tensor(scene.task.start, dtype=torch.float64)
    assert not any(part.requires_grad for part in rollout(scene, u, start))
    rollout(scene, u, start.requires_grad_()).q.sum().backward()
    assert start.grad is not None
    assert u.grad is None


def test_is_differentiable_once_and_says_so():
    scene = example_scene("three_cart")
    u = torch.ones(5, 2, dtype=torch.float64, requires_grad=True)
    loss = rollout(scene, u, torch.tensor(STARTS["three_cart"], dtype=torch.float64)).q.square().sum()
    (gradient,) = torch.autograd.grad(loss, u, create_graph=True)
    assert gradient.abs().max() > 0.0  # asking for a graph alone is no mistake
    with pytest.raises(ShootingError, match="differentiated once"):
        gradient.sum().backward()


def test_the_reference_is_differentiable_twice():
    scene = example_scene("three_cart")
    u = torch.ones(3, 2, dtype=torch.float64, requires_grad=True)
    q, _, _ = reference_rollout(scene, u, torch.tensor(STARTS["three_cart"], dtype=torch.float64))
    loss = q.square().sum()
    (gradient,) = torch.autograd.grad(loss, u, create_graph=True)
    gradient.sum().backward()
    assert u.grad.abs().max() > 0.0


def test_outputs_changed_in_place_are_noticed():
    scene = example_scene("three_cart")
    u = torch.ones(5, 2, dtype=torch.float64, requires_grad=True)
    plan = rollout(scene, u)
    loss = plan.v.square().sum()
    with torch.no_grad():
        plan.q.mul_(2.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def test_other_types_and_devices_are_refused_in_words():
    scene = example_scene("three_cart")
    u = torch.zeros(5, 2, dtype=torch.float64)
    with pytest.raises(ShootingError, match=r"u is torch\.float32.*pass u\.double\(\)"):
        rollout(scene, u.float())
    with pytest.raises(ShootingError, match=r"start is torch\.float32"):
        rollout(scene, u, torch.zeros(6))
    with pytest.raises(ShootingError, match=r"u is .* on meta, start .* on cpu; pass start\.to"):
        rollout(scene, u.to("meta"), torch.tensor(scene.task.start, dtype=torch.float64))
    with pytest.raises(ShootingError, match=r"u is on meta, .*friction.*pass u\.cpu\(\)"):
        rollout(example_scene("hopper_planar"), torch.zeros(5, example_scene("hopper_planar").nu, device="meta"))
    with pytest.raises(ShootingError, match=r"u is a ndarray"):
        rollout(scene, u.numpy())  # pyright: ignore[reportArgumentType]
    with pytest.raises(ShootingError, match=r"last dimensions of u and start are 1 and 6.*2 inputs and 6"):
        rollout(scene, u[:, :1])
    with pytest.raises(ShootingError, match="u has 1 dimensions, but needs 2"):
        rollout(scene, u[0])
    with pytest.raises(RelaxationError, match="eps is 2"):
        rollout(scene, u, law=ContactLaw.SOFTPLUS, eps=2.0)


def test_float32_inputs_may_be_converted_in_the_open():
    scene = example_scene("three_cart")
    u = torch.ones(5, 2, requires_grad=True)
    rollout(scene, u.double()).q.sum().backward()
    assert u.grad.dtype == torch.float32


def test_a_strided_tensor_is_read_in_its_own_order():
    scene = example_scene("three_cart")
    u = _pattern("random", (2, 30))
    assert torch.equal(rollout(scene, u.T).q, rollout(scene, u.T.contiguous()).q)

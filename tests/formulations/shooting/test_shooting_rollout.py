"""The compiled rollout as a PyTorch function, of one plan and of several at once: against the plain PyTorch reference, with dry friction too, finite differences, and misuse."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from example_scenes import example_scene

from formulations.grids import input_bounds
from formulations.shooting.descent import descend, projected_descent
from formulations.shooting.objective import GoalLoss, Objective
from formulations.shooting.options import DescentOptions
from formulations.shooting.reference import reference_cost, reference_rollout
from formulations.shooting.rollout import RolloutTensors, ShootingError, rollout
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw, RelaxationError
from models.scene import Scene
from models.scenes._fingers import pinch
from models.scenes.two_finger_lift import HEIGHT

LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3), (ContactLaw.SOFTPLUS, 1e-7))
# A start in contact for each scene, so that the contact's derivatives are there to be compared.
STARTS = {
    "three_cart": (2.0, 2.4, 2.8, 0.3, -0.2, 0.1), "two_link_arm": (0.3, 0.4, -0.5, 0.7),
    "two_body_collision": (0.0, 0.15, 1.0, -1.0),
    "bouncing_mass": (-0.05, 0.3), "oscillator": (1.0, 0.2),
}  # fmt: skip
# Two orders of summation: each step rounds differently, and 60 steps carry it on.
ROUNDING = 1e-12


def _pattern(name: str, shape: tuple[int, ...]) -> torch.Tensor:
    count = torch.arange(int(np.prod(shape)), dtype=torch.float64).reshape(shape)
    if name == "random":
        return torch.from_numpy(np.random.default_rng(5).normal(size=shape))
    return {
        "zeros": count * 0.0,
        "ones": count * 0.0 + 1.0,
        "0101": count % 2,
        "0123": count / max(1, count.numel()),
    }[name]


def _gradients(
    function, scene: Scene, start: torch.Tensor, u: torch.Tensor, law: ContactLaw, eps: float | None
):
    """Values, and gradients of a loss that weighs every value differently."""
    u, start = u.clone().requires_grad_(), start.clone().requires_grad_()
    values = function(scene, u, start, step=0.005, law=law, eps=eps)[:3]
    loss = sum(
        (
            value * torch.cos(torch.arange(value.numel(), dtype=torch.float64)).reshape(value.shape)
        ).sum()
        for value in values
    )
    # A scene without inputs has a gradient of no entries, which autograd calls unused.
    bars = torch.autograd.grad(loss, (u, start), allow_unused=True)
    return [value.detach() for value in values], [
        torch.zeros_like(point) if bar is None else bar
        for bar, point in zip(bars, (u, start), strict=True)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("pattern", ["zeros", "ones", "0101", "0123", "random"])
@pytest.mark.parametrize("name", STARTS)
@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_values_and_gradients_are_those_of_plain_pytorch(
    name: str, pattern: str, law: ContactLaw, eps: float | None
):
    scene = example_scene(name)
    start, u = torch.tensor(STARTS[name], dtype=torch.float64), _pattern(pattern, (60, scene.nu))
    found, expected = (
        _gradients(rollout, scene, start, u, law, eps),
        _gradients(reference_rollout, scene, start, u, law, eps),
    )
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
    assert torch.autograd.gradcheck(
        lambda u, start: rollout(scene, u, start, step=0.005, law=law, eps=eps), (u, start)
    )


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
    u, start = (
        torch.zeros(5, 2, dtype=torch.float64),
        torch.tensor(scene.task.start, dtype=torch.float64),
    )
    assert not any(part.requires_grad for part in rollout(scene, u, start))
    rollout(scene, u, start.requires_grad_()).q.sum().backward()
    assert start.grad is not None
    assert u.grad is None


def test_is_differentiable_once_and_says_so():
    scene = example_scene("three_cart")
    u = torch.ones(5, 2, dtype=torch.float64, requires_grad=True)
    loss = (
        rollout(scene, u, torch.tensor(STARTS["three_cart"], dtype=torch.float64)).q.square().sum()
    )
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
        rollout(
            example_scene("hopper_planar"),
            torch.zeros(5, example_scene("hopper_planar").nu, device="meta"),
        )
    with pytest.raises(ShootingError, match=r"u is a ndarray"):
        rollout(scene, u.numpy())  # pyright: ignore[reportArgumentType]
    with pytest.raises(
        ShootingError, match=r"last dimensions of u and start are 1 and 6.*2 inputs and 6"
    ):
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


# With a mass matrix that turns, friction, damped contacts, a final cost, and the paper's.
FRICTIONLESS = " without friction"
NAMES = ("two_link_arm", "hopper_planar", "damped_arm", "three_cart")
PLAIN = ("two_link_arm", f"damped_arm{FRICTIONLESS}", "three_cart")
STEPS = 12
# Two orders of summation, carried on over the steps.
CLOSE = 1e-11


def scene_of(name: str) -> Scene:
    scene = example_scene(name.removesuffix(FRICTIONLESS))
    return replace(scene, frictions=()) if name.endswith(FRICTIONLESS) else scene


def _plans(scene: Scene, *rows: int) -> tuple[torch.Tensor, torch.Tensor]:
    """u (*rows, steps, nu) and starts (*rows, 2*nq) about the scene's own."""
    random = np.random.default_rng(3)
    u = torch.from_numpy(random.normal(size=(*rows, STEPS, scene.nu)))
    start = torch.from_numpy(
        np.array(scene.task.start) + 0.05 * random.normal(size=(*rows, 2 * scene.nq))
    )
    return u.requires_grad_(), start.requires_grad_()


def _weighed(plan: RolloutTensors) -> torch.Tensor:
    """A loss (..) of each plan that weighs all of its figures differently."""
    parts = [tensor.flatten(-2) for tensor in plan[:3]]
    return sum(
        ((part * torch.cos(torch.arange(part.shape[-1]))).sum(-1) for part in (*parts, plan.end)),
        0.3 * plan.cost,
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("law", "eps"), LAWS[:2])
def test_each_row_is_that_of_a_plan_alone(name: str, law: ContactLaw, eps: float | None):
    scene = scene_of(name)
    u, start = _plans(scene, 5)
    together = rollout(scene, u, start, law=law, eps=eps)
    u_bar, start_bar = torch.autograd.grad(_weighed(together).square().sum(), (u, start))
    for row in range(5):
        alone = rollout(scene, u[row], start[row], law=law, eps=eps)
        for found, expected in zip(together, alone, strict=True):
            assert torch.equal(found[row], expected)
        bars = torch.autograd.grad(_weighed(alone).square(), (u, start))
        assert torch.equal(u_bar[row], bars[0][row])
        assert torch.equal(start_bar[row], bars[1][row])


def test_leading_dimensions_are_broadcast():
    scene = scene_of("three_cart")
    u, start = _plans(scene, 2, 3)
    grid = rollout(scene, u, start[:, :1])
    assert grid.q.shape == (2, 3, STEPS + 1, 3)
    assert grid.cost.shape == (2, 3)
    assert torch.equal(grid.q[1, 2], rollout(scene, u[1, 2], start[1, 0]).q)
    one = u[0, 0]
    (bar,) = torch.autograd.grad(rollout(scene, one, start[0]).v.sum(), one)
    singles = [
        torch.autograd.grad(rollout(scene, one, start[0, row]).v.sum(), one)[0] for row in range(3)
    ]
    assert torch.allclose(bar, singles[0] + singles[1] + singles[2], rtol=1e-13, atol=0.0)
    assert rollout(scene, u[0, :0]).q.shape == (0, STEPS + 1, 3)


@pytest.mark.slow
def test_a_row_that_diverges_leaves_the_others_alone():
    scene = scene_of("two_link_arm")
    u, start = _plans(scene, 3)
    spoilt = u.detach().clone()
    spoilt[1] = 1e200
    spoilt.requires_grad_()
    plan = rollout(scene, spoilt, start)
    assert plan.cost.isnan().tolist() == [False, True, False]
    plan.q[:, -1].sum().backward()
    assert spoilt.grad.isnan().flatten(1).any(1).tolist() == [False, True, False]
    assert torch.equal(
        spoilt.grad[2], torch.autograd.grad(rollout(scene, u[2], start[2]).q[-1].sum(), u)[0][2]
    )


def test_several_plans_descend_each_by_itself():
    """One tensor of four plans, each within the bounds and as if alone."""
    scene = scene_of("three_cart")
    kernel, loss = load_kernel(scene), GoalLoss(scene.task.goal)
    u = (
        (
            6.0
            * torch.randn(
                4, 500, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
            )
        )
        .clamp(-10.0, 10.0)
        .requires_grad_()
    )
    first = u.detach().clone()
    lower, upper = (torch.from_numpy(bound) for bound in input_bounds(scene))
    steps = projected_descent(lambda u: loss(rollout(kernel, u), u), u, 5e3, lower, upper)
    losses = [next(steps) for _ in range(11)]
    assert losses[-1].shape == (4,)
    assert u.abs().max() == 10.0
    for row in range(4):
        alone = descend(
            Objective(kernel, law=ContactLaw.RELU),
            first[row].numpy(),
            DescentOptions(learning_rate=5e3, iterations=10),
            60.0,
        )
        assert losses[-1][row].item() == pytest.approx(alone.history["loss"][-1], rel=1e-10)
        assert np.abs(u[row].detach().numpy() - alone.u).max() <= 1e-10


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_the_same_loop_runs_on_a_device(dtype: torch.dtype):
    scene = scene_of("three_cart").with_task(steps=60)
    kernel, loss = load_kernel(scene), GoalLoss(scene.task.goal)
    first = torch.randn(16, 60, 2, dtype=dtype, generator=torch.Generator().manual_seed(0))
    found = []
    for device in ("cuda", "cpu"):
        u = (first if device == "cuda" else first.double()).to(device).requires_grad_()
        bounds = [torch.as_tensor(bound).to(u) for bound in input_bounds(scene)]
        steps = projected_descent(lambda u: loss(rollout(kernel, u), u), u, 50.0, *bounds)
        for _ in range(6):
            value = next(steps)
        assert value.device.type == device
        found.append((value.double().cpu(), u.detach().double().cpu()))
    for one, other in zip(*found, strict=True):
        assert torch.allclose(
            one,
            other,
            rtol=1e-10 if dtype == torch.float64 else 1e-3,
            atol=1e-10 if dtype == torch.float64 else 1e-3,
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", PLAIN)
@pytest.mark.parametrize(("law", "eps"), LAWS[:2])
def test_the_rollout_of_other_devices_is_the_compiled_one(
    name: str, law: ContactLaw, eps: float | None
):
    """Run where its values can be seen: on the CPU."""
    scene = scene_of(name)
    u, start = _plans(scene, 4)
    q, v, lam = reference_rollout(scene, u, start, law=law, eps=eps)
    plain, compiled = (
        RolloutTensors(
            q, v, lam, reference_cost(scene, q, v, u), torch.cat([q[..., -1, :], v[..., -1, :]], -1)
        ),
        rollout(scene, u, start, law=law, eps=eps),
    )
    gradients = [
        torch.autograd.grad(_weighed(plan).sum(), (u, start)) for plan in (plain, compiled)
    ]
    for found, expected in zip((*plain, *gradients[0]), (*compiled, *gradients[1]), strict=True):
        assert found.shape == expected.shape
        assert (found - expected).abs().max() <= CLOSE * expected.abs().max().clamp(min=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "dtype"), [*((name, torch.float64) for name in PLAIN), ("three_cart", torch.float32)]
)
def test_tensors_of_another_device_stay_there(name: str, dtype: torch.dtype):
    """PyTorch's device without memory: an operation that leaves it, or mixes devices, raises."""
    scene = scene_of(name)
    u = torch.zeros(7, STEPS, scene.nu, dtype=dtype, device="meta", requires_grad=True)
    for law, eps in LAWS[:2]:
        plan = rollout(scene, u, law=law, eps=eps)
        assert [tensor.shape for tensor in plan] == [(7, STEPS + 1, scene.nq)] * 2 + [
            (7, STEPS, scene.nc),
            (7,),
            (7, 2 * scene.nq),
        ]
        assert {(tensor.device.type, tensor.dtype) for tensor in plan} == {("meta", dtype)}
        (bar,) = torch.autograd.grad(plan.q[:, -1].square().sum() + plan.cost.sum(), u)
        assert (bar.shape, bar.device.type) == (u.shape, "meta")


# Starts that press, with bodies that slip or are about to.
PRESSED = {
    "transport": (0.2, 0.0, 0.4, 0.0),
    "hopper_planar": (0.1, 0.9, 0.05, 0.0, -0.02, 0.4, -0.3, 0.2, 0.3, -0.5),
}


def start_of(name: str) -> torch.Tensor:
    if name in PRESSED:
        return torch.tensor(PRESSED[name], dtype=torch.float64)
    start = np.array(example_scene(name).task.start)
    start[:4] = pinch(-0.004, HEIGHT)  # the tips 4 mm in the disc: both frictions act
    start[12] = 0.05  # the disc moves up along them [m/s]
    return torch.from_numpy(start)


def gradients(
    function, scene: Scene, start: torch.Tensor, u: torch.Tensor, law: ContactLaw, eps: float | None
):
    u, start = u.clone().requires_grad_(), start.clone().requires_grad_()
    values = function(scene, u, start, law=law, eps=eps)[:3]
    loss = sum(
        (
            value * torch.cos(torch.arange(value.numel(), dtype=torch.float64)).reshape(value.shape)
        ).sum()
        for value in values
    )
    return [value.detach() for value in values], torch.autograd.grad(loss, (u, start))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "law", "eps"), [
    ("transport", ContactLaw.RELU, None), ("transport", ContactLaw.SOFTPLUS, 1e-3),
    ("hopper_planar", ContactLaw.RELU, None),
    ("hopper_planar", ContactLaw.SOFTPLUS, 1e-3), ("two_finger_lift", ContactLaw.RELU, None),
    ("two_finger_lift", ContactLaw.SOFTPLUS, 1e-3),
])  # fmt: skip
def test_values_and_gradients_are_those_of_the_compiled_rollout(
    name: str, law: ContactLaw, eps: float | None
):
    scene = example_scene(name)
    u = torch.from_numpy(np.random.default_rng(5).uniform(-0.5, 0.5, size=(8, scene.nu)))
    found = gradients(rollout, scene, start_of(name), u, law, eps)
    expected = gradients(reference_rollout, scene, start_of(name), u, law, eps)
    assert expected[0][2].shape == (8, scene.nl)
    assert expected[0][2][:, scene.nc :].abs().max() > 1e-3, "friction acts"
    for left, right in zip((*found[0], *found[1]), (*expected[0], *expected[1]), strict=True):
        assert (left - right).abs().max() <= 1e-9 * max(1.0, float(right.abs().max()))


def test_plans_at_once_are_those_one_by_one():
    scene = example_scene("transport")
    u = torch.from_numpy(np.random.default_rng(6).uniform(-5.0, 5.0, size=(3, 12, 1)))
    start = start_of("transport")
    together = reference_rollout(scene, u, start)
    for index in range(3):
        for many, one in zip(together, reference_rollout(scene, u[index], start), strict=True):
            assert torch.equal(many[index], one)

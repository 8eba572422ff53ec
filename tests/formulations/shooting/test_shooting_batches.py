"""Several plans at once: each row as if it were alone, on the CPU compiled, on another device in PyTorch operations."""

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
from formulations.shooting.rollout import RolloutTensors, rollout
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.scene import Scene

# With a mass matrix that turns, friction, damped contacts, a final cost, and the paper's.
FRICTIONLESS = " without friction"
NAMES = ("two_link_arm", "hopper_planar", "damped_arm", "three_cart")
PLAIN = ("two_link_arm", f"damped_arm{FRICTIONLESS}", "three_cart")
LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3))
STEPS = 12
# Two orders of summation, carried on over the steps.
ROUNDING = 1e-11


def scene_of(name: str) -> Scene:
    scene = example_scene(name.removesuffix(FRICTIONLESS))
    return replace(scene, frictions=()) if name.endswith(FRICTIONLESS) else scene


def _plans(scene: Scene, *rows: int) -> tuple[torch.Tensor, torch.Tensor]:
    """u (*rows, steps, nu) and starts (*rows, 2*nq) about the scene's own."""
    random = np.random.default_rng(3)
    u = torch.from_numpy(random.normal(size=(*rows, STEPS, scene.nu)))
    start = torch.from_numpy(np.array(scene.task.start) + 0.05 * random.normal(size=(*rows, 2 * scene.nq)))
    return u.requires_grad_(), start.requires_grad_()


def _weighed(plan: RolloutTensors) -> torch.Tensor:
    """A loss (..) of each plan that weighs all of its figures differently."""
    parts = [tensor.flatten(-2) for tensor in plan[:3]]
    return sum(((part * torch.cos(torch.arange(part.shape[-1]))).sum(-1) for part in (*parts, plan.end)), 0.3 * plan.cost)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("law", "eps"), LAWS)
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
    singles = [torch.autograd.grad(rollout(scene, one, start[0, row]).v.sum(), one)[0] for row in range(3)]
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
    assert torch.equal(spoilt.grad[2], torch.autograd.grad(rollout(scene, u[2], start[2]).q[-1].sum(), u)[0][2])


def test_several_plans_descend_each_by_itself():
    """One tensor of four plans, each within the bounds and as if alone."""
    scene = scene_of("three_cart")
    kernel, loss = load_kernel(scene), GoalLoss(scene.task.goal)
    u = (6.0 * torch.randn(4, 500, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))).clamp(-10.0, 10.0).requires_grad_()
    first = u.detach().clone()
    lower, upper = (torch.from_numpy(bound) for bound in input_bounds(scene))
    steps = projected_descent(lambda u: loss(rollout(kernel, u), u), u, 5e3, lower, upper)
    losses = [next(steps) for _ in range(11)]
    assert losses[-1].shape == (4,)
    assert u.abs().max() == 10.0
    for row in range(4):
        alone = descend(Objective(kernel, law=ContactLaw.RELU), first[row].numpy(), DescentOptions(learning_rate=5e3, iterations=10), 60.0)
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
        assert torch.allclose(one, other, rtol=1e-10 if dtype == torch.float64 else 1e-3, atol=1e-10 if dtype == torch.float64 else 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLAIN)
@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_the_rollout_of_other_devices_is_the_compiled_one(name: str, law: ContactLaw, eps: float | None):
    """Run where its values can be seen: on the CPU."""
    scene = scene_of(name)
    u, start = _plans(scene, 4)
    q, v, lam = reference_rollout(scene, u, start, law=law, eps=eps)
    plain, compiled = (
        RolloutTensors(q, v, lam, reference_cost(scene, q, v, u), torch.cat([q[..., -1, :], v[..., -1, :]], -1)),
        rollout(scene, u, start, law=law, eps=eps),
    )
    gradients = [torch.autograd.grad(_weighed(plan).sum(), (u, start)) for plan in (plain, compiled)]
    for found, expected in zip((*plain, *gradients[0]), (*compiled, *gradients[1]), strict=True):
        assert found.shape == expected.shape
        assert (found - expected).abs().max() <= ROUNDING * expected.abs().max().clamp(min=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "dtype"), [*((name, torch.float64) for name in PLAIN), ("three_cart", torch.float32)])
def test_tensors_of_another_device_stay_there(name: str, dtype: torch.dtype):
    """PyTorch's device without memory: an operation that leaves it, or mixes devices, raises."""
    scene = scene_of(name)
    u = torch.zeros(7, STEPS, scene.nu, dtype=dtype, device="meta", requires_grad=True)
    for law, eps in LAWS:
        plan = rollout(scene, u, law=law, eps=eps)
        assert [tensor.shape for tensor in plan] == [(7, STEPS + 1, scene.nq)] * 2 + [(7, STEPS, scene.nc), (7,), (7, 2 * scene.nq)]
        assert {(tensor.device.type, tensor.dtype) for tensor in plan} == {("meta", dtype)}
        (bar,) = torch.autograd.grad(plan.q[:, -1].square().sum() + plan.cost.sum(), u)
        assert (bar.shape, bar.device.type) == (u.shape, "meta")

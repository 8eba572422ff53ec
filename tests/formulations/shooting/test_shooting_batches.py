"""Several plans at once: each row as if it were alone, on the CPU compiled, on another device in PyTorch operations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from formulations.shooting.errors import ShootingError
from formulations.shooting.objective import Objective, Weights
from formulations.shooting.reference import reference_cost, reference_rollout
from formulations.shooting.rollout import RolloutTensors, plan_loss, rollout
from models.catalog import load_scene, scene_names
from models.codegen.batch import adjoints, rollouts
from models.codegen.kernel import KernelError, load_kernel
from models.contact_law import ContactLaw
from models.scene import Scene

SCENES = Path(__file__).parents[2] / "scenes"
# With a mass matrix that turns, friction, damped contacts, a final cost, and the paper's.
FRICTIONLESS = " without friction"
NAMES = ("two_link_arm", "hopper_planar", "damped_arm", "three_cart")
PLAIN = ("two_link_arm", f"damped_arm{FRICTIONLESS}", "three_cart")
LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3))
STEPS = 12
# Two orders of summation, carried on over the steps.
ROUNDING = 1e-11


def scene_of(name: str) -> Scene:
    scene = load_scene(name if name in scene_names() else str(SCENES / f"{name.removesuffix(FRICTIONLESS)}.py"))
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
    return sum(((part * torch.cos(torch.arange(part.shape[-1]))).sum(-1) for part in parts), 0.3 * plan.cost)


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


def test_a_row_that_diverges_leaves_the_others_alone():
    scene = scene_of("two_link_arm")
    u, start = _plans(scene, 3)
    spoilt = u.detach().clone()
    spoilt[1] = 1e200
    spoilt.requires_grad_()
    plan = rollout(scene, spoilt, start)
    assert plan.cost.isnan().tolist() == [False, True, False]
    plan.q[:, -1].sum().backward()
    assert spoilt.grad is not None
    assert spoilt.grad.isnan().flatten(1).any(1).tolist() == [False, True, False]
    assert torch.equal(spoilt.grad[2], torch.autograd.grad(rollout(scene, u[2], start[2]).q[-1].sum(), u)[0][2])


def test_second_derivatives_of_several_plans_are_refused():
    scene = scene_of("three_cart")
    u, start = _plans(scene, 2)
    (gradient,) = torch.autograd.grad(rollout(scene, u, start).q.square().sum(), u, create_graph=True)
    with pytest.raises(ShootingError, match="differentiated once"):
        gradient.sum().backward()


def test_descent_from_several_starts_in_a_loop_of_ones_own():
    """PyTorch's own optimizer on a sum over plans moves each of them as a descent of its own."""
    scene = scene_of("three_cart")
    kernel, goal = load_kernel(scene), torch.tensor(scene.task.goal, dtype=torch.float64)
    u = (0.5 * torch.randn(4, 500, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))).requires_grad_()
    first = u.detach().clone()
    optimizer = torch.optim.SGD([u], lr=500.0)
    for _ in range(10):
        optimizer.zero_grad()
        loss = plan_loss(rollout(kernel, u), goal, Weights())
        loss.sum().backward()
        optimizer.step()
    objective, values = Objective(kernel, law=ContactLaw.RELU), first[2].numpy().copy()
    for _ in range(10):
        value = objective.value(values)
        values -= 500.0 * objective.gradient()
    assert loss[2].item() == pytest.approx(value, rel=1e-12)
    assert np.abs(u[2].detach().numpy() - values).max() <= 1e-12 * np.abs(values).max()


@pytest.mark.parametrize("name", PLAIN)
@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_the_rollout_of_other_devices_is_the_compiled_one(name: str, law: ContactLaw, eps: float | None):
    """Run where its values can be seen: on the CPU."""
    scene = scene_of(name)
    u, start = _plans(scene, 4)
    q, v, lam = reference_rollout(scene, u, start, law=law, eps=eps)
    plain, compiled = RolloutTensors(q, v, lam, reference_cost(scene, q, v, u)), rollout(scene, u, start, law=law, eps=eps)
    gradients = [torch.autograd.grad(_weighed(plan).sum(), (u, start)) for plan in (plain, compiled)]
    for found, expected in zip((*plain, *gradients[0]), (*compiled, *gradients[1]), strict=True):
        assert found.shape == expected.shape
        assert (found - expected).abs().max() <= ROUNDING * expected.abs().max().clamp(min=1e-6)


@pytest.mark.parametrize(("name", "dtype"), [*((name, torch.float64) for name in PLAIN), ("three_cart", torch.float32)])
def test_tensors_of_another_device_stay_there(name: str, dtype: torch.dtype):
    """PyTorch's device without memory: an operation that leaves it, or mixes devices, raises."""
    scene = scene_of(name)
    u = torch.zeros(7, STEPS, scene.nu, dtype=dtype, device="meta", requires_grad=True)
    for law, eps in LAWS:
        plan = rollout(scene, u, law=law, eps=eps)
        assert [tensor.shape for tensor in plan] == [(7, STEPS + 1, scene.nq)] * 2 + [(7, STEPS, scene.nc), (7,)]
        assert {(tensor.device.type, tensor.dtype) for tensor in plan} == {("meta", dtype)}
        (bar,) = torch.autograd.grad(plan.q[:, -1].square().sum() + plan.cost.sum(), u)
        assert (bar.shape, bar.device.type) == (u.shape, "meta")


def test_rows_of_the_kernel_itself():
    """The numpy functions behind it: values and gradients of `Kernel`, and shapes that do not fit."""
    scene = scene_of("three_cart")
    kernel = load_kernel(scene)
    u, start = (tensor.detach().numpy() for tensor in _plans(scene, 3))
    found = rollouts(kernel, start, u, 0.01)
    bars = (np.cos(found.q), np.sin(found.v), np.cos(found.lam), np.array([1.0, 0.0, -2.0]))
    u_bar, start_bar = adjoints(kernel, found, u, *bars)
    for row in range(3):
        alone = kernel.rollout(start[row], u[row], 0.01)
        assert (found.q[row] == alone.q).all()
        assert found.cost[row] == kernel.cost(alone.q, alone.v, u[row])
        expected = kernel.adjoint(alone, u[row], *(bar[row] for bar in bars[:3]), cost_bar=float(bars[3][row]))
        assert (u_bar[row] == expected[0]).all()
        assert (start_bar[row] == expected[1]).all()
    for arguments, words in (((start, u[:, :, :1]), "u has shape"), ((start[:2], u), "start has shape"), ((start, u[0]), "u has shape")):
        with pytest.raises(KernelError, match=words):
            rollouts(kernel, *arguments, 0.01)

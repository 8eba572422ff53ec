"""The loss: the paper's formula, the fast function of it against PyTorch operations, and its rules of use."""

import numpy as np
import pytest
import torch

from formulations.shooting.errors import ShootingError
from formulations.shooting.objective import Objective, Weights, plan_loss
from formulations.shooting.rollout import rollout
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw

SCENE = load_scene("three_cart")
KERNEL = load_kernel(SCENE)
LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-5))


def _inputs(seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(500, 2))).requires_grad_()


def test_loss_at_rest_is_the_papers_formula():
    """No input, no contact: each position misses by 0.5, each velocity by nothing: mean = 3 * 0.25 / 6."""
    assert Objective(KERNEL, law=ContactLaw.RELU)(torch.zeros(500, 2, dtype=torch.float64)).item() == 0.125


@pytest.mark.parametrize(("law", "eps"), LAWS)
@pytest.mark.parametrize("weights", [Weights(), Weights(terminal=3.0, running=1e-3), Weights(running=0.0)])
def test_fast_loss_is_the_formula_in_pytorch_operations(law: ContactLaw, eps: float | None, weights: Weights):
    objective = Objective(KERNEL, law=law, eps=eps, weights=weights)
    fast, slow = _inputs(), _inputs()
    loss = objective(fast)
    loss.backward()
    plan = rollout(KERNEL, slow, law=law, eps=eps)
    expected = plan_loss(plan, torch.tensor(SCENE.task.goal, dtype=torch.float64), weights)
    expected.backward()
    assert loss.item() == pytest.approx(expected.item(), rel=1e-14)
    assert fast.grad is not None
    assert slow.grad is not None
    assert (fast.grad - slow.grad).abs().max() <= 1e-13 * slow.grad.abs().max()
    assert objective.cost == plan.cost.item()
    assert objective.terminal_error == pytest.approx(torch.cat([plan.q[-1], plan.v[-1]]).sub(torch.tensor(SCENE.task.goal)).norm().item())


def test_gradients_handed_out_are_not_overwritten_by_the_next_evaluation():
    objective = Objective(KERNEL, law=ContactLaw.RELU)
    u = _inputs()
    (first,) = torch.autograd.grad(objective(u), u)
    kept = first.clone()
    objective(_inputs(1)).backward()
    assert torch.equal(first, kept)


def test_a_loss_evaluated_twice_before_its_backward_is_refused():
    objective = Objective(KERNEL, law=ContactLaw.RELU)
    u = _inputs()
    loss = objective(u)
    objective(_inputs(1))
    with pytest.raises(ShootingError, match="evaluated again before its backward"):
        loss.backward()


def test_second_derivatives_are_refused():
    u = _inputs()
    (gradient,) = torch.autograd.grad(Objective(KERNEL, law=ContactLaw.RELU)(u), u, create_graph=True)
    with pytest.raises(ShootingError, match="differentiated once"):
        gradient.sum().backward()


def test_factor_before_the_loss_scales_the_gradient():
    objective = Objective(KERNEL, law=ContactLaw.RELU)
    one, ten = _inputs(), _inputs()
    objective(one).backward()
    (10.0 * objective(ten)).backward()
    assert one.grad is not None
    assert ten.grad is not None
    assert torch.allclose(10.0 * one.grad, ten.grad, rtol=1e-15, atol=0.0)


def test_divergence_is_an_infinite_loss_with_nan_gradients():
    objective = Objective(KERNEL, law=ContactLaw.RELU)
    u = torch.full((500, 2), 1e308, dtype=torch.float64, requires_grad=True)
    loss = objective(u)
    loss.backward()
    assert loss.item() == np.inf
    assert not objective.finite
    assert u.grad is not None
    assert u.grad.isnan().all()

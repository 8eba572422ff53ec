"""The loss: the paper's formula, and the fast function of it against PyTorch operations."""

import numpy as np
import pytest
import torch

from formulations.shooting.objective import Objective, Weights
from formulations.shooting.rollout import plan_loss, rollout
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
    assert Objective(KERNEL, law=ContactLaw.RELU).value(np.zeros((500, 2))) == 0.125


@pytest.mark.parametrize(("law", "eps"), LAWS)
@pytest.mark.parametrize("weights", [Weights(), Weights(terminal=3.0, running=1e-3), Weights(running=0.0)])
def test_fast_loss_is_the_formula_in_pytorch_operations(law: ContactLaw, eps: float | None, weights: Weights):
    objective = Objective(KERNEL, law=law, eps=eps, weights=weights)
    slow = _inputs()
    loss = objective.value(slow.detach().numpy())
    gradient = torch.from_numpy(objective.gradient())
    plan = rollout(KERNEL, slow, law=law, eps=eps)
    expected = plan_loss(plan, torch.tensor(SCENE.task.goal, dtype=torch.float64), weights)
    expected.backward()
    assert loss == pytest.approx(expected.item(), rel=1e-14)
    assert slow.grad is not None
    assert (gradient - slow.grad).abs().max() <= 1e-13 * slow.grad.abs().max()
    assert objective.cost == plan.cost.item()
    assert objective.terminal_error == pytest.approx(torch.cat([plan.q[-1], plan.v[-1]]).sub(torch.tensor(SCENE.task.goal)).norm().item())


def test_divergence_is_an_infinite_loss():
    objective = Objective(KERNEL, law=ContactLaw.RELU)
    assert objective.value(np.full((500, 2), 1e308)) == np.inf
    assert not objective.finite
    assert np.isnan(objective.terminal_error)

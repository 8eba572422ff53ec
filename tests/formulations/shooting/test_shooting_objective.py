"""The loss: the paper's formula, one's own, and its mean over random inputs."""

import numpy as np
import pytest
import torch

from formulations.shooting.objective import GoalLoss, Objective, Weights, noise
from formulations.shooting.reference import reference_cost, reference_rollout
from formulations.shooting.rollout import RolloutTensors, ShootingError, rollout
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
def test_loss_and_gradient_are_those_of_the_formula_in_plain_pytorch(law: ContactLaw, eps: float | None, weights: Weights):
    """Written once more, on a rollout that shares nothing with the compiled one but the equations."""
    objective, u = Objective(KERNEL, law=law, eps=eps, weights=weights), _inputs()
    loss, gradient = objective.value(u.detach().numpy()), torch.from_numpy(objective.gradient())
    goal = torch.tensor(SCENE.task.goal, dtype=torch.float64)
    q, v, _ = reference_rollout(SCENE, u, torch.tensor(SCENE.task.start, dtype=torch.float64), law=law, eps=eps)
    error = torch.cat([q[-1], v[-1]]) - goal
    expected = weights.terminal * error.square().mean() + weights.running * reference_cost(SCENE, q, v, u)
    expected.backward()
    assert loss == pytest.approx(expected.item(), rel=1e-12)
    assert (gradient - u.grad).abs().max() <= 1e-11 * u.grad.abs().max()
    assert objective.cost == pytest.approx(u.square().sum().item(), rel=1e-13)
    assert objective.terminal_error == pytest.approx(error.norm().item(), rel=1e-10)


def test_free_components_of_the_goal_cost_nothing():
    free = (None, *SCENE.task.goal[1:])
    objective, whole, u = (
        Objective(KERNEL, law=ContactLaw.RELU, goal=free),
        Objective(KERNEL, law=ContactLaw.RELU),
        _inputs().detach().numpy(),
    )
    whole.value(u)
    assert objective.value(u) == pytest.approx(whole.value(u) - whole.error[0] ** 2 / 6.0, rel=1e-12)
    assert objective.error[0] == 0.0
    assert np.isfinite(objective.gradient()).all()


def test_divergence_is_an_infinite_loss():
    objective = Objective(KERNEL, law=ContactLaw.RELU)
    assert objective.value(np.full((500, 2), 1e308)) == np.inf
    assert not objective.finite
    assert objective.finite_steps < 500
    assert np.isnan(objective.terminal_error)
    assert objective.value(np.zeros((500, 2))) == 0.125
    assert objective.finite
    assert objective.finite_steps == 500


def test_a_mean_over_random_inputs_is_that_of_single_evaluations():
    added = noise(SCENE, deviation=0.2, unbounded=1.0, samples=8, pieces=5, seed=3)
    smoothed, single = Objective(KERNEL, law=ContactLaw.RELU, noise=added), Objective(KERNEL, law=ContactLaw.RELU)
    u = np.cos(np.arange(1000.0)).reshape(500, 2)
    losses, gradients = [], []
    for sample in added:
        losses.append(single.value(u + sample))
        gradients.append(single.gradient())
    assert smoothed.value(u) == pytest.approx(np.mean(losses), rel=1e-14)
    mean = np.mean(gradients, axis=0)
    assert np.abs(smoothed.gradient() - mean).max() <= 1e-13 * np.abs(mean).max()
    assert single.value(u) > 0.0
    assert (smoothed.cost, smoothed.terminal_error) == (single.cost, single.terminal_error)
    assert smoothed.value(np.full_like(u, 1e308)) == np.inf


def test_a_loss_of_ones_own_replaces_the_papers():
    def effort(plan: RolloutTensors, u: torch.Tensor) -> torch.Tensor:
        return u.square().sum((-2, -1)) + plan.v[..., -1, 0]

    objective, u = Objective(KERNEL, law=ContactLaw.RELU, loss=effort), _inputs()
    assert objective.value(u.detach().numpy()) == pytest.approx((u.square().sum() + rollout(KERNEL, u).v[-1, 0]).item(), rel=1e-14)
    expected = torch.autograd.grad(effort(rollout(KERNEL, u), u), u)[0]
    assert np.abs(objective.gradient() - expected.numpy()).max() <= 1e-13
    before = objective.value(u.detach().numpy())
    objective.aim(objective.goal + 1.0, Weights(terminal=7.0))
    assert objective.value(u.detach().numpy()) == before


BAD = {
    "no tensor": (lambda plan, u: 1.0, "the loss returned a float, but must return a PyTorch tensor"),
    "no scalar": (lambda plan, u: plan.q[-1], r"shape \(3,\), but a single number is needed"),
    "no gradient": (lambda plan, u: plan.cost.detach(), "has no gradient with respect to the inputs"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_loss_that_cannot_be_descended_is_refused_in_a_sentence(case: str):
    loss, words = BAD[case]
    with pytest.raises(ShootingError, match=words):
        Objective(KERNEL, law=ContactLaw.RELU, loss=loss).value(np.zeros((500, 2)))


def test_a_loss_on_another_float_type_and_in_batches():
    """As on a device: float32, without loss of its rows."""
    plan = rollout(KERNEL, _inputs().expand(4, 500, 2))
    loss = GoalLoss(SCENE.task.goal)
    narrow = RolloutTensors(*(tensor.float() for tensor in plan))
    assert loss(narrow, narrow.q).dtype == torch.float32
    assert loss(plan, plan.q).shape == (4,)
    assert torch.allclose(loss(narrow, narrow.q).double(), loss(plan, plan.q), rtol=1e-5)

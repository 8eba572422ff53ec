"""Dry friction in plain PyTorch: the compiled rollout's values and gradients, stick, slip and regularised; alone and pressed by contacts."""

from functools import cache

import numpy as np
import pytest
import torch

from formulations.shooting.reference import reference_rollout
from formulations.shooting.rollout import rollout
from models.catalog import load_scene
from models.contact_law import ContactLaw
from models.scene import Scene
from models.scenes._fingers import pinch
from models.scenes.two_finger_lift import HEIGHT

# Starts that press, with bodies that slip or are about to.
STARTS = {
    "transport": (0.2, 0.0, 0.4, 0.0),
    "hopper_planar": (0.1, 0.9, 0.05, 0.0, -0.02, 0.4, -0.3, 0.2, 0.3, -0.5),
}


@cache
def scene_of(name: str) -> Scene:
    return load_scene(name)


def start_of(name: str) -> torch.Tensor:
    if name in STARTS:
        return torch.tensor(STARTS[name], dtype=torch.float64)
    start = np.array(scene_of(name).task.start)
    start[:4] = pinch(-0.004, HEIGHT)  # the tips 4 mm in the disc: both frictions act
    start[12] = 0.05  # the disc moves up along them [m/s]
    return torch.from_numpy(start)


def gradients(function, scene: Scene, start: torch.Tensor, u: torch.Tensor, law: ContactLaw, eps: float | None):
    u, start = u.clone().requires_grad_(), start.clone().requires_grad_()
    values = function(scene, u, start, law=law, eps=eps)[:3]
    loss = sum((value * torch.cos(torch.arange(value.numel(), dtype=torch.float64)).reshape(value.shape)).sum() for value in values)
    return [value.detach() for value in values], torch.autograd.grad(loss, (u, start))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "law", "eps"),
    [
        ("transport", ContactLaw.RELU, None), ("transport", ContactLaw.SOFTPLUS, 1e-3), ("hopper_planar", ContactLaw.RELU, None),
        ("hopper_planar", ContactLaw.SOFTPLUS, 1e-3), ("two_finger_lift", ContactLaw.RELU, None), ("two_finger_lift", ContactLaw.SOFTPLUS, 1e-3),
    ],
)  # fmt: skip
def test_values_and_gradients_are_those_of_the_compiled_rollout(name: str, law: ContactLaw, eps: float | None):
    scene = scene_of(name)
    u = torch.from_numpy(np.random.default_rng(5).uniform(-0.5, 0.5, size=(8, scene.nu)))
    found = gradients(rollout, scene, start_of(name), u, law, eps)
    expected = gradients(reference_rollout, scene, start_of(name), u, law, eps)
    assert expected[0][2].shape == (8, scene.nl)
    assert expected[0][2][:, scene.nc :].abs().max() > 1e-3, "friction acts"
    for left, right in zip((*found[0], *found[1]), (*expected[0], *expected[1]), strict=True):
        assert (left - right).abs().max() <= 1e-9 * max(1.0, float(right.abs().max()))


def test_plans_at_once_are_those_one_by_one():
    scene = scene_of("transport")
    u = torch.from_numpy(np.random.default_rng(6).uniform(-5.0, 5.0, size=(3, 12, 1)))
    start = start_of("transport")
    together = reference_rollout(scene, u, start)
    for index in range(3):
        for many, one in zip(together, reference_rollout(scene, u[index], start), strict=True):
            assert torch.equal(many[index], one)

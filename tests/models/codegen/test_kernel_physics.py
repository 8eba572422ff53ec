"""The rollout against physics: order of convergence, momentum, energy, closed forms of a collision."""

from pathlib import Path

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel

SCENES = Path(__file__).parents[2] / "scenes"


def test_semi_implicit_euler_converges_with_order_one():
    """q'' = -q against (cos t, -sin t): the slope of log error over log step is 1."""
    scene = load_scene(str(SCENES / "oscillator.py"))
    kernel = load_kernel(scene)
    horizon, steps = 2.0, np.array([100, 200, 400, 800, 1600])
    errors = []
    for count in steps:
        plan = kernel.rollout(np.array(scene.task.start), np.zeros((count, 0)), horizon / count)
        errors.append(np.hypot(plan.q[-1, 0] - np.cos(horizon), plan.v[-1, 0] + np.sin(horizon)))
    slope = np.polyfit(np.log(horizon / steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(1.0, abs=0.02)


@pytest.fixture(scope="module")
def collision():
    """The kernel of two bodies that collide, its plan on a fine grid, and the masses."""
    scene = load_scene("two_body_collision")
    kernel = load_kernel(scene)
    step = 1e-5
    plan = kernel.rollout(np.array(scene.task.start), np.zeros((60000, 0)), step)
    values = {parameter.name: parameter.value for parameter in scene.parameters}
    return scene, kernel, plan, np.array([values["m1"], values["m2"]])


def test_collision_keeps_momentum_to_rounding(collision):
    _, _, plan, masses = collision
    momentum = plan.v @ masses
    assert plan.lam.max() > 0.0
    assert np.abs(momentum - momentum[0]).max() < 1e-9 * np.abs(plan.v * masses).max()


def test_collision_keeps_energy_but_for_the_grid(collision):
    """Kinetic energy is back after the contact; in between the spring holds it. What is missing is of the order of the step."""
    _, kernel, plan, _ = collision
    kinetic, potential = kernel.energy(plan.q, plan.v)
    stored = 0.5 * kernel.stiffness() * np.maximum(kernel.penetration(plan.q), 0.0) ** 2
    total = kinetic + potential + stored.sum(axis=1)
    assert kinetic.min() < 0.5 * kinetic[0]
    assert np.abs(total - total[0]).max() < 1e-3 * total[0]
    assert kinetic[-1] == pytest.approx(kinetic[0], rel=1e-3)


def test_collision_has_the_closed_forms_of_the_scene(collision):
    scene, kernel, plan, _ = collision
    answers = {answer.quantity: answer.value for answer in scene.answers}
    assert kernel.penetration(plan.q).max() == pytest.approx(answers["largest compression [m]"], rel=1e-3)
    assert (plan.lam > 0.0).sum() * plan.step == pytest.approx(answers["contact time [s]"], rel=1e-3)
    assert plan.v[-1] == pytest.approx(
        np.array([answers[f"velocity of the {which} disc afterwards [m/s]"] for which in ("left", "right")]), rel=1e-3
    )


def test_bouncing_mass_meets_the_floor_when_it_should():
    scene = load_scene("bouncing_mass")
    kernel = load_kernel(scene)
    step = 1e-5
    plan = kernel.rollout(np.array(scene.task.start), np.zeros((60000, 0)), step)
    answers = {answer.quantity: answer.value for answer in scene.answers}
    touches = np.argmax(plan.lam[:, 0] > 0.0) * step
    assert touches == pytest.approx(answers["time of the first contact [s]"], abs=5 * step)
    assert kernel.penetration(plan.q).max() == pytest.approx(answers["largest depth [m]"], rel=1e-3)

"""`push_box` and `hopper_planar`: what physics keeps, and the quasi-static step that is no approximation."""

import math

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import dblquad

from models.codegen.emit import emit_model
from models.dynamics import derive
from models.scenes.push_box import mean_distance
from tests.models.test_scene_bank import kernel_of, points, scene_of

CLOSE = {"rel": 1e-10, "abs": 1e-10}


def test_the_leg_changes_neither_momentum_nor_angular_momentum() -> None:
    """About the origin, clockwise positive as the pitch: weight, floor and friction are all that acts on the whole."""
    scene, kernel = scene_of("hopper_planar"), kernel_of("hopper_planar")
    p = {parameter.name: parameter.value for parameter in scene.parameters}
    masses = np.array([p["m"], p["m_f"]])
    q, v, u, forces = points(scene)
    a = kernel.acceleration(q, v, u, forces)
    lam, friction = forces.T
    assert a[:, [0, 3]] @ masses == pytest.approx(friction, **CLOSE)
    assert a[:, [1, 4]] @ masses == pytest.approx(lam - p["g"] * masses.sum(), **CLOSE)
    turning = p["inertia"] * a[:, 2] + (q[:, [1, 4]] * a[:, [0, 3]] - q[:, [0, 3]] * a[:, [1, 4]]) @ masses
    weight = p["g"] * q[:, [0, 3]] @ masses
    assert turning == pytest.approx(weight + q[:, 4] * friction - q[:, 3] * lam, rel=1e-9, abs=1e-9)


def test_the_time_step_of_the_box_is_the_quasi_static_law() -> None:
    """v' = D^-1 F exactly, whatever the velocity was."""
    scene, kernel, d = scene_of("push_box"), kernel_of("push_box"), derive(scene_of("push_box"))
    values = scene.parameter_values
    drag = np.array(
        [float(sp.sympify(-force).diff(item.velocity).subs(values)) for force, item in zip(scene.forces, scene.coordinates, strict=True)]
    )
    force = d.function(d.generalised_force, d.q, d.v, d.u, (*d.lam, *d.f))
    for q, v, u, forces in zip(*points(scene), strict=True):
        after = v + scene.task.step * kernel.acceleration(q[None], v[None], u[None], forces[None])[0]
        assert after == pytest.approx(force(q, np.zeros(scene.nq), u, forces).ravel() / drag, rel=1e-12, abs=1e-12)


def test_the_rim_is_exact_along_the_faces_and_the_cone_that_of_its_normal() -> None:
    scene, d = scene_of("push_box"), derive(scene_of("push_box"))
    phi, jacobian, slip = d.function(d.penetration, d.q), d.function(d.gap_jacobian, d.q), d.function(d.slip_jacobian, d.q)
    for along, across in ((-0.53, 0.0), (0.52, 0.1), (0.1, -0.24), (-0.2, 0.25), (0.5, 0.25)):
        distances = np.array([abs(along) - 0.5, abs(across) - 0.25])
        others = math.log1p(2 * math.exp(-20.0 * abs(distances[0] - distances[1])) + math.exp(-20.0 * 0.4)) / 20.0
        outside = -phi(np.array([0.0, 0.0, 0.0, along, across])).item()
        assert 0.0 <= outside - distances.max() <= others
    q = np.array([0.1, 0.2, 0.4, -0.35, -0.1])
    normal, tangent = jacobian(q).ravel(), slip(q).ravel()
    assert normal[3:] @ tangent[3:] == pytest.approx(0.0, abs=1e-14)
    assert np.linalg.norm(normal[3:]) == pytest.approx(np.linalg.norm(tangent[3:]), rel=1e-12)
    for row in (normal, tangent):  # action and reaction, and no torque on the pair about the finger
        assert row[:2] + row[3:] == pytest.approx([0.0, 0.0], abs=1e-14)
        arm = q[3:] - q[:2]
        assert row[2] == pytest.approx(arm[0] * row[1] - arm[1] * row[0], abs=1e-12)
    assert scene.task.goal[2] == 0.0


def test_the_mean_distance_of_a_footprint() -> None:
    integral, _ = dblquad(lambda y, x: math.hypot(x, y), 0.0, 0.5, 0.0, 0.25)
    assert mean_distance(0.5, 0.25) == pytest.approx(integral / 0.125, rel=1e-8)


def test_one_face_alone_has_to_turn_the_box() -> None:
    """Pushed on its left face for a while each at random places and angles within the cone, no box that turns less comes as far aside."""
    scene = scene_of("push_box")
    (answer,) = scene.answers
    mu, d, c = (next(item.value for item in scene.parameters if item.name == name) for name in ("mu", "d", "c"))
    random = np.random.default_rng(5)
    x = y = theta = turned = np.zeros(2000)
    for _ in range(60):
        normal, arm, share = random.uniform(0.0, 4.0, 2000), random.uniform(-0.25, 0.25, 2000), random.uniform(-1.0, 1.0, 2000)
        tangential = mu * normal * share
        x = x + 0.02 / d * (np.cos(theta) * normal - np.sin(theta) * tangential)
        y = y + 0.02 / d * (np.sin(theta) * normal + np.cos(theta) * tangential)
        theta = theta + 0.02 / (d * c**2) * (-0.5 * tangential - arm * normal)
        turned = np.maximum(turned, np.abs(theta))
    aside = np.arctan2(np.abs(y), x) - math.atan(mu)
    assert (aside <= turned + 1e-12).all()
    assert answer.value == pytest.approx(math.radians(13.2405), abs=1e-5)


@pytest.mark.slow
def test_each_has_only_what_it_needs() -> None:
    assert set(derive(scene_of("push_box")).absent) == {"a mass matrix that depends on q", "inertial coupling", "a potential"}
    assert set(derive(scene_of("hopper_planar")).absent) == {"a mass matrix that depends on q", "inertial coupling"}
    assert "sqrt(" not in emit_model(scene_of("push_box"))
    assert "sin(" not in emit_model(scene_of("hopper_planar"))

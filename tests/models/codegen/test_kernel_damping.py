"""Damped contacts in the compiled step: values against SymPy, derivatives against finite differences, the limit of the smoothing, energy."""

from pathlib import Path

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.dynamics import derive
from models.scene import Scene

ARM = load_scene(str(Path(__file__).parents[2] / "scenes" / "damped_arm.py"))
LAWS = [(ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3)]


def probes(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    rows = [np.zeros(scene.nq), np.ones(scene.nq), np.arange(scene.nq) % 2, np.arange(scene.nq)]
    q = np.vstack([*rows, random.normal(scale=0.5, size=(200, scene.nq))])
    return q, np.vstack([*rows[::-1], random.normal(scale=3.0, size=(200, scene.nq))])


def true_force(scene: Scene, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    d = derive(scene)
    push, phi = d.function(d.push, d.q, d.v), d.function(d.penetration, d.q)
    return np.array([np.where(phi(x).ravel() > 0, np.maximum(push(x, y).ravel(), 0), 0) for x, y in zip(q, v, strict=True)])


@pytest.mark.parametrize("scene", [ARM, load_scene("damped_collision")], ids=lambda scene: scene.name)
def test_forces_are_those_of_the_law(scene: Scene):
    kernel, (q, v) = load_kernel(scene), probes(scene)
    lam = kernel.contact_force(q, v=v)
    assert lam == pytest.approx(true_force(scene, q, v), rel=1e-12, abs=1e-12)
    damped = list(scene.damped)
    closed = kernel.penetration(q)[:, damped] > 0
    assert (lam[:, damped][closed] == 0).any()  # a released contact is among them
    assert (lam[:, damped][closed] > 0).any()
    push = kernel.contact_push(q, v)
    assert np.maximum(push, 0) == pytest.approx(lam)  # what the score holds a plan's forces against
    assert push[kernel.penetration(q) <= 0] == pytest.approx((kernel.stiffness() * kernel.penetration(q))[kernel.penetration(q) <= 0])


def test_the_smoothed_law_is_that_of_the_springs_at_rest_and_the_true_one_in_the_limit():
    kernel, (q, v) = load_kernel(ARM), probes(ARM)
    phi, k = kernel.penetration(q), kernel.stiffness()
    b = -np.log(1e-3)
    assert kernel.contact_force(q, ContactLaw.SOFTPLUS, 1e-3) == pytest.approx(k / b * np.logaddexp(0, b * phi), rel=1e-12)
    assert (kernel.contact_force(q, ContactLaw.SOFTPLUS, 1e-3, v=v) >= 0).all()
    away = np.abs(phi).min(axis=1) > 0.05
    sharp = kernel.contact_force(q[away], ContactLaw.SOFTPLUS, 1e-300, v=v[away])
    assert sharp == pytest.approx(true_force(ARM, q[away], v[away]), abs=0.5)  # k ln2 / b = 0.3 N


@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_the_adjoint_is_the_derivative(law: ContactLaw, eps: float | None):
    kernel, task = load_kernel(ARM), ARM.task
    random = np.random.default_rng(5)
    u = random.normal(scale=[15.0, 4.0], size=(task.steps, 2))
    start = np.array(task.start)

    def run(start: np.ndarray, u: np.ndarray):
        return kernel.rollout(start, u, task.step, law, eps)

    found = run(start, u)
    assert not found.diverged
    assert (found.lam.max(axis=0)[:3] > 0.1).all()  # every contact takes part
    q_bar, v_bar, lam_bar = (random.normal(size=rows.shape) for rows in (found.q, found.v, found.lam))
    u_bar, start_bar = kernel.adjoint(found, u, q_bar, v_bar, lam_bar)

    def loss(start: np.ndarray, u: np.ndarray) -> float:
        rollout = run(start, u)
        return float((q_bar * rollout.q).sum() + (v_bar * rollout.v).sum() + (lam_bar * rollout.lam).sum())

    for _ in range(3):
        ds, du, h = random.normal(size=start.shape), random.normal(size=u.shape), 1e-7
        difference = (loss(start + h * ds, u + h * du) - loss(start - h * ds, u - h * du)) / (2 * h)
        assert float(start_bar @ ds + (u_bar * du).sum()) == pytest.approx(difference, rel=2e-5)


def test_momentum_is_kept_and_energy_only_lost():
    scene = load_scene("damped_collision").with_task(steps=20_000, step=2e-5)
    kernel = load_kernel(scene)
    motion = kernel.rollout(np.array(scene.task.start), np.zeros((20_000, 0)), 2e-5)
    m = np.array([parameter.value for parameter in scene.parameters[:2]])
    assert (motion.v @ m)[-1] == pytest.approx((motion.v @ m)[0], abs=1e-12)
    kinetic, _ = kernel.energy(motion.q, motion.v)
    spring = (kernel.stiffness() * np.maximum(kernel.penetration(motion.q), 0) ** 2).sum(axis=1) / 2
    assert np.diff(kinetic + spring).max() < 2e-5  # a time step may gain what it is wrong by: h c s^2 / mu h
    assert kinetic[-1] < 0.6 * kinetic[0]

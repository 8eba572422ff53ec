"""Equations of motion: by hand where that is short, by energy and momentum everywhere."""

from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene, scene_names
from models.dynamics import derive
from models.scene import Scene

TEST_SCENES = sorted(str(path) for path in (Path(__file__).parents[1] / "scenes").glob("*.py"))
ALL_SCENES = [*scene_names(), *TEST_SCENES]

# Rounding of a few dozen operations on numbers of order 1 to 100.
ROUNDING = 1e-11


@pytest.fixture(params=ALL_SCENES, ids=lambda name: Path(name).stem)
def scene(request) -> Scene:
    return load_scene(request.param)


def probe(scene: Scene, seed: int = 0):
    """A random state near the start, inputs and contact forces of order 1."""
    rng = np.random.default_rng(seed)
    q = np.array(scene.task.start[: scene.nq]) + 0.3 * rng.standard_normal(scene.nq)
    return q, rng.standard_normal(scene.nq), rng.standard_normal(scene.nu), rng.uniform(0.0, 2.0, scene.nc)


def test_three_cart_as_the_paper_prints_it():
    d = derive(load_scene("three_cart"))
    v1, v2, v3, u1, u3, c, m, lam1, lam3 = (*d.v, *d.u, d.p[1], d.p[0], *d.lam)
    expected = sp.Matrix([(u1 - c * v1 - lam1) / m, (lam1 - lam3 - c * v2) / m, (u3 - c * v3 + lam3) / m])
    assert sp.simplify(d.acceleration - expected) == sp.zeros(3, 1)
    assert d.structure.linear
    assert d.structure.constant_mass
    assert "friction" in d.absent
    assert "inputs" not in d.absent


@pytest.mark.slow
def test_mass_matrix_is_symmetric_positive_definite(scene: Scene):
    d = derive(scene)
    for seed in range(20):
        M = d.function(d.mass_matrix, d.q)(probe(scene, seed)[0])
        assert np.array_equal(M, M.T) or np.allclose(M, M.T, rtol=0, atol=ROUNDING)
        assert np.linalg.eigvalsh(M).min() > 0


@pytest.mark.slow
def test_gap_jacobian_is_the_derivative_of_the_gap(scene: Scene):
    d = derive(scene)
    if not scene.nc:
        assert d.gap_jacobian.shape == (0, scene.nq)
        return
    gap, J = d.function(-d.penetration, d.q), d.function(d.gap_jacobian, d.q)
    q, step = probe(scene)[0], 1e-6
    numeric = np.column_stack([(gap(q + step * e) - gap(q - step * e)) / (2 * step) for e in np.eye(scene.nq)])
    assert np.allclose(J(q), numeric, rtol=0, atol=1e-8)  # central differences of step 1e-6: about 1e-10 of rounding, 1e-12 of truncation


@pytest.mark.slow
def test_power_balance(scene: Scene):
    """d/dt (T + V) = power of the inputs - dissipated power + power of contact and friction forces, at random states."""
    d = derive(scene)
    energy = sp.Matrix([d.kinetic_energy + d.potential_energy])
    slope_q, slope_v = d.function(energy.jacobian(d.q), d.q, d.v), d.function(energy.jacobian(d.v), d.q, d.v)
    M, f = d.function(d.mass_matrix, d.q), d.function(d.generalised_force, d.q, d.v, d.u, (*d.lam, *d.f))
    slip = d.function(d.slip, d.q, d.v) if scene.nf else None
    J = d.function(d.gap_jacobian, d.q) if scene.nc else None
    power_in = d.function([d.input_power], d.q, d.v, d.u)
    power_out = d.function([d.dissipated_power], d.q, d.v)
    for seed in range(20):
        q, v, u, lam = probe(scene, seed)
        friction = np.random.default_rng(seed).normal(size=scene.nf)
        a = np.linalg.solve(M(q), f(q, v, u, np.concatenate([lam, friction]))).ravel()
        rate = (slope_q(q, v) @ v + slope_v(q, v) @ a).item()
        contact = float(lam @ (J(q) @ v)) if J is not None else 0.0
        contact += float(friction @ slip(q, v).ravel()) if slip is not None else 0.0
        assert rate == pytest.approx(power_in(q, v, u).item() - power_out(q, v).item() + contact, abs=1e-9, rel=1e-9)


@pytest.mark.slow
def test_contact_forces_push_apart(scene: Scene):
    """A contact force accelerates its gap open: J M^-1 J' has a positive diagonal."""
    if not scene.nc:
        return
    d = derive(scene)
    for seed in range(5):
        q = probe(scene, seed)[0]
        J, M = d.function(d.gap_jacobian, d.q)(q), d.function(d.mass_matrix, d.q)(q)
        assert (np.diag(J @ np.linalg.solve(M, J.T)) > 0).all()


def test_derivation_is_cached_with_the_scene():
    scene = load_scene("three_cart")
    assert derive(scene) is derive(scene)

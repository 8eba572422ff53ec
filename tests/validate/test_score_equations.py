"""The equations of the score against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from validate.score import equations as eq


def test_physics_and_its_scale():
    k = np.array([10.0, 2.0])
    lam, phi = np.array([[3.0, 0.0], [5.0, 1.0]]), np.array([[0.2, -1.0], [0.5, -0.25]])
    # |3(3-2)| + 0 + 0 + |1(1+0.5)|
    assert eq.physics(lam, k * phi) == pytest.approx(4.5)
    scaled = eq.physics_scaled(lam, k * phi, k, length=np.array([0.1, 0.5]), h=np.array([0.1, 0.2]))
    assert scaled == pytest.approx(0.1 * 3.0 / 1.0 + 0.2 * 1.5 / 1.0)


def test_physics_scaled_depends_on_neither_grid_nor_stiffness():
    lam, phi = np.full((10, 1), 3.0), np.full((10, 1), 0.05)
    k, length, h = np.array([30.0]), np.array([0.1]), np.full(10, 0.1)
    once = eq.physics_scaled(lam, k * phi, k, length, h)
    halved = eq.physics_scaled(np.repeat(lam, 2, 0), k * np.repeat(phi, 2, 0), k, length, np.repeat(h, 2) / 2)
    assert once == pytest.approx(halved)
    assert once == pytest.approx(eq.physics_scaled(7 * lam, 7 * k * phi, 7 * k, length, h))


def test_defect_is_the_largest_residual_in_state_units():
    h = np.array([0.5, 0.5])
    a = np.array([[2.0], [0.0]])
    v = np.array([[0.0], [1.0], [1.0]])
    q = np.array([[0.0], [0.5], [1.0]])
    assert eq.defect(q, v, a, h) == 0.0
    assert eq.defect(q + np.array([[0.0], [0.0], [1e-3]]), v, a, h) == pytest.approx(1e-3)
    assert eq.defect(q, v + np.array([[0.0], [0.0], [-4e-3]]), a, h) == pytest.approx(4e-3)


def test_ghost_and_missed_impulse_by_pieces():
    """Two steps of 1 s at 2 N planned. The gap is open for the first 1.5 s; after that the replay pushes with up to 6 N."""
    gap = np.array([[0.3], [0.2], [0.0], [-0.1]])  # at 0, 1, 1.5 (event) and 2 s
    lam = np.array([[0.0], [0.0], [0.0], [6.0]])
    planned, step_of, duration = np.array([[2.0], [2.0]]), np.array([0, 1, 1]), np.array([1.0, 0.5, 0.5])
    assert eq.ghost_impulse(planned, step_of, gap, duration) == pytest.approx(3.0)
    assert eq.ghost_impulse(planned, step_of, gap, duration, shift=-0.22) == pytest.approx(1.0 * 2.0)
    assert eq.missed_impulse(planned, step_of, lam, duration) == pytest.approx(0.5 * 4.0 / 2)


def test_bounds_and_penetration():
    u = np.array([[1.0, -3.0], [2.5, 0.0]])
    assert eq.bound_violation(u, np.array([-2.0, -2.0]), np.array([2.0, 2.0])) == 1.0
    assert eq.bound_violation(u, np.array([-9.0, -9.0]), np.array([np.inf, 2.0])) == 0.0
    assert eq.max_penetration(np.array([[0.1, -0.02], [-0.01, 0.3]])) == 0.02
    assert eq.max_penetration(np.array([[0.1]])) == 0.0

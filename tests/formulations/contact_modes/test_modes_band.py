"""Banded LU against numpy's dense solver, on matrices that need pivoting."""

import numpy as np
import pytest

from formulations.contact_modes.linear import BandedLU


def random_band(seed: int, size: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(dense, band): half of the band is zero, and so is most of the diagonal, as in an optimality system."""
    random = np.random.default_rng(seed)
    dense = random.normal(size=(size, size)) * (random.uniform(size=(size, size)) < 0.5)
    np.fill_diagonal(dense, np.where(random.uniform(size=size) < 0.8, 0.0, random.normal(size=size)))
    band = np.zeros((2 * width + 1, size), order="F")
    for i in range(size):
        for j in range(size):
            if abs(i - j) <= width:
                band[width + i - j, j] = dense[i, j]
            else:
                dense[i, j] = 0.0
    return dense, band


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("size", "width"), [(1, 0), (3, 2), (40, 1), (60, 7), (9, 8)])
def test_it_solves_and_multiplies_as_numpy_does(seed: int, size: int, width: int) -> None:
    dense, band = random_band(seed, size, width)
    lu, random = BandedLU(size, width), np.random.default_rng(seed)
    is_regular = abs(np.linalg.det(dense)) > 0.0
    if lu.factor(band):
        right, several = random.normal(size=size), random.normal(size=(size, 3))
        np.testing.assert_allclose(lu.product(right), dense @ right, atol=1e-12 * max(1.0, np.abs(dense).max() * size))
        if np.linalg.cond(dense) < 1e8:
            np.testing.assert_allclose(lu.solve(right), np.linalg.solve(dense, right), rtol=1e-7, atol=1e-7)
            np.testing.assert_allclose(dense @ lu.solve(several), several, atol=1e-8)
    else:
        assert not is_regular or np.linalg.cond(dense) > 1e8


@pytest.mark.parametrize("several", [1, 2, 5, 13])
def test_several_right_hand_sides_at_once_are_each_alone(several: int) -> None:
    random, lu = np.random.default_rng(several), BandedLU(60, 7)
    assert lu.factor(random_band(0, 60, 7)[1])
    right = random.normal(size=(60, several)) * (random.uniform(size=(60, several)) < 0.2)  # with rows that are zero
    for order in ("C", "F"):
        together = lu.solve(np.array(right, order=order))
        for k in range(several):
            assert np.array_equal(together[:, k], lu.solve(right[:, k]))
            assert np.array_equal(lu.product(np.array(right, order=order))[:, k], lu.product(right[:, k]))


def test_a_matrix_with_an_empty_column_is_singular() -> None:
    band = np.zeros((3, 5), order="F")
    band[1] = 1.0
    lu = BandedLU(5, 1)
    assert lu.factor(band)
    band = band.copy(order="F")
    band[1, 3] = 0.0
    assert not lu.factor(band)
    assert lu.factor(np.asfortranarray(np.where(np.arange(3)[:, None] == 1, 2.0, 0.0) * np.ones(5))), "nothing of the failure is left"
    np.testing.assert_allclose(lu.solve(np.ones(5)), 0.5)

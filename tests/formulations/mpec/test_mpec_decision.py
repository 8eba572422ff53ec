"""Multipliers by projection against closed forms, linear programs, and all pieces one by one.

And what proves each answer, checked by itself.
"""

import numpy as np
import pytest
import scipy.sparse as sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from formulations.mpec.certificate import multipliers as projection
from formulations.mpec.certificate import stationarity
from formulations.mpec.certificate import stationarity as pieces
from formulations.mpec.certificate.multipliers import (
    decide,
    least_residual,
    multipliers_within,
    project,
)
from formulations.mpec.certificate.stationarity import (
    CHOICES,
    ActiveSet,
    Stationarity,
    class_of,
    classify,
    limits,
    pairs_of,
    steepest_piece,
)

TOLERANCE = 1e-5
_SEEDS = st.integers(0, 2**32 - 1)


def cone(random: np.random.Generator) -> tuple[sparse.csc_matrix, np.ndarray, np.ndarray]:
    """Columns, some of them twice, and limits of their multipliers: free, >= 0, <= 0 or 0."""
    n, columns = int(random.integers(1, 9)), int(random.integers(1, 9))
    matrix = random.integers(-2, 3, size=(n, columns)).astype(float)
    matrix[:, -1] = matrix[:, 0] * random.choice([1.0, -1.0, 0.0])
    low, high = np.array([(-np.inf, np.inf), (0.0, np.inf), (-np.inf, 0.0), (0.0, 0.0)])[
        random.choice(4, size=columns, p=[0.2, 0.5, 0.2, 0.1])
    ].T
    return sparse.csc_matrix(matrix), low, high


@settings(max_examples=25, deadline=None)
@given(seed=_SEEDS)
def test_the_projection_is_that_of_nonnegative_least_squares(seed):
    """A free multiplier is the difference of two that are not negative (Lawson and Hanson's method, dense)."""
    random = np.random.default_rng(seed)
    matrix, low, high = cone(random)
    gradient = random.normal(size=matrix.shape[0])
    both = np.hstack([matrix.toarray()[:, high > 0.0], -matrix.toarray()[:, low < 0.0]])
    distance = nnls(both, gradient)[1] if both.shape[1] else float(np.linalg.norm(gradient))
    found = project(matrix, gradient, low, high)
    assert np.all((found.y >= low) & (found.y <= high))
    assert np.linalg.norm(found.polar) == pytest.approx(distance, abs=1e-7)
    assert np.max(np.abs(found.rest)) <= np.max(np.abs(found.polar)) + 1e-7


@pytest.mark.parametrize("apart", [1e-4, 1e-5])
def test_gradients_that_nearly_depend_on_each_other_do_not_keep_it_going(monkeypatch, apart):
    """Two long multipliers of nearly the same gradient: the damping lets them grow by a share of what is missing, for hundreds of iterations."""
    calls: list[int] = []
    monkeypatch.setattr(
        projection,
        "_factorised",
        lambda *given, own=projection._factorised: calls.append(1) or own(*given),
    )
    random = np.random.default_rng(0)
    matrix = random.normal(size=(40, 12))
    matrix[:, 1] = matrix[:, 0] + apart * random.normal(size=40)
    y = np.abs(random.normal(size=12))
    y[:2] = 30.0, -29.0  # free, the others not negative
    low = np.array([-np.inf, -np.inf, *[0.0] * 10])
    found = project(sparse.csc_matrix(matrix), matrix @ y, low, np.full(12, np.inf))
    assert np.max(np.abs(found.rest)) <= 1e-9
    assert np.allclose(found.y, y, rtol=0.0, atol=1e-9 / apart)
    assert len(calls) <= 25


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(seed=_SEEDS, inside=st.booleans())
def test_it_decides_as_a_linear_program_does(seed, inside):
    random = np.random.default_rng(seed)
    matrix, low, high = cone(random)
    y = np.clip(random.normal(size=matrix.shape[1]), low, high)
    gradient = matrix @ y if inside else random.normal(size=matrix.shape[0])
    question = (matrix, gradient, low, high, TOLERANCE)
    found = decide(*question)
    assert (
        found.exists
        == multipliers_within(*question).exists
        == (least_residual(*question).residual <= TOLERANCE)
    )
    assert found.exists or not inside
    if found.exists:
        assert np.all((found.y >= low) & (found.y <= high))
        assert np.max(np.abs(gradient - matrix @ found.y)) == found.residual <= TOLERANCE
    else:
        d = -found.polar / np.max(np.abs(found.polar))
        products = matrix.T @ d
        assert np.all(products[high > 0.0] >= -1e-9)
        assert np.all(products[low < 0.0] <= 1e-9)
        assert gradient @ d == pytest.approx(found.slope)
        assert found.slope < -TOLERANCE


def near_the_tolerance(largest: float) -> tuple[sparse.csc_matrix, np.ndarray]:
    """A gradient whose nearest multiplier in the 2-norm leaves 1 in one component and little in a thousand others; in the max-norm the best is known:
    the column is (1, .., 1), the gradient (2 largest, 0, .., 0), and y = largest leaves as much
    everywhere.
    """
    gradient = np.zeros(1000)
    gradient[0] = 2.0 * largest
    return sparse.csc_matrix(np.ones((1000, 1))), gradient


@pytest.mark.parametrize(
    ("largest", "exists"), [(0.99 * TOLERANCE, True), (1.2 * TOLERANCE, False)]
)
def test_the_largest_component_counts_not_the_length(largest, exists):
    matrix, gradient = near_the_tolerance(largest)
    question = (matrix, gradient, np.array([-np.inf]), np.array([np.inf]), TOLERANCE)
    found = decide(*question)
    assert least_residual(*question).residual == pytest.approx(largest)
    assert found.exists in (exists, None)
    assert found.residual >= largest * (1.0 - 1e-9)


def random_point(random: np.random.Generator, count: int, n: int) -> tuple[ActiveSet, Stationarity]:
    """An active set whose multipliers are known: those of biactive pairs have signs of one class.

    Gradients may depend on each other.
    """
    kind = [
        Stationarity.STRONG,
        Stationarity.MORDUKHOVICH,
        Stationarity.CLARKE,
        Stationarity.ALTERNATIVE,
        Stationarity.WEAK,
    ][random.integers(5)]
    first, second = (random.integers(-2, 3, size=(n, count)).astype(float) for _ in range(2))
    rows = random.integers(-2, 3, size=(n, 3)).astype(float)
    signs = [CHOICES[kind][k] for k in random.integers(len(CHOICES[kind]), size=count)]
    active = ActiveSet(
        gradient=np.zeros(n), normals=sparse.csc_matrix(rows),
        lowest=np.array([-np.inf, 0.0, -np.inf]), highest=np.array([np.inf, np.inf, 0.0]),
        first_only=np.arange(0),
        second_only=np.arange(0), both=np.arange(count), first_normals=sparse.csc_matrix(first),
        second_normals=sparse.csc_matrix(second),
        scale=1.0,
    )  # fmt: skip
    low, high = limits(active, signs)
    y = np.clip(random.normal(size=len(low)), low, high)
    gradient = active.matrix @ y
    known = class_of(pairs_of(active, y), 0.0)
    scale = max(1.0, float(np.max(np.abs(gradient))))
    return ActiveSet(**{**active.__dict__, "gradient": gradient, "scale": scale}), known


_ORDER = list(Stationarity)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(seed=_SEEDS, count=st.integers(0, 3), n=st.integers(2, 9))
def test_classes_are_those_of_linear_programs_and_no_weaker_than_known(seed, count, n):
    active, known = random_point(np.random.default_rng(seed), count, n)
    found = classify(active, TOLERANCE)
    assert _ORDER.index(found.kind) <= _ORDER.index(known)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("_only_candidate", "_one_of_many"):
            patch.setattr(stationarity, name, lambda *_: None)
        projected = classify(active, TOLERANCE)
        patch.setattr(stationarity, "decide", multipliers_within)
        by_programs = classify(active, TOLERANCE)
    assert found.kind is projected.kind is by_programs.kind


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(seed=_SEEDS, count=st.integers(0, 4), n=st.integers(2, 9))
def test_the_tree_of_pieces_knows_what_all_pieces_tell(seed, count, n):
    active, _ = random_point(np.random.default_rng(seed), count, n)
    every, _ = steepest_piece(active, TOLERANCE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pieces, "_SMALL", -1)
        slope, direction = steepest_piece(active, TOLERANCE)
    assert (slope < -TOLERANCE) == (every < -TOLERANCE)
    assert slope >= every - 1e-6
    if (
        direction is not None
    ):  # it lies in a piece: each pair keeps a side at 0 and leaves the other on its good side
        first, second = active.first_normals.T @ direction, active.second_normals.T @ direction
        assert np.all(np.abs(np.minimum(first, second)) <= 1e-5)
        assert active.gradient @ direction / active.scale == pytest.approx(slope, abs=1e-9)


def test_a_tree_that_is_not_searched_to_its_end_says_so(monkeypatch):
    active, _ = random_point(np.random.default_rng(3), 4, 9)
    monkeypatch.setattr(pieces, "_SMALL", -1)
    monkeypatch.setattr(pieces, "affordable", lambda *_: 0)
    slope, direction = steepest_piece(active, TOLERANCE)
    assert np.isnan(slope)
    assert direction is None

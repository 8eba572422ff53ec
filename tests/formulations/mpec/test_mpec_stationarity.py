"""Stationarity by linear programs, in models that are small enough to be worked out by hand."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import OptimizeResult, linprog

from formulations.certificate import stationarity
from formulations.certificate.local import LocalModel
from formulations.certificate.stationarity import (
    Stationarity,
    Verdict,
    active_set,
    balance,
    falling_piece,
    judge,
)
from tests.formulations.mpec.local_models import INF, local, pair, row

STRONG, WEAK, NONE = Stationarity
TOLERANCE = 1e-6
RISES, FALLS, STAYS = (0.0, INF), (-INF, 0.0), (0.0, 0.0)
Limits = tuple[float, float]


def at(
    gradient: Sequence[float],
    rows: Sequence[tuple[Sequence[float], Limits]] = (),
    pairs: Sequence[tuple[Sequence[float], Sequence[float]]] = (),
    scale: float = 1.0,
) -> LocalModel:
    """A point where all rows, which are 0, and both sides of all pairs are active."""
    return local(
        [row(0.0, name=f"x{k}") for k in range(len(gradient))],
        [(row(0.0, *limits), slopes) for slopes, limits in rows],
        [(pair(0.0, 0.0), first, second) for first, second in pairs],
        gradient,
        scale=scale,
    )


def judged(model: LocalModel, tolerance: float = TOLERANCE) -> Verdict:
    return judge(model, active_set(model, 1e-9), tolerance)


@pytest.mark.parametrize(("multipliers", "kind", "obstacle"), [
    ((2.0, 0.5), STRONG, ""), ((0.0, 0.0), STRONG, ""), ((0.5, -4e-6), STRONG, ""),
    ((0.0, -2.0), WEAK, "second side of 'pair' has the multiplier -2"),
    ((-2.0, 0.0), WEAK, "first side of 'pair' has the multiplier -2"),
    ((-1.0, -2.5), WEAK, "first side of 'pair' has the multiplier -1"),
    ((-1.0, -9.0), WEAK, "second side of 'pair' has the multiplier -9"),
    ((1.0, -2.0), WEAK, "second side of 'pair' has the multiplier -2"),
])  # fmt: skip
def test_judge_pair_signs_decide_and_are_named(multipliers, kind, obstacle):
    """Sides 2 x and y / 4. A multiplier of -1 of the first lets the objective fall by 2 along x, of the second by 1/4 along y."""
    nu, mu = multipliers
    found = judged(at((2.0 * nu, mu / 4.0, 1e-6), pairs=[((2, 0, 0), (0, 0.25, 0))], scale=4.0))
    assert found.kind is kind
    assert found.residual <= TOLERANCE
    assert obstacle in found.obstacle
    assert bool(found.obstacle) == bool(obstacle)
    slopes = (min(0.0, 2.0 * nu), min(0.0, mu / 4.0))
    assert found.descent == pytest.approx(0.0 if kind is STRONG else min(slopes) / 4.0, abs=1e-6)


def test_judge_second_argument_first_side_names_argument():
    model = local(
        [row(0.0), row(0.0)],
        pairs=[(pair(0.0, 0.0, arguments=(1, 0)), (1, 0), (0, 1))],
        gradient=(-1.0, 1.0),
    )
    assert "the second side of 'pair' has the multiplier -1" in judged(model).obstacle


@pytest.mark.parametrize(("limits", "y", "kind"), [
    (RISES, 3.0, STRONG), (RISES, -3.0, NONE), (FALLS, -3.0, STRONG), (FALLS, 3.0, NONE),
    (STAYS, 3.0, STRONG), (STAYS, -3.0, STRONG), (RISES, -1e-6, STRONG), (RISES, -5e-6, NONE),
])  # fmt: skip
def test_judge_row_with_wrong_sign_is_no_multiplier(limits: Limits, y: float, kind: Stationarity):
    found = judged(at((2.0 * y, 1.0), [((2, 0), limits), ((0, 1), STAYS)], scale=4.0))
    assert found.kind is kind
    wrong = 0.0 if kind is STRONG else 2.0 * abs(y) / 4.0
    assert found.residual == pytest.approx(wrong, abs=1e-6)
    assert found.descent == pytest.approx(-wrong, abs=1e-9)
    assert ("of the gradient in 'x0'" in found.obstacle) is (kind is NONE)


def test_judge_gradient_without_conditions_is_left():
    found = judged(at((3.0, 2.0, -4.0), [((1, 0, 0), STAYS), ((2, 0, 0), STAYS)], scale=4.0))
    assert (found.kind, found.residual) == (NONE, pytest.approx(1.0))
    assert found.descent == pytest.approx(-1.5), "along (0, -1, 1): 6 of a scale of 4"
    assert found.obstacle == "multipliers leave 1.0e+00 of the gradient in 'x2'"


@pytest.mark.parametrize(("gradient", "limits", "kind", "descent"), [
    ((-1.0, 1.0), RISES, WEAK, -1.0), ((1.0, -1.0), RISES, WEAK, -1.0),
    ((-1.0, -1.0), RISES, WEAK, -1.0), ((1.0, 1.0), RISES, STRONG, 0.0),
    ((-1.0, -2.0), FALLS, STRONG, 0.0), ((-1.0, 1.0), FALLS, STRONG, 0.0),
    ((-1.0, -2.0), STAYS, STRONG, 0.0),
])  # fmt: skip
def test_judge_row_may_replace_a_pair_multiplier(gradient, limits: Limits, kind, descent):
    """Sides x and y of the pair, a row x + y: nu = g1 - w, mu = g2 - w, for any w that the row allows."""
    found = judged(at(gradient, [((1, 1), limits)], [((1, 0), (0, 1))]))
    assert found.kind is kind
    assert found.descent == pytest.approx(descent)


def test_judge_weak_point_without_descent_is_b_stationary():
    """x = z = y: both sides of the pair x, y rise together, which no piece allows."""
    held = [((1, 0, -1), STAYS), ((0, 1, -1), STAYS)]
    found = judged(at((0.0, 0.0, -1.0), held, [((1, 0, 0), (0, 1, 0))]))
    assert (found.kind, found.descent) == (WEAK, 0.0)


@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1e6, 1e16])
def test_judge_row_and_side_in_another_unit_same_verdict(unit: float):
    """A row that holds x, and a side that lets y fall."""
    pairs = [((0, unit, 0), (0, 0, 1))]
    held = judged(at((1.0, 1.0, 1.0), [((unit, 0, 0), RISES)], pairs))
    assert (held.kind, held.descent) == (STRONG, 0.0)
    falls = judged(at((1.0, -1.0, 1.0), [((unit, 0, 0), RISES)], pairs))
    assert (falls.kind, falls.descent) == (WEAK, pytest.approx(-1.0))
    assert falls.obstacle == f"the first side of 'pair' has the multiplier {-1.0 / unit:.3g}"


@pytest.mark.parametrize("others", [10, 300])
def test_judge_components_within_tolerance_add_up_to_no_descent(others: int):
    """x = z = y: B-stationary by the pair x, y; the other variables have no condition."""
    rest = [0.0] * others
    held = [((1, 0, -1, *rest), STAYS), ((0, 1, -1, *rest), STAYS)]
    small = [0.4 * TOLERANCE] * others
    found = judged(at((0.0, 0.0, -1.0, *small), held, [((1, 0, 0, *rest), (0, 1, 0, *rest))]))
    assert (found.kind, found.descent) == (WEAK, 0.0)


@pytest.mark.parametrize("left", [2e-5, 1e-3, 1.0])
def test_judge_nearly_dependent_gradients_allow_large_multipliers(left: float):
    """(1, 0) and (1, 1e-7) make up (1, left) with multipliers of left / 1e-7."""
    found = judged(at((1.0, left), [((1, 0), STAYS), ((1, 1e-7), STAYS)]))
    assert (found.kind, found.residual <= 1e-8) == (STRONG, True)


@pytest.mark.parametrize(("largest", "kind"), [(0.99e-6, STRONG), (1.2e-6, NONE)])
def test_judge_largest_component_counts_not_the_sum(largest: float, kind: Stationarity):
    """The least sum leaves everything in one component; a multiplier of `largest` leaves as much everywhere."""
    found = judged(at((2.0 * largest, *[0.0] * 9), [([1.0] * 10, STAYS)]))
    assert found.kind is kind
    if kind is STRONG:
        assert found.residual == pytest.approx(largest, rel=0.02)


def test_judge_many_gentle_slopes_make_a_steep_one():
    """Along either edge the cost falls by 1e-6 only; along (1, 0), inside both, by 2."""
    found = judged(at((-2.0, -1e-6), [((1, 0), RISES), ((1, 1e-6), RISES)], scale=2.0))
    assert found.descent == pytest.approx(-1.0, rel=1e-3)


def test_balance_four_hundred_pairs_needs_one_program():
    n = 400
    unit = np.eye(n)
    model = at(np.linspace(0.5, 1.0, n), pairs=[(unit[k], unit[(k + 1) % n]) for k in range(n)])
    found = balance(active_set(model, 1e-9), model.gradient, TOLERANCE)
    assert (found.largest <= 1e-9, found.slope >= -1e-6) == (True, True)


def test_judge_pairs_that_rise_together_need_every_piece():
    """Both sides of each of eight pairs rise as one, which none of the 256 pieces allows."""
    unit = np.eye(16)
    rows = [(unit[2 * k] - unit[2 * k + 1], STAYS) for k in range(8)]
    pairs = [(unit[2 * k], unit[2 * k + 1]) for k in range(8)]
    found = judged(at([-1.0] * 16, rows, pairs))
    assert (found.kind, found.descent) == (WEAK, 0.0)


def random_model(random: np.random.Generator, count: int, n: int) -> LocalModel:
    """Gradients of small integers, which may depend on each other, at a point with known multipliers."""
    sides = [random.integers(-2, 3, size=n).astype(float) for _ in range(2 * count)]
    rows = [
        (random.integers(-2, 3, size=n).astype(float), limits) for limits in (STAYS, RISES, FALLS)
    ]
    y = [random.normal(), abs(random.normal()), -abs(random.normal())]
    y += random.choice([-1.0, 0.0, 1.0], p=[0.2, 0.2, 0.6], size=2 * count).tolist()
    gradient = sum(
        weight * normal for weight, normal in zip(y, [*(r for r, _ in rows), *sides], strict=True)
    )
    gradient = gradient + random.choice([0.0, 0.0, 1e-2]) * random.normal(size=n)
    return at(gradient, rows, list(zip(sides[::2], sides[1::2], strict=True)))


def steepest_of_all_pieces(model: LocalModel, pieces: Sequence[Sequence[bool | None]]) -> float:
    """Least gradient' d over |d| <= 1: in a piece True holds the first side, False the second, None neither."""
    rows, first, second = (
        matrix.toarray() for matrix in (model.jacobian, model.first_jacobian, model.second_jacobian)
    )
    best = 0.0
    for piece in pieces:
        equal, rising = [rows[0]], [rows[1], -rows[2]]
        for k, held in enumerate(piece):
            (equal if held is True else rising).append(first[k])
            (equal if held is False else rising).append(second[k])
        answer = linprog(
            model.gradient, A_ub=-np.array(rising), b_ub=np.zeros(len(rising)),
            A_eq=np.array(equal), b_eq=np.zeros(len(equal)), bounds=(-1.0, 1.0),
        )  # fmt: skip
        best = min(best, answer.fun)
    return best


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 3), n=st.integers(2, 6))
def test_judge_random_points_agree_with_every_piece(seed: int, count: int, n: int):
    model = random_model(np.random.default_rng(seed), count, n)
    found = judged(model, 1e-5)
    relaxed = steepest_of_all_pieces(model, [[None] * count])
    pieces = steepest_of_all_pieces(model, list(itertools.product([True, False], repeat=count)))
    assert (found.kind is STRONG) == (relaxed > -1e-5)
    assert (found.descent < -1e-5) == (pieces < -1e-5)
    assert found.descent >= pieces - 1e-6


def failing(times: int, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let the first linear programs fail; return the methods that were tried."""
    tried: list[str] = []

    def program(*given, **options) -> OptimizeResult:
        tried.append(options["method"])
        if len(tried) <= times:
            return OptimizeResult(status=4, x=None, fun=None)
        return linprog(*given, **options)

    monkeypatch.setattr(stationarity, "linprog", program)
    return tried


def test_judge_failed_program_is_tried_by_another_method(monkeypatch):
    tried = failing(1, monkeypatch)
    assert judged(at((1.0, 2.0), pairs=[((1, 0), (0, 1))])).kind is STRONG
    assert tried == ["highs-ds", "highs-ipm"]


def test_judge_failed_programs_leave_it_unknown(monkeypatch):
    failing(2, monkeypatch)
    found = judged(at((1.0, -2.0), pairs=[((1, 0), (0, 1))]))
    assert (found.kind, found.obstacle) == (NONE, "the linear program failed")
    assert math.isnan(found.residual)
    assert math.isnan(found.descent)


def test_judge_search_ended_by_its_limit_is_unknown(monkeypatch):
    unknown = OptimizeResult(status=1, x=None, fun=None, mip_dual_bound=-1.0)
    monkeypatch.setattr(stationarity, "milp", lambda *_, **__: unknown)
    found = judged(at((1.0, -2.0), pairs=[((1, 0), (0, 1))]))
    assert (found.kind, math.isnan(found.descent)) == (WEAK, True)


def test_judge_piece_that_does_not_fall_is_unknown(monkeypatch):
    """The search relaxes each piece by its tolerance: the piece it names is checked."""
    model = at((1.0, -2.0), pairs=[((1, 0), (0, 1))])
    active = active_set(model, 1e-9)
    assert falling_piece(active, model.gradient, 1e-6).tolist() == [True]
    assert judged(model).descent == pytest.approx(-2.0)
    monkeypatch.setattr(stationarity, "falling_piece", lambda *_: np.array([False]))
    assert math.isnan(judged(model).descent)

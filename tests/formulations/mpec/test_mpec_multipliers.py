"""Multipliers, what proves that there are none, classes and descents, in programs small enough to be worked out by hand."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sparse

from formulations.mpec.certificate import stationarity
from formulations.mpec.certificate.multipliers import (
    MultiplierDecision,
    column_lengths,
    decide,
    excludes,
    least_residual,
    least_squares,
    multipliers_within,
    project,
    signed_least_squares,
)
from formulations.mpec.certificate.stationarity import (
    ActiveSet,
    Stationarity,
    _none_leave_less,
    classify,
    steepest_direction,
    steepest_piece,
)

S, M, C, A, W, NONE = Stationarity
INF = math.inf
Limits = tuple[float, float]
RISES = (0.0, INF)
FALLS = (-INF, 0.0)
STAYS = (-INF, INF)


def columns(*items: Sequence[float]) -> sparse.csc_matrix:
    return sparse.csc_matrix(np.array(items, dtype=float).T)


def close(*values: float, tolerance: float = 1e-9):
    return pytest.approx(list(values), abs=tolerance)


def test_a_column_of_zeros_has_length_one():
    assert column_lengths(columns((3, 4), (0, 0), (0, -2))).tolist() == [5.0, 1.0, 2.0]


def test_independent_gradients_have_one_candidate():
    """2 a - 3 b + (1, -1, 1), which both a and b are perpendicular to."""
    found = least_squares(columns((1, 1, 0), (0, 1, 1)), np.array([3.0, -2.0, -2.0]))
    assert found.y == close(2, -3)
    assert found.rest == close(1, -1, 1)
    assert found.leaving(0) == close(2 / 3, 1 / 3, -1 / 3)
    assert found.leaving(1) == close(-1 / 3, 1 / 3, 2 / 3)


def test_without_gradients_everything_is_left():
    found = least_squares(sparse.csc_matrix((2, 0)), np.array([3.0, -4.0]))
    assert (found.y.tolist(), found.rest.tolist()) == ([], [3.0, -4.0])


@pytest.mark.parametrize(("items", "one"), [
    ([(1, 0), (0, 1)], True), ([(1, 0), (0, 1), (1, 1)], False), ([(1, 2, 0), (2, 4, 0)], False),
    ([(1, 0), (0, 0)], False), ([(1, 0), (1, 1e-5)], True),
    ([(1, 0), (1, 1e-9)], False),
])  # fmt: skip
def test_gradients_that_depend_on_each_other_have_many(items: list, one: bool):
    assert (least_squares(columns(*items), np.ones(len(items[0]))) is not None) == one


def test_rounding_of_badly_scaled_gradients_is_refined():
    random = np.random.default_rng(1)
    matrix = random.normal(size=(60, 40)) * 10.0 ** random.integers(-4, 5, size=40)
    y = random.normal(size=40)
    found = least_squares(sparse.csc_matrix(matrix), matrix @ y)
    assert np.max(np.abs(found.rest)) <= 1e-11 * np.max(np.abs(matrix @ y))
    assert found.y == pytest.approx(y, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_multipliers_of_the_wrong_sign_are_left_out_and_the_rest_found_again(sign: float):
    """Of (3, 0.9) the shortest multipliers of (1, 0), (0, 1), (1, 1) of one length are 2.025, -0.075, 0.975; without the second 2.1 and 0.9 leave nothing."""
    matrix, gradient = columns((1, 0), (0, 1), (1, 1)), sign * np.array([3.0, 0.9])
    low, high = (np.zeros(3), np.full(3, INF)) if sign > 0 else (np.full(3, -INF), np.zeros(3))
    found = signed_least_squares(matrix, gradient, low, high, 1e-9)
    assert found.y == close(sign * 2.1, 0, sign * 0.9)
    assert found.rest == close(0, 0)
    assert (found.least == close(0, 0), found.across <= 1e-12) == (True, True)
    enough = signed_least_squares(matrix, gradient, low, high, 0.076)
    assert enough.y == close(sign * 2.025, 0, sign * 0.975)
    assert enough.rest == close(0, -0.075 * sign)


def test_what_no_sign_can_help_is_left():
    found = signed_least_squares(
        columns((2, 0, 0), (0, 5, 0)),
        np.array([-6.0, 10.0, 7.0]),
        np.zeros(2),
        np.full(2, INF),
        1e-9,
    )
    assert found.y == close(0, 2)
    assert found.rest == close(-6, 0, 7)
    assert found.least == close(0, 0, 7)
    assert found.across <= 1e-12
    assert (
        signed_least_squares(sparse.csc_matrix((2, 0)), np.ones(2), np.zeros(0), np.zeros(0), 1e-9)
        is None
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_projection_has_the_signs_it_may_have_whatever_the_lengths(sign: float):
    """Columns of lengths 2, 1/1000, 50 and 3 along four axes: at least 0, at most 0, free, and 0."""
    matrix, gradient = (
        columns((2, 0, 0, 0, 0), (0, 1e-3, 0, 0, 0), (0, 0, 50, 0, 0), (0, 0, 0, 3, 0)),
        sign * np.array([8.0, 0.005, -25.0, 9.0, 6.0]),
    )
    found = project(
        matrix, gradient, np.array([0.0, -INF, -INF, 0.0]), np.array([INF, 0.0, INF, 0.0])
    )
    assert found is not None
    first, second = (4.0, 0.0) if sign > 0 else (0.0, -5.0)
    assert found.y == close(first, second, -0.5 * sign, 0, tolerance=1e-6)
    left = (
        sign * np.array([0.0, 0.005, 0.0, 9.0, 6.0])
        if sign > 0
        else sign * np.array([8.0, 0.0, 0.0, 9.0, 6.0])
    )
    assert found.rest == close(*left, tolerance=1e-7)
    assert found.polar == close(*left, tolerance=1e-7)
    assert found.across <= 1e-9


def test_a_cone_of_nothing_leaves_the_gradient():
    found = project(columns((1, 0)), np.array([3.0, 4.0]), np.zeros(1), np.zeros(1))
    assert (found.y.tolist(), found.rest.tolist(), found.polar.tolist(), found.across) == (
        [0.0],
        [3.0, 4.0],
        [3.0, 4.0],
        0.0,
    )
    nothing = project(columns((1, 0)), np.zeros(2), np.zeros(1), np.full(1, INF))
    assert (nothing.y.tolist(), nothing.rest.tolist()) == ([0.0], [0.0, 0.0])


@pytest.mark.parametrize(("tolerance", "across", "proved"), [
    (2.66, 0.0, True), (2.67, 0.0, False), (-2.67, 0.0, True), (2.6, 1e-10, True),
    (2.6, 1.1e-10, False), (2.66659, 1e-10, True),
    (2.66663, 1e-10, False), (2.66663, 0.0, True),
])  # fmt: skip
def test_a_vector_proves_by_what_it_says_of_the_gradient(
    tolerance: float, across: float, proved: bool
):
    """(1, -0.5)' (3, -2) = 4, of |(1, -0.5)| = 1.5 in all and 1 at most.

    A millionth of a multiplier counts 1e-4 here. However long the vector is.
    """
    for length in (1.0, 4.0):
        assert (
            excludes(
                np.array([3.0, -2.0]), length * np.array([1.0, -0.5]), length * across, tolerance
            )
            == proved
        )


FREE = (np.full(1, -INF), np.full(1, INF))


@pytest.mark.parametrize("asked", [decide, multipliers_within, least_residual])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_multipliers_exist_where_they_leave_no_more_than_the_tolerance(asked, sign: float):
    matrix, gradient = columns((2, 0, 0)), sign * np.array([6.0, 0.25, -0.5])
    enough = asked(matrix, gradient, *FREE, 0.52)
    assert enough.exists is True
    assert enough.residual == pytest.approx(0.5, abs=1e-7)
    if asked is not least_residual:
        assert enough.y == close(3 * sign)
    assert asked(matrix, gradient, *FREE, 0.49).exists is False
    one_sided = (np.zeros(1), np.full(1, INF))
    assert asked(matrix, gradient, *one_sided, 0.52).exists is (sign > 0)
    assert asked(matrix, gradient, -one_sided[1], one_sided[0], 0.52).exists is (sign < 0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_proves_that_there_are_none_points_down(sign: float):
    found = decide(columns((2, 0, 0)), sign * np.array([6.0, 0.25, -0.5]), *FREE, 0.3)
    assert found.exists is False
    assert found.polar / np.max(np.abs(found.polar)) == close(0, 0.5 * sign, -sign)
    assert found.slope == pytest.approx(-0.625)
    assert found.residual == pytest.approx(0.5)
    enough = decide(columns((2, 0, 0)), sign * np.array([6.0, 0.25, -0.5]), *FREE, 0.5)
    assert (enough.exists, enough.total, enough.polar) == (True, pytest.approx(0.75), None)


def test_a_program_is_left_for_the_shortest_that_is_as_good():
    """Any y from 2.9 to 3.1 is within the tolerance; a column that may not be used has 0."""
    found = multipliers_within(
        columns((5, 1), (1, 0)),
        np.array([3.0, -0.05]),
        np.array([0.0, -INF]),
        np.array([0.0, INF]),
        0.1,
    )
    assert found.y == close(0, 3)
    assert found.residual == pytest.approx(0.05)


@pytest.mark.parametrize(("share", "exists"), [(0.97, True), (0.99, False), (1.01, False)])
def test_a_program_uses_a_little_less_than_the_tolerance(share: float, exists: bool):
    assert (
        multipliers_within(columns((1, 0)), np.array([3.0, 0.1 * share]), *FREE, 0.1).exists
        is exists
    )


@pytest.mark.parametrize("asked", [multipliers_within, least_residual])
def test_without_rows_or_columns_the_gradient_is_left(asked):
    none = np.zeros(0)
    for gradient, exists in (
        ([0.5, -0.75], False),
        ([0.5, -0.25], True),
        ([-0.5], True),
        ([-0.51], False),
    ):
        found = asked(sparse.csc_matrix((len(gradient), 0)), np.array(gradient), none, none, 0.5)
        assert (found.exists, found.residual, found.y.tolist()) == (
            exists,
            max(map(abs, gradient)),
            [],
        )
    found = asked(sparse.csc_matrix((0, 1)), none, *FREE, 0.5)
    assert (found.exists, found.residual, found.y.tolist()) == (True, 0.0, [0.0])


def test_the_smallest_residual_is_between_the_components():
    """Of y (1, 1) and (3, 1): 2 leaves 1 of each; of (-3, -1), where y may not be negative, 3."""
    matrix, above = columns((1, 1)), (np.zeros(1), np.full(1, INF))
    found = least_residual(matrix, np.array([3.0, 1.0]), *above, 1.001)
    assert (found.exists, found.residual, found.y.tolist()) == (
        True,
        pytest.approx(1),
        [pytest.approx(2)],
    )
    assert least_residual(matrix, np.array([3.0, 1.0]), *above, 0.999).exists is False
    assert least_residual(matrix, np.array([-3.0, -1.0]), *above, 0.1).residual == pytest.approx(3)
    assert least_residual(
        matrix, np.array([-3.0, -1.0]), -above[1], above[0], 0.1
    ).residual == pytest.approx(1)


def active(
    gradient: Sequence[float],
    rows: Sequence[tuple[Sequence[float], Limits]] = (),
    pairs: Sequence[tuple[Sequence[float], Sequence[float], str]] = (),
    scale: float = 1.0,
) -> ActiveSet:
    """Rows with their limits.

    Pairs with both gradients and which side is 0: first, second, both or none.
    """
    n = len(gradient)

    def matrix(items: list[Sequence[float]]) -> sparse.csc_matrix:
        return sparse.csc_matrix(np.array(items, dtype=float).reshape(len(items), n).T)

    def which(*kinds: str) -> np.ndarray:
        return np.array(
            [place for place, (_, _, kind) in enumerate(pairs) if kind in kinds], dtype=int
        )

    return ActiveSet(
        gradient=np.array(gradient, dtype=float), normals=matrix([normal for normal, _ in rows]),
        lowest=np.array([limit[0] for _, limit in rows], dtype=float),
        highest=np.array([limit[1] for _, limit in rows], dtype=float),
        first_only=which("first"), second_only=which("second"), both=which("both"),
        first_normals=matrix([first for first, _, _ in pairs]),
        second_normals=matrix([second for _, second, _ in pairs]), scale=scale,
    )  # fmt: skip


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_steepest_direction_keeps_what_must_be_kept(sign: float):
    """Each of nine variables has a condition of its own; slopes are 1 to 9, of a scale of 2."""
    unit = np.eye(10)
    pairs = [
        (3 * unit[4], unit[0], "first"), (unit[0], 3 * unit[5], "second"),
        (3 * unit[6], 2 * unit[7], "both"), (3 * unit[8], 2 * unit[9], "both"),
        (unit[0], unit[0], "none"),
    ]  # fmt: skip
    gradient = sign * np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0, -8.0, 9.0, -10.0])
    at = active(
        gradient,
        [(2 * unit[1], RISES), (2 * unit[2], FALLS), (2 * unit[3], STAYS)],
        pairs,
        scale=2.0,
    )
    slope, direction = steepest_direction(at, np.array([True, False]), np.array([False, True]))
    rises = {
        1: 1.0 if sign > 0 else 0.0,
        2: -1.0 if sign > 0 else 0.0,
        7: 1.0 if sign > 0 else 0.0,
        8: 0.0 if sign > 0 else 1.0,
    }
    expected = np.array([-sign, *(rises.get(place, 0.0) for place in range(1, 10))])
    assert direction == pytest.approx(expected, abs=1e-9)
    assert slope == pytest.approx(float(gradient @ expected) / 2.0)


def test_without_conditions_everything_goes_down_and_without_variables_nothing():
    slope, direction = steepest_direction(
        active((3.0, -4.0), scale=4.0), np.zeros(0, bool), np.zeros(0, bool)
    )
    assert (slope, direction.tolist()) == (-1.75, [-1.0, 1.0])
    assert steepest_direction(active(()), np.zeros(0, bool), np.zeros(0, bool)) == (0.0, None)


SIGNS = [
    ((2.0, 0.5), S), ((0.0, 0.0), S), ((0.5, -4e-6), S), ((0.0, -2.0), M), ((-2.0, 0.0), M),
    ((-1.0, -2.0), C), ((1.0, -2.0), A), ((-2.0, 1.0), A),
]  # fmt: skip


@pytest.mark.parametrize(("pair", "kind"), SIGNS)
def test_where_there_is_one_candidate_it_decides(pair: tuple[float, float], kind: Stationarity):
    """Sides 2 x and y / 4: a multiplier of -1 of the first lets the objective fall by 2 along x, of the second by 1/4 along y."""
    nu, mu = pair
    found = classify(
        active((2.0 * nu, mu / 4.0, 1e-6), pairs=[((2, 0, 0), (0, 0.25, 0), "both")], scale=4.0),
        1e-6,
    )
    assert (found.kind, found.unique, found.least) == (kind, True, pytest.approx(min(pair)))
    assert found.residual == pytest.approx(2.5e-7)
    wrong = max((-nu, 2.0), (-mu, 0.25), key=lambda item: item[0])
    assert found.descent == pytest.approx(0.0 if kind is S else -wrong[0] * wrong[1] / 4.0)


def test_two_pairs_of_which_each_has_one_sign_wrong_are_weakly_stationary():
    unit = np.eye(4)
    pairs = [(unit[0], unit[1], "both"), (unit[2], unit[3], "both")]
    for gradient, kind in (
        ((1.0, -2.0, -1.0, -1.0), W),
        ((1.0, -2.0, 3.0, -1.0), A),
        ((-1.0, -2.0, 0.0, -1.0), C),
        ((3.0, 2.0, 0.0, -1.0), M),
    ):
        found = classify(active(gradient, pairs=pairs), 1e-6)
        assert (found.kind, found.least) == (kind, min(gradient))


@pytest.mark.parametrize(
    ("limits", "y", "kind"),
    [(RISES, 3.0, S), (RISES, -3.0, NONE), (FALLS, -3.0, S), (FALLS, 3.0, NONE), (STAYS, 3.0, S),
     (STAYS, -3.0, S), (RISES, -3e-6, S), (RISES, -5e-6, NONE)],
)  # fmt: skip
def test_a_row_whose_multiplier_has_the_wrong_sign_is_no_multiplier(
    limits: Limits, y: float, kind: Stationarity
):
    found = classify(active((2.0 * y, 1.0), [((2, 0), limits), ((0, 1), STAYS)], scale=4.0), 1e-6)
    assert (found.kind, found.least, found.unique) == (kind, 0.0, True)
    wrong = abs(y) if (y < 0) == (limits is RISES) and limits is not STAYS else 0.0
    assert found.residual == pytest.approx(wrong / 4.0, abs=1e-12)
    assert found.descent == pytest.approx(0.0 if kind is S else -wrong * 2.0 / 4.0)


@pytest.mark.parametrize(
    "rows",
    [[((1, 0, 0), STAYS)], [((1, 0, 0), STAYS), ((2, 0, 0), STAYS)]],
    ids=["one candidate", "many"],
)
def test_what_no_gradient_reaches_leaves_no_multipliers(rows: list):
    found = classify(active((3.0, 2.0, -4.0), rows, scale=4.0), 1e-6)
    assert found.kind is NONE
    assert found.residual == pytest.approx(1.0)
    assert found.descent == pytest.approx(-1.25), "along (0, -1/2, 1): 5 of a scale of 4"
    assert math.isnan(found.least)


@pytest.mark.parametrize(("pair", "kind"), SIGNS)
def test_of_many_multipliers_the_best_signs_count(pair: tuple[float, float], kind: Stationarity):
    """A row that is there twice takes nothing of the pair, but its own multipliers are not the only ones."""
    twice = [((0, 0, 1), RISES), ((0, 0, 2), RISES)]
    found = classify(active((*pair, 1.0), twice, [((1, 0, 0), (0, 1, 0), "both")], scale=4.0), 1e-6)
    assert (found.kind, found.unique) == (kind, False)
    assert math.isnan(found.least)
    assert found.residual <= 2e-6
    assert math.isnan(found.descent)
    without = classify(active((0.0, 0.0, 1.0), twice), 1e-6)
    assert (without.kind, without.least) == (S, 0.0)


@pytest.mark.parametrize(("gradient", "limits", "kind"), [
    ((-1.0, 1.0), RISES, M), ((1.0, -1.0), RISES, M), ((-1.0, -1.0), RISES, C),
    ((1.0, 1.0), RISES, S), ((-1.0, -2.0), FALLS, S),
    ((-1.0, 1.0), FALLS, S), ((-1.0, -2.0), STAYS, S),
])  # fmt: skip
def test_a_row_may_take_what_a_pair_may_not(
    gradient: tuple[float, float], limits: Limits, kind: Stationarity
):
    """Sides x and y of the pair, a row x + y: nu = g1 - w, mu = g2 - w, for any w that the row allows."""
    found = classify(active(gradient, [((1, 1), limits)], [((1, 0), (0, 1), "both")]), 1e-6)
    assert found.kind is kind
    assert found.residual <= 1e-6


@pytest.mark.parametrize(("given", "kind"), [(NONE, A), (C, C), (M, M), (S, S), (W, A)])
def test_a_class_that_is_known_need_not_be_found(given: Stationarity, kind: Stationarity):
    at = active(
        (1.0, -2.0, 1.0), [((0, 0, 1), STAYS), ((0, 0, 2), STAYS)], [((1, 0, 0), (0, 1, 0), "both")]
    )
    assert classify(at, 1e-6, given).kind is kind


@pytest.mark.parametrize("many", [0, 400], ids=["every piece", "a tree"])
@pytest.mark.parametrize(("gradient", "slope", "direction"), [
    ((-1.0, -2.0), -1.0, (0.0, 1.0)), ((-2.0, -1.0), -1.0, (1.0, 0.0)),
    ((-1.0, 2.0), -0.5, (1.0, 0.0)), ((2.0, -1.0), -0.5, (0.0, 1.0)),
    ((1.0, 2.0), 0.0, None), ((0.0, 0.0), 0.0, None), ((-1e-7, 2.0), None, None),
])  # fmt: skip
def test_the_steepest_piece_of_a_pair(
    many: int, gradient: tuple[float, float], slope: float | None, direction: tuple | None
):
    """Sides 10 x and y: one stays 0, the other rises.

    With more variables than are looked at one by one, the side that rises less is held first.
    """
    rest = [0.0] * many
    found, along = steepest_piece(
        active((*gradient, *rest), pairs=[((10, 0, *rest), (0, 1, *rest), "both")], scale=2.0), 1e-6
    )
    if slope is None:
        assert -1e-7 <= found <= 0.0
        return
    assert found == pytest.approx(slope, abs=1e-9)
    assert (along is None) == (direction is None)
    if along is not None:
        assert along[:2] == close(*direction)


def test_a_tree_decides_pair_after_pair():
    """Of three pairs two pull at both sides; in each piece one of these stays."""
    rest, unit = [0.0] * 400, np.eye(406)
    pairs = [(unit[0], unit[1], "both"), (unit[2], unit[3], "both"), (unit[4], unit[5], "both")]
    slope, direction = steepest_piece(
        active((-3.0, -1.0, -1.0, -2.0, 4.0, 4.0, *rest), pairs=pairs), 1e-6
    )
    assert (slope, direction[:6]) == (
        pytest.approx(-13 / 3),
        close(1, 0, 0, 2 / 3, 0, 0, tolerance=1e-7),
    )
    assert steepest_piece(active((3.0, 0.0, 0.0, 2.0, 4.0, 4.0, *rest), pairs=pairs), 1e-6) == (
        0.0,
        None,
    )


def test_a_tree_of_two_sides_a_pair_is_looked_at_whole():
    """Both sides of each of four pairs rise as one, which no piece allows: 31 nodes, of which all are needed."""
    unit, rest = np.eye(900), [0.0] * 892
    rows = [(unit[2 * k] - unit[2 * k + 1], STAYS) for k in range(4)]
    pairs = [(unit[2 * k], unit[2 * k + 1], "both") for k in range(4)]
    assert steepest_piece(active((*[-1.0] * 8, *rest), rows, pairs), 1e-6) == (0.0, None)


def test_pairs_of_one_side_have_one_piece(monkeypatch: pytest.MonkeyPatch):
    """0 <= y complements y >= 0."""
    asked: list[list[bool]] = []
    own = stationarity.steepest_direction
    monkeypatch.setattr(
        stationarity,
        "steepest_direction",
        lambda at, first, second: asked.append(first.tolist()) or own(at, first, second),
    )
    unit = np.eye(3)
    at = active(
        (1.0, 2.0, 3.0),
        pairs=[(unit[0], unit[0], "both"), (unit[1], unit[2], "both"), (unit[1], -unit[1], "none")],
    )
    assert steepest_piece(at, 1e-6)[0] == 0.0
    assert asked == [[True, True], [True, False]]


def test_a_piece_that_failed_may_hide_a_descent(monkeypatch: pytest.MonkeyPatch):
    at = active((1.0, 2.0), pairs=[((1, 0), (0, 1), "both")])
    monkeypatch.setattr(
        stationarity,
        "steepest_direction",
        lambda at, first, second: (math.nan, None) if first[0] else (0.0, None),
    )
    assert math.isnan(steepest_piece(at, 1e-6)[0])
    monkeypatch.setattr(
        stationarity,
        "steepest_direction",
        lambda at, first, second: (math.nan, None) if first[0] else (-0.5, np.ones(2)),
    )
    assert steepest_piece(at, 1e-6)[0] == -0.5
    at = replace(at, gradient=np.array([-1.0, -2.0]))
    assert steepest_piece(at, 1e-6)[0] == -0.5


def test_a_node_that_is_not_known_leaves_the_tree_unknown(monkeypatch: pytest.MonkeyPatch):
    at, known = (
        active(
            (3.0, 2.0, *[0.0] * 400), pairs=[((1, 0, *[0.0] * 400), (0, 1, *[0.0] * 400), "both")]
        ),
        [],
    )
    assert steepest_piece(at, 1e-6) == (0.0, None)
    monkeypatch.setattr(
        stationarity,
        "decide",
        lambda *_: MultiplierDecision(exists=None, residual=math.inf, y=np.zeros(2)),
    )
    monkeypatch.setattr(
        stationarity, "steepest_direction", lambda *given: known.append(given) or (math.nan, None)
    )
    slope, direction = steepest_piece(at, 1e-6)
    assert (math.isnan(slope), direction, len(known)) == (True, None, 1)
    monkeypatch.setattr(stationarity, "steepest_direction", lambda *_: (-1e-7, np.ones(402)))
    assert steepest_piece(at, 1e-6) == (0.0, None), "less than the tolerance is no descent"
    monkeypatch.setattr(stationarity, "steepest_direction", lambda *_: (-2e-6, np.eye(402)[0]))
    assert steepest_piece(at, 1e-6)[0] == -2e-6
    for total, slope in ((1e-6, 0.0), (1.1e-6, -2e-6)):
        known_to = MultiplierDecision(exists=True, residual=1e-7, y=np.zeros(2), total=total)
        monkeypatch.setattr(stationarity, "decide", lambda *_, known_to=known_to: known_to)
        assert steepest_piece(at, 1e-6)[0] == slope, "multipliers that leave the tolerance in all"


@pytest.mark.parametrize("seed", range(8))
def test_what_a_column_has_across_is_told_by_its_size(seed: int):
    random = np.random.default_rng(seed)
    matrix, gradient = sparse.csc_matrix(random.normal(size=(9, 4)) * 1e6), random.normal(size=9)
    found = signed_least_squares(matrix, gradient, np.full(4, -INF), np.full(4, INF), 1e-9)
    assert found.across == np.max(np.abs(matrix.T @ found.least)) > 0


@pytest.mark.parametrize(("slope", "shown"), [(3.9e-6, False), (4.1e-6, True), (-4.1e-6, False)])
def test_what_is_left_is_measured_by_the_scale_of_the_gradient(slope: float, shown: bool):
    """A gradient of so much, of a scale of 4, against a tolerance of 1e-6."""
    found = _none_leave_less(active((slope, 0.0), scale=4.0), np.array([0.5, 0.0]), 0.0, 1e-6)
    assert (found is not None) is shown
    if found is not None:
        assert (found.kind, found.residual, found.descent) == (NONE, 0.5, -0.5)

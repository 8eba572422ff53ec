"""The parts of a certificate by hand: what is active, which class multipliers show, what they leave, what is forced where pairs hold exactly, and what it says in words."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyomo.environ as pyo
import pytest
import scipy.sparse as sparse
from pyomo.mpec import Complementarity, complements
from wording import unsaid

from formulations.ipopt import ModelRefusedError
from formulations.mpec import certify
from formulations.mpec.certificate.certificate import (
    Certificate,
    Multipliers,
    Tolerances,
    _forced_violation,
    _given_class,
    _given_residual,
    _is_finite,
    _largest,
)
from formulations.mpec.certificate.derivatives import LocalModel, Pair, Rows
from formulations.mpec.certificate.plan import PLAN_TOLERANCES
from formulations.mpec.certificate.stationarity import (
    CHOICES,
    Stationarity,
    active_set,
    affordable,
    at_bounds,
    class_of,
    limits,
    pairs_of,
    wrong_by,
)
from tests.formulations.mpec.nearest import nearest

S, M, C, A, W = list(Stationarity)[:5]
INF = math.inf


@dataclass(frozen=True, eq=False)
class Source:
    """What stands for a component of a model."""

    name: str


@pytest.mark.parametrize(("pairs", "kind"), [
    ([], S), ([(1, 1)], S), ([(0, 0)], S), ([(-0.1, 0.5)], S), ([(0, -1)], M), ([(-1, 0)], M),
    ([(0.1, -1)], M), ([(-1, -1)], C), ([(1, -1)], A),
    ([(-1, 1)], A), ([(1, 1), (0, -1)], M), ([(0, -1), (-1, -1)], C), ([(1, -1), (0, -1)], A),
    ([(1, -1), (-1, -1)], W), ([(-0.2, 0.5)], A),
    ([(0.2, -1)], A),
])  # fmt: skip
def test_classes_by_the_signs_of_multipliers(pairs: list[tuple[float, float]], kind: Stationarity):
    """What is no larger than a tenth counts as zero."""
    assert class_of(pairs, 0.1) is kind


def test_each_class_has_its_letter():
    assert [kind.letter for kind in Stationarity] == ["S", "M", "C", "A", "W", "-"]


@pytest.mark.parametrize(("pair", "kind", "wrong"), [
    ((-2, -3), S, 3), ((-2, 1), S, 2), ((-2, -3), M, 2), ((2, -3), M, 2), ((4, -3), M, 3),
    ((-2, 3), C, 2), ((5, -3), C, 3), ((-2, -3), A, 2),
    ((-2, -3), W, 0),
])  # fmt: skip
def test_signs_are_missed_by_the_nearest(
    pair: tuple[float, float], kind: Stationarity, wrong: float
):
    assert wrong_by(pair, CHOICES[kind]) == wrong


@dataclass(frozen=True, eq=False)
class Row:
    """lower <= value <= upper of a source."""

    value: float
    lower: float = -INF
    upper: float = INF
    argument: int | None = None
    source: Source = Source("row")


def together(*items: Row) -> Rows:
    value, lower, upper = (
        np.array([getattr(item, name) for item in items], dtype=float)
        for name in ("value", "lower", "upper")
    )
    return Rows(
        sources=tuple(item.source for item in items),
        arguments=tuple(item.argument for item in items),
        value=value,
        lower=lower,
        upper=upper,
    )


def row(
    value: float,
    lower: float = -INF,
    upper: float = INF,
    argument: int | None = None,
    name: str = "row",
) -> Row:
    return Row(value=value, lower=lower, upper=upper, argument=argument, source=Source(name))


@pytest.mark.parametrize(("item", "found"), [
    (row(0.0), (False, False)), (row(1.125, lower=1.0), (True, False)),
    (row(1.13, lower=1.0), (False, False)), (row(-9.0, lower=1.0), (True, False)),
    (row(4.5, lower=4.0), (True, False)), (row(4.51, lower=4.0), (False, False)),
    (row(-4.5, upper=-4.0), (False, True)), (row(-4.51, upper=-4.0), (False, False)),
    (row(0.875, upper=1.0), (False, True)), (row(0.87, upper=1.0), (False, False)),
    (row(1.0, lower=1.0, upper=1.0), (True, True)),
    (row(0.0, lower=-0.05, upper=5.0), (True, False)),
    (row(0.0, lower=-5.0, upper=0.05), (False, True)),
])  # fmt: skip
def test_a_row_is_active_within_an_eighth_of_its_bound(item: Row, found: tuple[bool, bool]):
    low, high = at_bounds(together(item), 0.125)
    assert (low.tolist(), high.tolist()) == ([found[0]], [found[1]])


def pair(
    first: float,
    second: float,
    *,
    flips: tuple[float, float] = (1.0, 1.0),
    arguments: tuple[int, int] = (0, 1),
    source: Any = None,
) -> Pair:
    return Pair(
        source=source or Source("pair"),
        first=first,
        second=second,
        first_flip=flips[0],
        second_flip=flips[1],
        arguments=arguments,
    )


def local(
    x: Sequence[Row], rows: Sequence[tuple[Row, Sequence[float]]] = (),
    pairs: Sequence[tuple[Pair, Sequence[float], Sequence[float]]] = (),
    gradient: Sequence[float] | None = None, objective: float = 0.0,
) -> LocalModel:  # fmt: skip
    """Variables by their bounds; rows and pairs with their gradients."""
    n = len(x)

    def matrix(items: list[Sequence[float]]) -> sparse.csr_matrix:
        return sparse.csr_matrix(np.array(items, dtype=float).reshape(len(items), n))

    return LocalModel(
        variables=tuple(item.source for item in x), objective=objective,
        gradient=np.zeros(n) if gradient is None else np.array(gradient, dtype=float),
        rows=together(*(item for item, _ in rows), *x),
        jacobian=matrix([slopes for _, slopes in rows]), pairs=tuple(item for item, *_ in pairs),
        first_jacobian=matrix([first for _, first, _ in pairs]),
        second_jacobian=matrix([second for *_, second in pairs]),
    )  # fmt: skip


def test_what_is_active_stands_in_its_columns():
    model = local(
        [row(0.0, lower=0.0), row(2.0, upper=2.05), row(5.0)],
        [(row(1.0, lower=0.0), (1, 2, 3)), (row(7.0, lower=7.0), (4, 5, 6)),
         (row(3.0, upper=3.0), (7, 8, 9))],
        [
            (pair(0.1, 0.2), (1, 0, 1), (0, 1, 1)), (pair(0.2, 0.1), (2, 0, 1), (0, 2, 1)),
            (pair(0.0, 0.0), (3, 0, 1), (0, 3, 1)),
            (pair(1.0, 1.0), (4, 0, 1), (0, 4, 1)),
        ],
        gradient=(3.0, -4.0, 0.5),
    )  # fmt: skip
    found = active_set(model, 0.1)
    assert (found.lowest.tolist(), found.highest.tolist()) == ([0, -INF, 0, -INF], [INF, 0, INF, 0])
    assert found.normals.toarray().T.tolist() == [[4, 5, 6], [7, 8, 9], [1, 0, 0], [0, 1, 0]]
    assert (
        found.first_only.tolist(),
        found.second_only.tolist(),
        found.both.tolist(),
        found.scale,
    ) == ([0], [1], [2], 4.0)
    assert found.matrix.toarray().T.tolist()[4:] == [[1, 0, 1], [0, 2, 1], [3, 0, 1], [0, 3, 1]]
    y = np.arange(1.0, 9.0)
    assert pairs_of(found, y) == [(7.0, 8.0)]
    low, high = limits(found, [(">", "<")])
    assert low.tolist() == [0, -INF, 0, -INF, -INF, -INF, 0, -INF]
    assert high.tolist() == [INF, 0, INF, 0, INF, INF, INF, 0]
    assert [side.tolist() for side in limits(found, [("0", "*")])] == [
        [0, -INF, 0, -INF, -INF, -INF, 0, -INF],
        [INF, 0, INF, 0, INF, INF, 0, INF],
    ]
    assert active_set(local([row(1.0)], gradient=(0.25,)), 0.1).scale == 1.0


def test_nothing_active_has_no_limits():
    found = active_set(local([]), 0.1)
    assert [side.tolist() for side in limits(found, [])] == [[], []]
    assert pairs_of(found, np.zeros(0)) == []


@pytest.mark.parametrize(("slopes", "side", "lower", "counted"), [
    ((2.0, 0.0), 0.02, 0.0, 0), ((0.5, 0.0), 0.005, 0.0, 0), ((2.0, 0.0), 0.02 + 0.9e-12, 0.0, 0),
    ((2.0, 0.0), 0.02 + 1.1e-12, 0.0, 1),
    ((2.0, 0.0), 0.02, -0.01, 1), ((-2.0, 0.0), -0.02, 0.0, 1), ((2.0, 1.0), 0.02, 0.0, 1),
    ((0.0, 2.0), 0.02, 0.0, 1),
])  # fmt: skip
def test_a_bound_that_is_a_side_of_a_pair_is_not_counted_twice(
    slopes: tuple[float, float], side: float, lower: float, counted: int
):
    """x = 0.01: of a side 2 x its lower bound 0 is the same once more."""
    x = [row(0.01, lower=lower), row(3.0)]
    for first in (True, False):
        one = (pair(side, 5.0), slopes, (0, 9)) if first else (pair(5.0, side), (0, 9), slopes)
        assert len(active_set(local(x, pairs=[one]), 0.1).lowest) == counted
    assert (
        len(
            active_set(
                local(
                    [row(0.01, lower=0.0, upper=0.05), row(3.0)],
                    pairs=[(pair(0.02, 5.0), (2, 0), (0, 9))],
                ),
                0.1,
            ).lowest
        )
        == 1
    ), "an upper one is"


@pytest.mark.parametrize(("item", "violation", "size"), [
    (row(1.0, 2.0, 5.0), 1.0, 5.0), (row(7.0, -6.0, 5.0), 2.0, 6.0), (row(3.0, 2.0, 5.0), 0.0, 5.0),
    (row(3.0), 0.0, 1.0), (row(0.0, 0.25), 0.25, 1.0),
])  # fmt: skip
def test_a_violation_is_what_is_beyond_and_its_size_that_of_the_bounds(
    item: Row, violation: float, size: float
):
    rows = together(item)
    assert (rows.violation(rows.value).tolist(), rows.size.tolist()) == ([violation], [size])


@pytest.mark.parametrize("item", [row(math.nan, 0.0), row(0.0, math.nan), row(0.0, 0.0, math.nan)])
def test_what_is_no_number_violates_by_no_number(item: Row):
    rows = together(row(1.0), item, row(2.0))
    assert np.isnan(rows.violation(rows.value)).tolist() == [False, True, False]
    assert math.isnan(_largest(rows.violation(rows.value)))
    assert (_largest(np.zeros(0)), _largest(np.array([-1.0, -2.0]))) == (0.0, -1.0)


def test_a_point_is_finite_in_every_number():
    def model(**at: float) -> LocalModel:
        value = (
            dict.fromkeys(("x", "g", "row", "slope", "first", "second", "G", "H", "f"), 1.0) | at
        )
        return local(
            [row(value["x"])], [(row(value["row"]), (value["slope"],))],
            [(pair(value["first"], value["second"]), (value["G"],), (value["H"],))],
            gradient=(value["g"],), objective=value["f"],
        )  # fmt: skip

    assert _is_finite(model())
    for name in ("x", "g", "row", "slope", "first", "second", "G", "H", "f"):
        assert not _is_finite(model(**{name: math.nan})), name


BOX = local(
    [row(1.0, lower=0.0, name="x"), row(2.0, upper=2.5, name="y")],
    [(row(3.0, lower=1.0), (1.0, 0.0)), (row(5.0, lower=5.0, upper=5.0), (0.0, 1.0))],
    [(pair(0.25, 0.5, flips=(-1.0, 1.0), arguments=(1, 0)), (1.0, 1.0), (2.0, -1.0))],
    gradient=(4.0, -8.0),
)  # fmt: skip
(_least, _equal, _x, _y), _pair = BOX.rows.sources, BOX.pairs[0].source


@pytest.mark.parametrize(("rows", "bounds", "pairs", "left"), [
    ({}, {}, {}, 8.0),
    ({_equal: -8.0}, {}, {}, 4.0),
    ({_equal: -8.0, _least: 4.0}, {}, {},
     4.0),  # its row is 2 away from its bound: a multiplier there counts whole
    ({_equal: -13.0}, {_y: 5.0}, {}, 5.0),  # y has no lower bound: no push of 5 may come from there
    ({_equal: -8.0}, {_x: 4.0}, {}, 4.0),  # x is 1 away from its bound
    ({}, {_x: 4.0, _y: -8.0}, {}, 8.0),  # y is 0.5 away from its upper one
    ({_equal: -8.0}, {}, {_pair: (2.0, 0.0)},
     2.0),  # of the second argument, which is the first side: mu = 2
    ({_equal: -8.0}, {}, {_pair: (0.0, -4.0)},
     4.0),  # of the first side, flipped: nu = 4, which leaves (0, -4)
])  # fmt: skip
def test_what_multipliers_leave_by_hand(rows: dict, bounds: dict, pairs: dict, left: float):
    found = _given_residual(
        BOX, active_set(BOX, 1e-6), Multipliers(rows=rows, bounds=bounds, pairs=pairs)
    )
    assert found == pytest.approx(left / 8.0)


@pytest.mark.parametrize("given", [(3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0)])
@pytest.mark.parametrize(("distance", "left"), [(10.0, 3.0), (1e-5, 3.0), (5e-7, 1.5e-6)])
def test_a_multiplier_of_a_side_counts_whole_where_it_is_open_else_by_its_distance(
    given, distance, left
):
    """It leaves nothing of the gradient, but its side is not 0."""
    one = pair(distance, distance)
    model = local([row(1.0)], pairs=[(one, (1.0,), (1.0,))], gradient=(sum(given),))
    assert _given_residual(
        model, active_set(model, 1e-6), Multipliers(pairs={one.source: given})
    ) == pytest.approx(left / 3.0)
    near = pair(-10.0, -20.0)
    model = local([row(1.0)], pairs=[(near, (1.0,), (1.0,))], gradient=(sum(given),))
    assert (
        _given_residual(model, active_set(model, 1e-6), Multipliers(pairs={near.source: given}))
        == 0.0
    )


def test_given_multipliers_are_those_of_the_pairs_that_are_biactive():
    sources = [Source(str(number)) for number in range(2)]
    model = local(
        [row(0.0)],
        pairs=[(pair(0.0, 0.0, source=sources[0]), (1.0,), (1.0,)),
               (pair(0.0, 5.0, source=sources[1]), (1.0,), (1.0,))], gradient=(1.0,),
    )  # fmt: skip
    for given, kind in (((1.0, 1.0), S), ((-1.0, 1.0), A), ((-1.0, -1.0), C), ((0.0, -1.0), M)):
        multipliers = Multipliers(pairs={sources[0]: given, sources[1]: (-9.0, 9.0)})
        assert _given_class(model, active_set(model, 1e-6), multipliers) is kind


# x = 1e-3 and y = 5 complement each other; 100 x + a z >= 0.1 lives on the 1e-3.
def forced(z: float, a: float, *, upper: float = INF, tolerance: float = 1e-6) -> float:
    x = [row(1e-3, lower=0.0), row(5.0, lower=0.0), row(z, upper=upper)]
    model = local(
        x,
        [(row(0.1 + a * z, lower=0.1 + a * z), (100.0, 0.0, a))],
        [(pair(1e-3, 5.0), (1, 0, 0), (0, 1, 0))],
    )
    return _forced_violation(model, tolerance)


def test_what_a_pair_that_holds_exactly_would_violate():
    """A row loses 0.1 where x goes to 0; z may mend a hundredth of its own size."""
    assert forced(1.0, 0.0) == pytest.approx(0.1)
    assert forced(1.0, 1.0) == pytest.approx((0.1 - 0.01) / 1.1, rel=1e-6)
    assert forced(20.0, 1.0) == pytest.approx(0.0, abs=1e-9)
    assert forced(20.0, 1.0, upper=20.05) == pytest.approx(0.05 / (20.1 + 20.05), rel=1e-6), (
        "which breaks both as much"
    )
    assert forced(1.0, 0.0, tolerance=0.2) == pytest.approx(0.1), "the shortest step is good enough"


def test_a_pair_that_no_small_step_makes_exact_forces_everything():
    x = [row(0.5, lower=0.0), row(5.0, lower=0.0)]
    assert _forced_violation(local(x, pairs=[(pair(0.5, 5.0), (1, 0), (0, 1))]), 1e-6) == INF
    assert _forced_violation(local(x, pairs=[(pair(1e-3, 5.0), (0, 0), (0, 1))]), 1e-6) == INF
    assert _forced_violation(local(x, pairs=[(pair(5.0, 1e-3), (1, 0), (0, 0.0))]), 1e-6) == INF
    assert _forced_violation(local(x, pairs=[(pair(0.0, 5.0), (1, 0), (0, 1))]), 1e-6) == 0.0
    assert (
        _forced_violation(
            local([row(-0.25, lower=0.0), row(5.0)], pairs=[(pair(5.0, 0.0), (1, 0), (0, 1))]), 1e-6
        )
        == 0.25
    )


@pytest.mark.parametrize(("others", "violation"), [(597, 0.0), (598, 0.1 / 20.1)])
def test_of_more_than_six_hundred_variables_the_shortest_step_alone_is_taken(
    others: int, violation: float
):
    """As above with z = 20, which may mend what the row loses."""
    rest = [0.0] * others
    x = [row(1e-3, lower=0.0), row(5.0, lower=0.0), row(20.0), *(row(0.0) for _ in rest)]
    model = local(
        x,
        [(row(20.1, lower=20.1), (100.0, 0.0, 1.0, *rest))],
        [(pair(1e-3, 5.0), (1, 0, 0, *rest), (0, 1, 0, *rest))],
    )
    assert _forced_violation(model, 1e-6) == pytest.approx(violation, abs=1e-9)
    off = local([row(0.5), *x[1:]], pairs=[(pair(0.5, 5.0), (1, 0, 0, *rest), (0, 1, 0, *rest))])
    assert _forced_violation(off, 1e-6) == INF


@pytest.mark.parametrize(("side", "violation"), [(1.7e-9, 0.0), (1.9e-9, 1.9e-3)])
def test_a_side_that_is_rounding_of_its_terms_needs_no_step(side: float, violation: float):
    """x is a million, and so is the constant of its side: four units in the last place of both are 1.78e-9."""
    model = local(
        [row(1e6), row(5.0)], [(row(0.0, lower=0.0), (1e6, 0))], [(pair(side, 5.0), (1, 0), (0, 1))]
    )
    assert _forced_violation(model, 1e-6) == pytest.approx(violation, rel=1e-3)


def test_sides_of_very_different_sizes_are_made_exact_together():
    pairs = [(pair(1e-3, 5.0), (1, 0, 0), (0, 0, 1)), (pair(1e-18, 5.0), (0, 1e-15, 0), (0, 0, 1))]
    assert _forced_violation(local([row(1e-3), row(1e-3), row(5.0)], pairs=pairs), 1e-6) == 0.0


@pytest.mark.parametrize(("apart", "violation"), [(1.9e-6, 0.0), (2.1e-6, INF)])
def test_sides_that_contradict_each_other_by_a_thousandth_are_as_good_as_exact(
    apart: float, violation: float
):
    pairs = [(pair(1e-3, 5.0), (1, 0), (0, 1)), (pair(1e-3 + apart, 5.0), (1, 0), (0, 1))]
    assert _forced_violation(local([row(1e-3), row(5.0)], pairs=pairs), 1e-6) == violation


@pytest.mark.parametrize(
    ("side", "violation"), [(0.0099, 0.0), (0.0101, INF), (-0.0099, 0.0), (-0.0101, INF)]
)
def test_a_step_is_a_hundredth_at_most(side: float, violation: float):
    assert (
        _forced_violation(
            local([row(side), row(5.0)], pairs=[(pair(side, 5.0), (1, 0), (0, 1))]), 1e-6
        )
        == violation
    )
    far = local([row(200.0 + side), row(5.0)], pairs=[(pair(200.0 * side, 5.0), (1, 0), (0, 1))])
    assert _forced_violation(far, 1e-6) == violation


def certificate(**changes: Any) -> Certificate:
    said = {
        "primal": 1e-7, "primal_relative": 1e-6, "complementarity": 1e-6, "product": 0.0,
        "forced": 1e-6, "dual": 2e-7, "given_dual": math.nan,
        "pairs": 9, "biactive": 3, "stationarity": M, "descent": -1e-5, "worst": "least",
        "objective": 0.0,
    }  # fmt: skip
    return Certificate(**(said | changes))


@pytest.mark.parametrize(("changes", "feasible", "lives", "stationary", "holds"), [
    ({}, True, False, True, True), ({"primal_relative": 1.01e-6}, False, False, True, False),
    ({"complementarity": 1.01e-6}, False, False, True, False),
    ({"complementarity": 1.01e-6, "tolerances": Tolerances(complementarity=2e-6)}, True, False,
     True, True),
    ({"primal_relative": 1.01e-6, "tolerances": Tolerances(feasibility=2e-6)}, True, False, True,
     True), ({"forced": 1.01e-6}, False, True, True, False),
    ({"forced": math.nan}, False, True, True, False),
    ({"primal_relative": math.nan}, False, False, True, False),
    ({"descent": -1.01e-5}, True, False, False, False),
    ({"descent": math.nan}, True, False, None, False),
    ({"descent": math.nan, "stationarity": S}, True, False, True, True),
    ({"given_dual": 1e-4}, True, False, True, True),
    ({"given_dual": 1.01e-4}, True, False, True, False),
])  # fmt: skip
def test_what_a_certificate_concludes_at_each_limit(changes, feasible, lives, stationary, holds):
    found = certificate(**changes)
    assert (found.feasible, found.lives_on_tolerance, found.b_stationary, found.holds) == (
        feasible,
        lives,
        stationary,
        holds,
    )


@pytest.mark.parametrize(("changes", "parts", "missing"), [
    ({},
     ["primal 1.0e-07", "complementarity 1.0e-06", "dual 2.0e-07", "class M", "B-stationary",
      "3 of 9 pairs"], ["not", "multipliers", "most in"]),
    ({"descent": -0.25}, ["not B-stationary (slope -2.5e-01 of the gradient)"], []),
    ({"descent": math.nan}, ["B-stationarity unknown"], []),
    ({"primal_relative": 1.0}, ["not feasible, most in least", "in no class"], ["class M"]),
    ({"complementarity": 1.0}, ["not feasible, so"], ["most in"]),
    ({"primal_relative": 1.0, "worst": ""}, ["not feasible, so"], ["most in"]),
    ({"least": 0.125}, ["with multipliers of at least 0.125"], ["unique"]),
    ({"least": 0.125, "unique": True}, ["with unique multipliers of at least 0.125"], []),
    ({"least": 0.125, "biactive": 0}, ["0 of 9 pairs"], ["multipliers"]),
])  # fmt: skip
def test_a_certificate_in_words(changes: dict[str, Any], parts: list[str], missing: list[str]):
    words = certificate(**changes).sentence
    assert not unsaid(words, *parts)
    assert [part for part in missing if part in words] == [], words


def test_limits_of_a_plan_are_tighter_than_those_of_any_point():
    assert Tolerances(feasibility=1e-8, complementarity=1e-7) == PLAN_TOLERANCES
    assert Tolerances() == Tolerances(feasibility=1e-6, complementarity=1e-6)


@pytest.mark.parametrize(("variables", "choices", "biactive", "nodes"), [
    (100, 2, 10, 2048), (100, 2, 11, 12), (400, 2, 8, 512), (400, 2, 9, 12), (10**6, 2, 3, 16),
    (10**6, 2, 4, 12), (0, 3, 0, 2), (100, 3, 6, 1458),
    (100, 3, 7, 12),
])  # fmt: skip
def test_a_tree_is_searched_to_its_end_where_that_costs_little(
    variables: int, choices: int, biactive: int, nodes: int
):
    """1024 leaves at most, fewer where 200 000 are not enough for each to have one of every variable, but always 8; else 12 nodes."""
    active: Any = SimpleNamespace(gradient=np.zeros(variables), both=np.arange(biactive))
    assert affordable(active, choices) == nodes


def test_what_is_no_model_is_refused():
    with pytest.raises(ModelRefusedError, match="expected a Pyomo ConcreteModel or Block, got str"):
        certify("small.nl")


def at(x: float | None, y: float | None) -> str:
    """Of min (x - 1)^2 + (y - 2)^2, where x and y complement each other and x <= 3."""
    m = nearest(x, y)
    m.least = pyo.Constraint(expr=m.x <= 3)
    return certify(m).sentence


def test_a_stationary_point_has_a_class():
    assert [
        part for part in ("class S", ", B-stationary", "0 of 1 pairs") if part not in at(0.0, 2.0)
    ] == []


@pytest.mark.parametrize(
    ("x", "y", "parts"),
    [(5.0, 0.0, ["not feasible", "most in least", "in no class"]),
     (0.5, 0.5, ["not feasible, so", "in no class"]), (None, None, ["in no class"])],
)  # fmt: skip
def test_a_point_that_is_not_feasible_is_of_no_class(x, y, parts):
    assert [part for part in parts if part not in at(x, y)] == []
    assert "B-stationar" not in at(x, y)


@pytest.mark.parametrize("x", [-1.0, 0.0, 0.5, 1.0, 2.0])
def test_no_point_is_in_a_range_that_holds_no_number(x):
    """1 <= x <= p at p = 0: x breaks one of the two by a half at least, wherever it is."""
    m = pyo.ConcreteModel()
    m.p = pyo.Param(initialize=0.0, mutable=True)
    m.x, m.y = pyo.Var(initialize=x), pyo.Var(initialize=2.0)
    m.cost = pyo.Objective(expr=(m.x - 1) ** 2 + (m.y - 2) ** 2)
    m.pair = Complementarity(expr=complements(pyo.inequality(1, m.x, m.p), m.y))
    found = certify(m)
    assert not found.holds
    assert found.primal >= 0.5
    m.p.set_value(3.0)
    m.y.set_value(0.0)
    assert certify(m).primal == max(0.0, 1.0 - x)

"""The parts of a certificate by hand: what is active, what multipliers leave, what is forced where pairs hold exactly, and what it says in words."""

import math
from typing import Any

import numpy as np
import pyomo.environ as pyo
import pytest
import scipy.sparse as sparse
from pyomo.mpec import Complementarity, complements
from wording import unsaid

from formulations.certificate.certificate import (
    Certificate,
    Multipliers,
    Tolerances,
    _forced_violation,
    _given_residual,
    _is_finite,
    _largest,
)
from formulations.certificate.local import LocalModel
from formulations.certificate.plan import PLAN_TOLERANCES
from formulations.certificate.stationarity import Stationarity, active_set, at_bounds
from formulations.ipopt import ModelRefusedError
from formulations.mpec import certify
from tests.formulations.mpec.local_models import INF, Row, local, pair, row, together
from tests.formulations.nearest import nearest


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
    assert found.sizes.tolist() == [15, 24, 1, 1, 2, 4, 3, 4]
    np.testing.assert_allclose((sparse.diags(found.sizes) @ found.normals).toarray(), [
        [4, 5, 6], [7, 8, 9], [1, 0, 0], [0, 1, 0], [1, 0, 1], [3, 0, 1], [0, 2, 1], [0, 3, 1],
    ])  # fmt: skip
    assert found.lowest.tolist() == [0, -INF, 0, -INF, -INF, 0, -INF, 0]
    assert found.highest.tolist() == [INF, 0, INF, 0, INF, INF, INF, INF]
    assert (found.both.tolist(), found.first.tolist(), found.second.tolist()) == ([2], [5], [7])


def test_active_set_without_conditions_is_empty():
    found = active_set(local([]), 0.1)
    assert (found.normals.shape, found.lowest.tolist(), found.both.tolist()) == ((0, 0), [], [])


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
    gradient=(4.0, -8.0), scale=8.0,
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
    found = _given_residual(BOX, Multipliers(rows=rows, bounds=bounds, pairs=pairs))
    assert found == pytest.approx(left / 8.0)


@pytest.mark.parametrize("given", [(3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0)])
@pytest.mark.parametrize(("distance", "left"), [(10.0, 3.0), (1e-5, 3.0), (5e-7, 1.5e-6)])
def test_a_multiplier_of_a_side_counts_whole_where_it_is_open_else_by_its_distance(
    given, distance, left
):
    """It leaves nothing of the gradient, but its side is not 0."""
    one = pair(distance, distance)
    model = local([row(1.0)], pairs=[(one, (1.0,), (1.0,))], gradient=(sum(given),), scale=3.0)
    assert _given_residual(model, Multipliers(pairs={one.source: given})) == pytest.approx(
        left / 3.0
    )
    near = pair(-10.0, -20.0)
    model = local([row(1.0)], pairs=[(near, (1.0,), (1.0,))], gradient=(sum(given),))
    assert _given_residual(model, Multipliers(pairs={near.source: given})) == 0.0


@pytest.mark.parametrize("others", [0, 1000])
def test_forced_violation_row_that_lives_on_a_side(others: int):
    """x = 1e-3 and y = 5 complement each other; 100 x >= 0.1 loses 0.1 where x goes to 0."""
    rest = [0.0] * others
    x = [row(1e-3, lower=0.0), row(5.0, lower=0.0), *(row(0.0) for _ in rest)]
    model = local(
        x,
        [(row(0.1, lower=0.1), (100.0, 0.0, *rest)), (row(9.0, upper=30.0), (100.0, 0.0, *rest))],
        [(pair(1e-3, 5.0), (1, 0, *rest), (0, 1, *rest))],
    )
    assert _forced_violation(model) == pytest.approx(0.1)
    off = local([row(0.5), *x[1:]], pairs=[(pair(0.5, 5.0), (1, 0, *rest), (0, 1, *rest))])
    assert _forced_violation(off) == INF


@pytest.mark.parametrize(("x", "violation"), [(1e-7, 0.0), (0.99e-4, 0.0), (1.5e-4, 0.5e-2)])
def test_forced_violation_other_variable_follows_side(x: float, violation: float):
    """If x closes, 100 x = w moves w by 100 x, but by 0.01 at most."""
    model = local(
        [row(x), row(5.0), row(100 * x)],
        [(row(0.0, lower=0.0, upper=0.0), (100.0, 0.0, -1.0)), (row(-1.0, upper=0.0), (0, 0, 1))],
        [(pair(x, 5.0), (1, 0, 0), (0, 1, 0))],
    )
    assert _forced_violation(model) == pytest.approx(violation, rel=1e-6, abs=1e-6 * x)


def test_a_pair_that_no_small_step_makes_exact_forces_everything():
    x = [row(0.5, lower=0.0), row(5.0, lower=0.0)]
    assert _forced_violation(local(x, pairs=[(pair(0.5, 5.0), (1, 0), (0, 1))])) == INF
    assert _forced_violation(local(x, pairs=[(pair(1e-3, 5.0), (0, 0), (0, 1))])) == INF
    assert _forced_violation(local(x, pairs=[(pair(5.0, 1e-3), (1, 0), (0, 0.0))])) == INF
    assert _forced_violation(local(x, pairs=[(pair(0.0, 5.0), (1, 0), (0, 1))])) == 0.0
    below = local([row(-0.25, lower=0.0), row(5.0)], pairs=[(pair(5.0, 0.0), (1, 0), (0, 1))])
    assert _forced_violation(below) == 0.25


@pytest.mark.parametrize(("side", "violation"), [(1.7e-9, 0.0), (1.9e-9, 1.9e-3)])
def test_a_side_that_is_rounding_of_its_terms_needs_no_step(side: float, violation: float):
    """x is a million, and so is the constant of its side: four units in the last place of both are 1.78e-9."""
    model = local(
        [row(1e6), row(5.0)], [(row(0.0, lower=0.0), (1e6, 0))], [(pair(side, 5.0), (1, 0), (0, 1))]
    )
    assert _forced_violation(model) == pytest.approx(violation, rel=1e-3)


def test_sides_of_very_different_sizes_are_made_exact_together():
    pairs = [(pair(1e-3, 5.0), (1, 0, 0), (0, 0, 1)), (pair(1e-18, 5.0), (0, 1e-15, 0), (0, 0, 1))]
    assert _forced_violation(local([row(1e-3), row(1e-3), row(5.0)], pairs=pairs)) == 0.0


@pytest.mark.parametrize(("apart", "violation"), [(1.9e-6, 0.0), (2.1e-6, INF)])
def test_sides_that_contradict_each_other_by_a_thousandth_are_as_good_as_exact(
    apart: float, violation: float
):
    pairs = [(pair(1e-3, 5.0), (1, 0), (0, 1)), (pair(1e-3 + apart, 5.0), (1, 0), (0, 1))]
    assert _forced_violation(local([row(1e-3), row(5.0)], pairs=pairs)) == violation


@pytest.mark.parametrize(
    ("side", "violation"), [(0.0099, 0.0), (0.0101, INF), (-0.0099, 0.0), (-0.0101, INF)]
)
def test_a_step_is_a_hundredth_at_most(side: float, violation: float):
    near = local([row(side), row(5.0)], pairs=[(pair(side, 5.0), (1, 0), (0, 1))])
    assert _forced_violation(near) == pytest.approx(violation)
    far = local([row(200.0 + side), row(5.0)], pairs=[(pair(200.0 * side, 5.0), (1, 0), (0, 1))])
    assert _forced_violation(far) == violation


def certificate(**changes: Any) -> Certificate:
    said = {
        "primal": 1e-7, "primal_relative": 1e-6, "complementarity": 1e-6, "forced": 1e-6,
        "dual": 2e-7, "given_dual": math.nan,
        "pairs": 9, "biactive": 3, "stationarity": Stationarity.WEAK, "obstacle": "a sign",
        "descent": -1e-5, "worst": "least", "objective": 0.0,
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
    ({"descent": math.nan, "stationarity": Stationarity.STRONG}, True, False, True, True),
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
     ["primal 1.0e-07", "complementarity 1.0e-06", "dual 2.0e-07", "not S-stationary (a sign)",
      "but B-stationary", "3 of 9 pairs"], ["most in", "not feasible"]),
    ({"stationarity": Stationarity.STRONG}, ["; S-stationary, 3 of 9 pairs"],
     ["not", "B-stationary", "a sign"]),
    ({"descent": -0.25}, ["not B-stationary", "(slope -2.5e-01 of the gradient)"], ["but"]),
    ({"descent": math.nan}, ["B-stationarity unknown"], []),
    ({"primal_relative": 1.0}, ["not feasible, most in least", "not stationary"], ["S-stationary"]),
    ({"complementarity": 1.0}, ["not feasible, so"], ["most in"]),
    ({"primal_relative": 1.0, "worst": ""}, ["not feasible, so"], ["most in"]),
    ({"biactive": 0}, ["0 of 9 pairs"], []),
])  # fmt: skip
def test_a_certificate_in_words(changes: dict[str, Any], parts: list[str], missing: list[str]):
    words = certificate(**changes).sentence
    assert not unsaid(words, *parts)
    assert [part for part in missing if part in words] == [], words


def test_limits_of_a_plan_are_tighter_than_those_of_any_point():
    assert Tolerances(feasibility=1e-8, complementarity=1e-7) == PLAN_TOLERANCES
    assert Tolerances() == Tolerances(feasibility=1e-6, complementarity=1e-6)


def test_what_is_no_model_is_refused():
    with pytest.raises(ModelRefusedError, match="expected a Pyomo ConcreteModel or Block, got str"):
        certify("small.nl")


def at(x: float | None, y: float | None) -> str:
    """Of min (x - 1)^2 + (y - 2)^2, where x and y complement each other and x <= 3."""
    m = nearest(x, y)
    m.least = pyo.Constraint(expr=m.x <= 3)
    return certify(m).sentence


def test_certify_solution_is_strongly_stationary():
    assert "; S-stationary, 0 of 1 pairs" in at(0.0, 2.0)


@pytest.mark.parametrize(
    ("x", "y", "parts"),
    [(5.0, 0.0, ["not feasible", "most in least", "not stationary"]),
     (0.5, 0.5, ["not feasible, so", "not stationary"]), (None, None, ["not stationary"])],
)  # fmt: skip
def test_certify_infeasible_point_is_not_stationary(x, y, parts):
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

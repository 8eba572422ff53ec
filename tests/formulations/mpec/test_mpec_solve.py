"""SolverFactory("mpec_ipopt"): the model is left as it was, the answer is certified, endings are honest, multipliers come where they are asked for; points that satisfy every residual only because complementarity is not exact are no solutions."""

import io
import itertools
import logging
import math

import numpy as np
import pyomo.environ as pyo
import pytest
from pyomo.common.collections import ComponentMap
from pyomo.mpec import Complementarity, complements
from pyomo.opt import SolverStatus, TerminationCondition

from formulations.mpec import (
    STRATEGY_NAMES,
    MpecSettings,
    Multipliers,
    Stationarity,
    certify,
    solve_mpec,
)
from formulations.mpec.branching import Branching
from formulations.mpec.homotopy import WorkBudget, Workspace, compile_branches
from formulations.mpec.lifted import lift
from formulations.mpec.strategies import STRATEGIES
from formulations.solution import Outcome
from tests.formulations.mpec.published import jr1, ralph1
from tests.formulations.nearest import solver


@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
@pytest.mark.parametrize(
    ("problem", "point", "stationarity", "biactive"),
    [(jr1, (0.5, 0.5), Stationarity.STRONG, 0), (ralph1, (0.0, 0.0), Stationarity.WEAK, 1)],
)
def test_every_strategy_ends_at_the_solution_and_knows_its_class(
    strategy, problem, point, stationarity, biactive
):
    """The origin of ralph1 is B-stationary, but its multipliers are not those of an S point."""
    m, plugin = problem(), solver(strategy=strategy)
    pyo.assert_optimal_termination(plugin.solve(m))
    told = plugin.last_result
    assert (m.a.value, m.b.value) == pytest.approx(point, abs=1e-8)
    assert (
        told.certificate.stationarity,
        told.certificate.b_stationary,
        told.certificate.biactive,
    ) == (stationarity, True, biactive)
    assert all(min(abs(pair.first), abs(pair.second)) <= 1e-12 for pair in told.pairs)


@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
def test_every_relaxation_leads_there_without_polish(strategy):
    """Where the path went astray, the branches would hide it."""
    result = solve_mpec(jr1(), MpecSettings(strategy=strategy, polish=False))
    assert result.solved, result.message
    assert not result.polished
    assert result.residual <= 1e-8
    assert result.objective == pytest.approx(0.5, abs=1e-7)


def test_a_point_that_is_not_stationary_is_not_certified():
    m = jr1()
    m.a.value, m.b.value = 0.0, 0.0  # feasible, biactive, and downhill along a = b
    certificate = certify(m)
    assert certificate.feasible
    assert certificate.b_stationary is False
    assert certificate.descent < -0.1
    assert not certificate.holds


def test_a_violated_complementarity_is_measured_in_the_models_units():
    m = jr1()
    m.a.value, m.b.value = -1.0, 3.0
    certificate = certify(m)
    assert certificate.complementarity == pytest.approx(3.0)
    assert not certificate.feasible
    assert math.isfinite(certificate.dual)


def two(cost, bounds=(0.0, None), start=1.0) -> pyo.ConcreteModel:
    m = pyo.ConcreteModel(name="two")
    m.x = pyo.Var(bounds=bounds, initialize=start)
    m.y = pyo.Var(bounds=bounds, initialize=start)
    m.row = pyo.Constraint(expr=m.x + m.y <= 10)
    m.cost = pyo.Objective(expr=cost(m))
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    return m


def near(m):
    return (m.x - 1) ** 2 + (m.y - 2) ** 2


def picture(model) -> tuple[str, list]:
    """All there is: the printed model, and which objects it consists of."""
    stream = io.StringIO()
    model.pprint(ostream=stream)
    return stream.getvalue(), [(id(c), c.ctype) for c in model.component_objects(descend_into=True)]


# -- the model is left as it was
#   ---------------------------------------------------------------------------------------------------------
def test_solving_without_loading_leaves_no_trace():
    m = two(near)
    m.later = pyo.Var()
    m.x.stale = True
    before = picture(m)
    results = solver().solve(m, load_solutions=False)
    assert picture(m) == before
    m.solutions.load_from(results)
    assert (m.x.value, m.y.value) == pytest.approx((0, 2), abs=1e-8)


def test_loading_changes_values_only():
    m = two(near)
    components = picture(m)[1]
    solver().solve(m)
    assert picture(m)[1] == components
    assert m.pair.ctype is Complementarity
    assert m.x.bounds == (0.0, None)
    solver().solve(m)  # and again
    assert m.y.value == pytest.approx(2, abs=1e-8)


@pytest.mark.parametrize(
    "where",
    ["formulations.mpec.homotopy", "formulations.mpec.branching", "formulations.mpec.solve"],
)
def test_ctrl_c_and_failures_leave_no_trace(monkeypatch, where):
    """In the path, in a branch, and while the certificate has the point in the model's variables."""
    target = {
        "formulations.mpec.homotopy": "natural_residual",
        "formulations.mpec.branching": "refined",
        "formulations.mpec.solve": "certify",
    }[where]
    for error in (KeyboardInterrupt, RuntimeError):

        def interrupt(*_, error=error, **__):
            raise error

        monkeypatch.setattr(f"{where}.{target}", interrupt)
        m = two(near)
        before = picture(m)
        with pytest.raises(error):
            solver().solve(m)
        assert picture(m) == before


def test_ctrl_c_inside_ipopt_arrives(monkeypatch):
    m = two(near)
    before = picture(m)
    calls = []

    def interrupt(self, x, lagrange, factor):
        calls.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr("formulations.ipopt.problem.IpoptProblem.hessian", interrupt)
    with pytest.raises(KeyboardInterrupt):
        solver().solve(m)
    assert calls
    assert picture(m) == before


# -- endings
#   -----------------------------------------------------------------------------------------------------------------------------
def _both_at_least_one(m):
    """On both axes, which only the pair forbids."""
    m.both = pyo.Constraint([1, 2], rule=lambda m, i: (m.x, m.y)[i - 1] >= 1)


def _without_end(m):
    m.row.deactivate()
    m.cost.set_value(-m.x)


def _crossed(m):
    m.x.setlb(3)
    m.x.setub(2)


@pytest.mark.parametrize(("change", "ended", "words"), [
    (lambda m: m.add_component("apart", pyo.Constraint(expr=m.x + m.y <= -1)), "infeasible", ""),
    (_both_at_least_one, "infeasible", "branches"),
    (_crossed, "infeasible", "'x'"), (_without_end, "unbounded", ""),
])  # fmt: skip
def test_what_has_no_solution_is_a_warning(change, ended, words, caplog):
    m = two(near)
    change(m)
    with caplog.at_level(logging.WARNING):
        results = solver().solve(m)
    assert results.solver.termination_condition == TerminationCondition(ended)
    assert results.solver.status == SolverStatus.warning
    assert words in results.solver.message
    if ended == "infeasible":
        assert (m.x.value, m.y.value) == (1.0, 1.0)  # nothing worth loading


def _repeated(m):
    """Active at (0, 2), seven rows in all."""
    m.again = pyo.ConstraintList()
    for _ in range(3):
        m.again.add(m.x + m.y <= 2)
        m.again.add(2 * m.x + 2 * m.y <= 4)


def _bounded_by_its_pair(m):
    """min -x y: unbounded on the quadrant, 0 on its axes."""
    m.cost.set_value(-m.x * m.y + m.x + m.y)
    m.row.deactivate()


@pytest.mark.parametrize(
    ("change", "point"),
    [(_bounded_by_its_pair, (0, 0)), (_repeated, (0, 2)), (lambda m: m.pair.deactivate(), (1, 2))],
)
def test_what_is_odd_of_a_model_does_not_matter(change, point):
    m = two(near)
    change(m)
    pyo.assert_optimal_termination(solver().solve(m))
    assert (m.x.value, m.y.value) == pytest.approx(point, abs=1e-7 if point == (1, 2) else 1e-8)


def test_biactive_and_strongly_stationary():
    m = two(lambda m: (m.x + 1) ** 2 + (m.y + 2) ** 2)
    made = solver()
    made.solve(m)
    certificate = made.last_result.certificate
    assert (certificate.biactive, certificate.stationarity) == (1, Stationarity.STRONG)
    (pair,) = made.last_result.pairs
    assert (pair.first_multiplier, pair.second_multiplier) == pytest.approx((2, 4), abs=1e-6)


def test_a_biactive_pair_that_wants_its_other_branch_gets_it():
    """With x held at 0, y ends at 0 too, and x is worth more than 0: the multiplier says so."""
    m = two(lambda m: (m.x - 1) ** 2 + (m.y + 1) ** 2)
    work = Workspace(
        lifted := lift(m),
        compile_branches(lifted),
        STRATEGIES["scholtes"],
        MpecSettings(),
        WorkBudget(None),
    )
    x = np.zeros(work.relaxed.problem.n)
    x[work.relaxed.second] = 1.0  # y > x: the branch read off holds x
    branching = Branching(work, x)
    branch = branching.polish(x)
    assert branch.objective == pytest.approx(1.0, abs=1e-8)
    assert branch.is_strong


def test_a_model_without_objective_is_made_feasible():
    m = two(near)
    m.cost.deactivate()
    m.far = pyo.Constraint(expr=m.x + m.y == 3)
    results = solver().solve(m)
    pyo.assert_optimal_termination(results)
    assert min(m.x.value, m.y.value) == pytest.approx(0, abs=1e-10)
    assert m.x.value + m.y.value == pytest.approx(3)


def test_an_empty_model():
    m = pyo.ConcreteModel(name="empty")
    pyo.assert_optimal_termination(solver().solve(m))


def test_a_maximised_objective():
    m = two(near)
    m.cost.deactivate()
    m.gain = pyo.Objective(expr=-near(m), sense=pyo.maximize)
    for strategy in ("scholtes", "l1_penalty"):
        result = solve_mpec(m, MpecSettings(strategy=strategy))
        assert result.solved
        assert result.objective == pytest.approx(-1.0, abs=1e-8)


def test_limits_are_told():
    assert (
        solve_mpec(two(near), MpecSettings(strategy="scholtes", step_iterations=1)).outcome
        is Outcome.ITERATION_LIMIT
    )
    assert solve_mpec(two(near), time_limit=1e-9).outcome is Outcome.TIME_LIMIT


# -- multipliers
#   -------------------------------------------------------------------------------------------------------------------------
def test_duals_are_loaded_with_pyomos_signs():
    """min (x - 1)^2 + (y - 2)^2 with y <= 1.5 on the y axis: the row costs 1 for each unit, the side x = 0 costs -2 (it is held, not wanted)."""
    m = two(near)
    m.top = pyo.Constraint(expr=m.y <= 1.5)
    m.dual = pyo.Suffix(direction=pyo.Suffix.IMPORT)
    m.ipopt_zL_out = pyo.Suffix(direction=pyo.Suffix.IMPORT)
    solver().solve(m)
    assert m.dual[m.top] == pytest.approx(-1, abs=1e-6)
    assert m.dual[m.row] == pytest.approx(0, abs=1e-6)
    assert m.ipopt_zL_out[m.x] == pytest.approx(-2, abs=1e-6)
    assert m.ipopt_zL_out[m.y] == pytest.approx(0, abs=1e-6)


def test_right_and_wrong_multipliers():
    m = two(near)
    m.x.value, m.y.value = 0.0, 2.0
    right = Multipliers(pairs=ComponentMap([(m.pair, (-2.0, 0.0))]))
    assert certify(m, right).given_dual <= 1e-12
    assert certify(m, right).holds
    for wrong in (
        (-2.0, 0.5),
        (2.0, 0.0),
        (0.0, 0.0),
    ):  # on the side that is free; with the wrong sign; missing
        certificate = certify(m, Multipliers(pairs=ComponentMap([(m.pair, wrong)])))
        assert certificate.given_dual > 0.1
        assert not certificate.holds
        assert certificate.stationarity is Stationarity.STRONG  # the point is right all the same
    assert (
        certify(m, Multipliers(rows=ComponentMap([(m.row, -1.0)]), pairs=right.pairs)).given_dual
        > 0.1
    )


def test_a_solver_that_lies_about_multipliers_is_found_out(monkeypatch):
    """Multipliers that do not belong to the point are not returned: the certificate computes its own."""
    import formulations.mpec.solve as module

    def shifted(candidate):
        told = honest(candidate)
        return Multipliers(
            rows=told.rows,
            bounds=told.bounds,
            pairs=ComponentMap((c, (a + 1.0, b)) for c, (a, b) in told.pairs.items()),
        )

    honest = module.multipliers_of
    monkeypatch.setattr(module, "multipliers_of", shifted)
    result = solve_mpec(two(near))
    assert result.solved
    assert not result.has_multipliers
    assert math.isnan(result.zl[0])


# x and y must not both be 0 in any of them, as far as the other row goes: none has a solution.
IMPOSSIBLE = {
    "product": lambda m: m.x * m.y >= 1, "small product": lambda m: m.x * m.y >= 1e-4,
    "quadratic": lambda m: m.x**2 * m.y >= 1,
    "root": lambda m: pyo.sqrt(m.x) * m.y >= 1, "large coefficient": lambda m: 1e8 * m.x >= m.y + 1,
}  # fmt: skip


def impossible(name: str, bounded: bool, expression: bool) -> pyo.ConcreteModel:
    m = pyo.ConcreteModel(name=name)
    lower = 0.0 if bounded else None
    m.x, m.y = (
        pyo.Var(bounds=(lower, None), initialize=1.0),
        pyo.Var(bounds=(lower, None), initialize=1.0),
    )
    m.cost = pyo.Objective(expr=m.x + m.y)
    m.row = pyo.Constraint(expr=IMPOSSIBLE[name](m))
    first, second = (m.x + 0 * m.y, 2 * m.y) if expression else (m.x, m.y)
    m.pair = Complementarity(expr=complements(first >= 0, second >= 0))
    if name == "large coefficient":
        m.second_row = pyo.Constraint(expr=m.y >= 0.1)
    return m


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "bounded", "expression"),
    [("product", False, False), ("product", True, True),
     *((name, place % 2 == 0, place % 2 == 0) for place, name in enumerate(IMPOSSIBLE) if place)],
)  # fmt: skip
def test_nothing_is_optimal_where_nothing_is_feasible(name, bounded, expression):
    """Nor unbounded: iterates that leave for infinity while the objective rises prove nothing."""
    result = solve_mpec(impossible(name, bounded, expression))
    assert result.outcome not in (Outcome.SOLVED, Outcome.DIVERGED), result.message


@pytest.mark.parametrize(("x", "y"), [(5e-13, 2e12), (1e-9, 1e9), (2e12, 5e-13)])
def test_a_point_that_lives_on_the_tolerance_is_not_feasible(x, y):
    m = impossible("product", bounded=True, expression=False)
    m.x.value, m.y.value = x, y
    certificate = certify(m)
    assert certificate.complementarity <= 1e-8
    assert certificate.primal <= 1e-12
    assert certificate.forced == pytest.approx(1.0, abs=0.1)
    assert certificate.lives_on_tolerance
    assert not certificate.feasible
    assert "feasible only because complementarity is not exact" in certificate.sentence
    assert "stationary" not in certificate.sentence


def test_a_product_that_nothing_needs_is_feasible():
    """A large force beside a gap of 1e-9: nothing but the tolerance, and the constraints hold without it as well."""
    m = pyo.ConcreteModel()
    m.gap, m.force = pyo.Var(initialize=1e-9), pyo.Var(initialize=1e6)
    m.pull = pyo.Constraint(expr=m.force - 1e6 * m.gap == 1e6)
    m.pair = Complementarity(expr=complements(m.gap >= 0, m.force >= 0))
    certificate = certify(m)
    assert certificate.feasible


def test_sides_that_are_variables_end_exactly_at_zero():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(3), bounds=(0, None), initialize=0.3)
    m.y = pyo.Var(range(3), bounds=(0, None), initialize=0.4)
    m.cost = pyo.Objective(expr=sum((m.x[i] - i) ** 2 + (m.y[i] - 1) ** 2 for i in range(3)))
    m.pair = Complementarity(range(3), rule=lambda m, i: complements(m.x[i] >= 0, m.y[i] >= 0))
    pyo.SolverFactory("mpec_ipopt").solve(m)
    assert [min(m.x[i].value, m.y[i].value) for i in range(3)] == [0.0, 0.0, 0.0]


def test_every_branch_infeasible_is_told():
    m = impossible("large coefficient", bounded=True, expression=False)
    m.cap = pyo.Constraint(expr=m.y <= 1)
    result = solve_mpec(m)
    assert result.outcome is Outcome.INFEASIBLE
    assert "branches" in result.message


def test_a_descent_into_an_unbounded_branch_is_unbounded():
    """At the origin y alone may grow, where the objective falls without end."""
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(initialize=1.0), pyo.Var(initialize=0.0)
    m.cost = pyo.Objective(expr=m.x**2 - m.y)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    assert solve_mpec(m).outcome is Outcome.DIVERGED


@pytest.mark.parametrize("times", [1, 2, 3])
@pytest.mark.parametrize("has_idle", [True, False])
def test_rows_that_say_nothing_new_do_not_hide_the_objective(times, has_idle):
    """x - y >= 1/4 holds as an equation, once or more often, beside a pair whose one side is 0: as many equations as variables, and y to choose."""
    m = pyo.ConcreteModel()
    m.x, m.y, m.zero = (
        pyo.Var(bounds=(0, 2), initialize=0.0),
        pyo.Var(bounds=(0, 2), initialize=0.0),
        pyo.Var(initialize=0.0),
    )
    m.zero.fix()
    m.pair = Complementarity(
        range(times), rule=lambda m, _: complements(m.x - m.y >= 0.25, 3 - m.x >= 0)
    )
    if has_idle:
        m.idle = Complementarity(expr=complements(m.zero >= 0, m.x + m.y <= 3))
    m.cost = pyo.Objective(expr=(m.x + 1) ** 2 + (m.y + 1) ** 2)
    result = solve_mpec(m)
    assert (result.solved, result.objective) == (True, pytest.approx(1.25**2 + 1.0, abs=1e-9))


@pytest.mark.parametrize(
    ("levels_off", "limit", "furthest"),
    [
        (lambda x: 1 - pyo.exp(-x), 0.999, math.log(1000)),
        (lambda x: pyo.tanh(x / 10), 0.999, 10 * math.atanh(0.999)),
    ],
)
def test_where_a_row_levels_off_far_out_nothing_is_unbounded(levels_off, limit, furthest):
    """At x = 1e20 the row is violated by 1e-3 only, which is no rounding of terms that are below 1."""
    m = two(near)
    m.z = pyo.Var(bounds=(0, None), initialize=0.0)
    m.row = pyo.Constraint(expr=levels_off(m.z) <= limit)
    m.cost.expr -= m.z
    result = solve_mpec(m)
    assert (result.solved, result.objective) == (True, pytest.approx(1.0 - furthest, rel=1e-6))


# -- nothing feasible near the start
#   -----------------------------------------------------------------------------------------------------------
def _some_of(numbers, total):
    """Each number counts or not, and they are to add up."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(len(numbers)), initialize=0.5)
    m.choice = Complementarity(
        range(len(numbers)), rule=lambda m, i: complements(m.x[i] >= 0, 1 - m.x[i] >= 0)
    )
    m.sum = pyo.Constraint(expr=sum(number * m.x[i] for i, number in enumerate(numbers)) == total)
    m.cost = pyo.Objective(expr=sum(m.x[i] for i in m.x))
    return m


def test_branches_are_tried_where_nothing_feasible_is_known():
    """With more pairs than `max_biactive`."""
    numbers, total = [72, 83, 21, 83, 57, 60, 69], 143
    fewest = min(
        n
        for n in range(8)
        if any(sum(some) == total for some in itertools.combinations(numbers, n))
    )
    result = solve_mpec(_some_of(numbers, total))
    assert (result.solved, result.objective) == (True, pytest.approx(fewest))
    assert "smoothing refused (more equations than variables, each pair is one)" in result.message


@pytest.mark.parametrize(
    ("entries", "tried"),
    [(1e7, "each of the 128 branches"), (1.0, "each of the nearest 1 of the 128 branches")],
)
def test_how_many_branches_are_infeasible_is_told(monkeypatch, entries, tried):
    """Seven numbers of 1 do not add up to 10; a large problem has no work for all branches."""
    monkeypatch.setattr("formulations.mpec.solve._ENTRIES", entries)
    assert tried in solve_mpec(_some_of([1] * 7, 10), MpecSettings(strategy="scholtes")).message


def test_what_is_infeasible_near_the_start_is_told_as_that():
    """An odd sum of even numbers; a bound above another needs no search, and is told as it was."""
    result = solve_mpec(_some_of([2 * number for number in (72, 83, 21, 83, 57, 60, 69)], 141))
    assert result.outcome is Outcome.INFEASIBLE
    assert (
        "no feasible point was found near the start; another start may find one" in result.message
    )
    assert "learning rate" not in repr(result.attempts)
    m = two(near)
    _crossed(m)
    assert "near the start" not in solve_mpec(m).message


def test_solve_from_biactive_origin_reaches_a_solution():
    """The origin of min (x - 1)^2 + (y - 1)^2 on two axes is feasible, but not stationary."""
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(bounds=(0, None), initialize=0.0), pyo.Var(bounds=(0, None), initialize=0.0)
    m.cost = pyo.Objective(expr=(m.x - 1) ** 2 + (m.y - 1) ** 2)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    result = solve_mpec(m)
    assert result.solved
    assert result.objective == pytest.approx(1.0, abs=1e-8)
    assert result.certificate is not None
    assert result.certificate.strong

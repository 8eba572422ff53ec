"""Solving: known optima, every way of ending, warm starts, and the check that does not take Ipopt's word."""

from __future__ import annotations

import math
import pathlib

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.ipopt import (
    STATUS_MAP,
    STATUS_NAMES,
    Start,
    UnknownOptionError,
    compile_model,
    known_options,
    load,
    outcome_of,
    residuals,
    solve,
)
from formulations.ipopt.backend import Answer, Cyipopt
from formulations.ipopt.evaluations import Evaluations
from formulations.solution import Outcome


@pytest.mark.parametrize(("eps", "cost"), [(1e-3, 197.86), (1e-5, 261.23)])
def test_three_carts_reach_the_known_costs(three_carts, eps, cost):
    problem = compile_model(three_carts(500, eps))
    result = solve(problem)
    assert result.outcome is Outcome.SOLVED
    assert result.objective == pytest.approx(cost, abs=0.005)  # known to two digits after the point
    assert result.residuals.constraint_violation < 1e-10


def test_the_same_problem_follows_its_param(three_carts):
    model = three_carts(100, 1e-2)
    problem = compile_model(model)
    first = solve(problem)
    model.b.value = abs(math.log(1e-3))
    problem.refresh()
    followed = solve(problem, warm_start=Start(x=first.x))
    fresh = solve(compile_model(three_carts(100, 1e-3)))
    assert followed.objective == pytest.approx(fresh.objective, rel=1e-8)
    assert abs(followed.objective - first.objective) > 1.0


def test_the_same_start_gives_the_same_bits(three_carts):
    problem = compile_model(three_carts(60))
    first, second = solve(problem), solve(problem)
    assert np.array_equal(first.x, second.x)
    assert [i.objective for i in first.history] == [i.objective for i in second.history]


def test_a_primal_dual_start_at_the_solution_ends_at_once(three_carts):
    problem = compile_model(three_carts(100))
    cold = solve(problem)
    warm = solve(problem, warm_start=Start(x=cold.x, lagrange=cold.lagrange, zl=cold.zl, zu=cold.zu))
    assert warm.iterations <= 2 < cold.iterations
    assert warm.objective == pytest.approx(cold.objective, rel=1e-9)
    partly = solve(problem, warm_start=Start(x=cold.x, lagrange=cold.lagrange))
    assert partly.iterations <= 3


def quadratic(**keywords):
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize=0.5, **keywords)
    m.cost = pyo.Objective(expr=(m.x[1] - 1) ** 2 + (m.x[2] - 2) ** 2)
    return m


def test_solve_leaves_the_model_and_load_writes_it():
    m = quadratic()
    problem = compile_model(m)
    result = solve(problem)
    assert m.x[1].value == 0.5
    load(problem, result)
    assert [m.x[i].value for i in (1, 2)] == pytest.approx([1.0, 2.0])
    assert not m.x[1].stale


def test_history_has_one_line_an_iteration_and_seconds_add_up():
    m = quadratic(bounds=(-1, 1.5))
    m.c = pyo.Constraint(expr=pyo.exp(m.x[1]) + m.x[2] <= 3)
    result = solve(compile_model(m))
    assert [line.iteration for line in result.history] == list(range(result.iterations + 1))
    assert result.history[-1].objective == pytest.approx(result.objective, rel=1e-6)
    assert 0 < result.seconds.evaluate < result.seconds.wall
    assert result.seconds.linear_algebra <= result.seconds.wall
    assert result.backend in {"cyipopt", "ipyopt"}
    assert "Ipopt 3." in result.version
    assert result.calls["hessians"] >= result.iterations


def test_a_maximised_objective_keeps_its_sign():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(bounds=(0, 4), initialize=1.0)
    m.gain = pyo.Objective(expr=6 * m.x - m.x**2, sense=pyo.maximize)
    result = solve(compile_model(m))
    assert result.objective == pytest.approx(9.0)
    assert result.history[-1].objective == pytest.approx(9.0)


# -- every way of ending ----------------------------------------------------------------------------------------------------------


def test_every_status_of_ipopt_has_a_name_and_an_outcome():
    # IpReturnCodes_inc.h of Ipopt 3.14
    codes = [0, 1, 2, 3, 4, 5, 6, -1, -2, -3, -4, -5, -10, -11, -12, -13, -100, -101, -102, -199]
    assert sorted(codes) == sorted(STATUS_MAP) == sorted(STATUS_NAMES)
    assert {code for code in codes if STATUS_MAP[code] is Outcome.SOLVED} == {0, 1, 6}
    for unknown in (7, -6, 42, -1000, 10**6):
        assert outcome_of(unknown) is Outcome.FAILED


def test_infeasible():
    m = quadratic(bounds=(0, 1))
    m.c = pyo.Constraint(expr=m.x[1] * m.x[2] >= 3)
    assert solve(compile_model(m)).outcome is Outcome.INFEASIBLE


def test_unbounded():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=0.0)
    m.cost = pyo.Objective(expr=-m.x - pyo.sqrt(1 + m.x**2))
    assert solve(compile_model(m)).outcome is Outcome.DIVERGED


def test_iteration_limit():
    m = quadratic()
    m.c = pyo.Constraint(expr=pyo.exp(m.x[1] * m.x[2]) == 9)
    assert solve(compile_model(m), options={"max_iter": 1}).outcome is Outcome.ITERATION_LIMIT


def test_time_limit(three_carts):
    import time

    problem = compile_model(three_carts(60))
    result = solve(problem, time_limit=1e-3, callback=lambda line: time.sleep(2e-3))
    assert result.outcome is Outcome.TIME_LIMIT
    assert result.options["max_wall_time"] == 1e-3


def test_a_callback_may_stop():
    seen = []

    def stop(line):
        seen.append(line.iteration)
        return line.iteration < 1

    m = quadratic()
    m.c = pyo.Constraint(expr=pyo.exp(m.x[1] * m.x[2]) == 9)
    result = solve(compile_model(m), callback=stop)
    assert result.outcome is Outcome.INTERRUPTED
    assert seen == [0, 1]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_an_exception_in_the_callback_propagates_and_the_model_stays(error):
    m = quadratic()

    def fail(line):
        raise error

    with pytest.raises(error):
        solve(compile_model(m), callback=fail)
    assert m.x[1].value == 0.5


def test_a_start_outside_the_domain_is_an_evaluation_error():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=-1.0)
    m.cost = pyo.Objective(expr=pyo.log(m.x))
    assert solve(compile_model(m)).outcome is Outcome.EVALUATION_ERROR


def test_a_step_outside_the_domain_is_cut():
    """The full Newton step for x - log(x) from 5 leads to -15."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=5.0)
    m.cost = pyo.Objective(expr=m.x - pyo.log(m.x))
    result = solve(compile_model(m))
    assert result.outcome is Outcome.SOLVED
    assert result.x[0] == pytest.approx(1.0)
    assert max(line.trials for line in result.history) > 1


def test_more_equations_than_variables():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=1.0)
    m.c = pyo.Constraint([1, 2], rule=lambda m, i: m.x * i == i)
    result = solve(compile_model(m))
    assert result.outcome is Outcome.REFUSED
    assert result.status == -10


def test_a_square_system_without_objective():
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize=1.0)
    m.a = pyo.Constraint(expr=m.x[1] ** 2 + m.x[2] ** 2 == 4)
    m.b = pyo.Constraint(expr=m.x[1] == m.x[2])
    result = solve(compile_model(m))
    assert result.outcome is Outcome.SOLVED
    assert result.x == pytest.approx([math.sqrt(2)] * 2)


def test_no_variable_at_all():
    m = quadratic()
    m.x.fix(1.0)
    result = solve(compile_model(m))
    assert (result.outcome, result.objective, result.x.size) == (Outcome.SOLVED, 1.0, 0)
    m.c = pyo.Constraint(expr=m.x[1] >= 2)
    result = solve(compile_model(m))
    assert result.outcome is Outcome.INFEASIBLE
    assert "'c'" in result.message


def test_crossed_bounds_are_named():
    m = quadratic()
    m.x[2].setlb(3)
    m.x[2].setub(1)
    result = solve(compile_model(m))
    assert result.outcome is Outcome.INFEASIBLE
    assert "x[2]" in result.message


def test_variables_without_value_start_at_the_bound_nearest_zero_and_it_is_said():
    m = quadratic()
    m.x[1].set_value(None)
    m.x[1].setlb(0.25)
    problem = compile_model(m)
    x, missing = problem.start()
    assert missing == 1
    assert x[list(problem.variables).index(m.x[1])] == 0.25
    assert "1 variable(s) without a value" in solve(problem).message


class _Liar(Cyipopt):
    """A back end that claims success wherever it stands."""

    def __init__(self, status, x=None):
        self._status, self._x = status, x

    def run(self, problem, functions, start, options, intermediate):
        zeros = np.zeros(problem.n)
        x = start.x if self._x is None else np.full(problem.n, self._x)
        return Answer(status=self._status, message="", x=x, lagrange=np.zeros(problem.m), zl=zeros, zu=zeros)


@pytest.mark.parametrize("status", [0, 1, 6])
def test_success_is_checked_not_believed(status):
    problem = compile_model(quadratic())
    result = solve(problem, backend=_Liar(status))
    assert result.outcome is Outcome.STALLED
    assert "does not meet" in result.message
    assert solve(problem, backend=_Liar(status, np.nan)).outcome is Outcome.EVALUATION_ERROR
    solution = solve(problem).x
    assert solve(problem, backend=_Liar(status), warm_start=Start(x=solution)).outcome is Outcome.SOLVED


def test_an_unknown_status_is_never_success():
    problem = compile_model(quadratic())
    solution = solve(problem).x
    result = solve(problem, backend=_Liar(17), warm_start=Start(x=solution))
    assert result.outcome is Outcome.FAILED
    assert "unknown Ipopt status 17" in result.message


def test_residuals_by_hand():
    """min x1 + x2 with x1 >= 1, x1 x2 = 6 <= 8 upper, at x = (0.5, 3): every residual is a number one can write down."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize={1: 0.5, 2: 3.0})
    m.x[1].setlb(1.0)
    m.c = pyo.Constraint(expr=m.x[1] * m.x[2] <= 8)
    m.cost = pyo.Objective(expr=m.x[1] + m.x[2])
    problem = compile_model(m)
    x, _ = problem.start()
    order = [v.name for v in problem.variables]
    zl = np.array([2.0 if name == "x[1]" else 0.0 for name in order])
    found = residuals(problem, x, np.array([0.1]), zl, np.zeros(2))
    assert found.constraint_violation == pytest.approx(0.5)
    assert found.dual_infeasibility == pytest.approx(1.05)  # d/dx2: 1 + 0.1 * 0.5; d/dx1: 1 + 0.3 - 2
    assert found.complementarity == pytest.approx(1.0)  # |x1 - 1| * 2; the constraint: 6.5 * 0.1
    wrong = residuals(problem, x, np.array([-3.0]), zl, np.zeros(2))
    assert wrong.dual_infeasibility >= 3.0  # there is no lower bound that a negative multiplier could belong to


def test_a_variable_between_equal_bounds_takes_any_multiplier():
    m = quadratic()
    m.x[1].setlb(0.5)
    m.x[1].setub(0.5)
    m.x[2].set_value(2.0)
    problem = compile_model(m)
    zero = np.zeros(2)
    found = residuals(problem, problem.start()[0], np.zeros(0), zero, zero)
    assert found.dual_infeasibility == 0.0
    assert solve(problem).outcome is Outcome.SOLVED


@pytest.mark.parametrize("function", ["objective", "gradient", "constraints", "jacobian", "hessian"])
def test_a_number_that_is_not_finite_reaches_the_back_end_as_its_own_error(function):
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=-1.0)
    m.c = pyo.Constraint(expr=pyo.sqrt(m.x) + m.x**1.5 <= 3)
    m.cost = pyo.Objective(expr=pyo.log(m.x))
    functions = Evaluations(compile_model(m), FloatingPointError)
    arguments = (np.array([-1.0]), np.ones(1), 1.0) if function == "hessian" else (np.array([-1.0] if function != "gradient" else [0.0]),)
    with pytest.raises(FloatingPointError):
        getattr(functions, function)(*arguments)


# -- options ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tolerance": 1e-6}, "tol"),
        ({"max_itr": 5}, "max_iter"),
        ({"linear_solver": "ma97"}, "mumps"),
        ({"mehrotra_algorithm": "yes"}, "ends the process"),
        ({"tol": "small"}, "number"),
        ({"max_iter": 2.5}, "whole number"),
        ({"mu_strategy": "fast"}, "adaptive"),
        ({"tol": -1.0}, "does not accept"),
        ({"tol": float("nan")}, "number"),
    ],
)
def test_options_that_cannot_be_are_refused_in_a_sentence(options, words, capfd):
    with pytest.raises(UnknownOptionError, match=words):
        solve(compile_model(quadratic()), options=options)


def test_options_are_converted_used_and_recorded():
    result = solve(compile_model(quadratic()), options={"tol": "1e-6", "max_iter": 50.0, "mu_strategy": "adaptive", "recalc_y": True})
    assert result.outcome is Outcome.SOLVED
    assert (result.options["tol"], result.options["max_iter"], result.options["recalc_y"]) == (1e-6, 50, "yes")


def test_an_option_file_lying_about_changes_nothing(tmp_path, monkeypatch):
    (tmp_path / "ipopt.opt").write_text("max_iter 0\n")
    monkeypatch.chdir(tmp_path)
    assert pathlib.Path("ipopt.opt").exists()
    assert solve(compile_model(quadratic())).outcome is Outcome.SOLVED


def test_the_list_of_options_is_what_ipopt_knows(capfd):
    """Every name is accepted by the installed Ipopt with some value, so that the list cannot rot."""
    import cyipopt

    from formulations.ipopt.options import _CHOICES, _REALS

    class Parabola:
        def objective(self, x):
            return x[0] ** 2

        def gradient(self, x):
            return 2 * x

    nlp = cyipopt.Problem(1, 0, Parabola(), [0.0], [1.0])
    for name in known_options():
        real = name in _REALS
        tries = _CHOICES.get(name, ("mumps",) if name == "linear_solver" else [0.4, 1.5, 10.0] if real else [1, 0, 5])
        accepted = 0
        for value in tries:
            try:
                nlp.add_option(name, value)
            except TypeError:
                continue
            accepted += 1
        assert accepted == len(tries) if name in _CHOICES else accepted > 0, name


@pytest.mark.parametrize("start", [Start(x=np.zeros(3)), Start(x=np.array([np.nan, 0.0])), Start(x=np.zeros(2), lagrange=np.zeros(5))])
def test_a_start_of_the_wrong_shape_is_refused(start):
    with pytest.raises(ValueError, match="warm_start"):
        solve(compile_model(quadratic()), warm_start=start)


def test_a_time_limit_is_positive():
    with pytest.raises(ValueError, match="time_limit"):
        solve(compile_model(quadratic()), time_limit=0.0)

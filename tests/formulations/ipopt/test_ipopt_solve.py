"""Solving: known optima, warm starts, what a result holds."""

import math

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.ipopt import Start, compile_model, load, solve
from formulations.solution import Outcome
from tests.formulations.ipopt.problems import quadratic, three_carts


@pytest.mark.parametrize(("eps", "cost"), [(1e-3, 197.86), (1e-5, 261.23)])
def test_three_carts_reach_the_known_costs(eps, cost):
    problem = compile_model(three_carts(500, eps))
    result = solve(problem)
    assert result.outcome is Outcome.SOLVED
    assert result.objective == pytest.approx(cost, abs=0.005)  # known to two digits after the point
    assert result.residuals.constraint_violation < 1e-10


def test_the_same_problem_follows_its_param():
    model = three_carts(100, 1e-2)
    problem = compile_model(model)
    first = solve(problem)
    model.b.value = abs(math.log(1e-3))
    problem.refresh()
    followed = solve(problem, warm_start=Start(x=first.x))
    fresh = solve(compile_model(three_carts(100, 1e-3)))
    assert followed.objective == pytest.approx(fresh.objective, rel=1e-8)
    assert abs(followed.objective - first.objective) > 1.0


def test_the_same_start_gives_the_same_bits():
    problem = compile_model(three_carts(60))
    first, second = solve(problem), solve(problem)
    assert np.array_equal(first.x, second.x)
    assert [i.objective for i in first.history] == [i.objective for i in second.history]


@pytest.mark.slow
def test_a_primal_dual_start_at_the_solution_ends_at_once():
    problem = compile_model(three_carts(100))
    cold = solve(problem)
    warm = solve(problem, warm_start=Start(x=cold.x, lagrange=cold.lagrange, zl=cold.zl, zu=cold.zu))
    assert warm.iterations <= 2 < cold.iterations
    assert warm.objective == pytest.approx(cold.objective, rel=1e-9)
    partly = solve(problem, warm_start=Start(x=cold.x, lagrange=cold.lagrange))
    assert partly.iterations <= 3


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
    assert (result.history[0].mu, result.history[0].alpha_pr) == (0.1, 0.0)  # Ipopt's first barrier parameter, and no step yet
    assert max(result.history[-1].inf_pr, result.history[-1].inf_du) <= 1e-8 < result.history[0].inf_du
    assert 0 < result.seconds.evaluate < result.seconds.wall
    assert result.seconds.linear_algebra <= result.seconds.wall
    assert result.version.startswith("cyipopt ")
    assert ", Ipopt 3." in result.version
    assert result.calls["hessians"] >= result.iterations


def test_a_maximised_objective_keeps_its_sign():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(bounds=(0, 4), initialize=1.0)
    m.gain = pyo.Objective(expr=6 * m.x - m.x**2, sense=pyo.maximize)
    result = solve(compile_model(m))
    assert result.objective == pytest.approx(9.0)
    assert result.history[-1].objective == pytest.approx(9.0)

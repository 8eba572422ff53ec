"""Every way a solve can end, and the check that does not take Ipopt's word."""

import math
import sys

import numpy as np
import pyomo.environ as pyo
import pytest
from cyipopt import CyIpoptEvaluationError

from formulations.ipopt import Start, compile_model, solve
from formulations.ipopt.problem import Evaluations
from formulations.ipopt.result import STATUS, outcome_of, residuals
from formulations.ipopt.solve import IpoptExit
from formulations.solution import Outcome
from tests.formulations.ipopt.problems import quadratic, three_carts


def test_every_status_of_ipopt_has_a_name_and_an_outcome():
    # IpReturnCodes_inc.h of Ipopt 3.14
    codes = [0, 1, 2, 3, 4, 5, 6, -1, -2, -3, -4, -5, -10, -11, -12, -13, -100, -101, -102, -199]
    assert sorted(codes) == sorted(STATUS)
    assert {code for code in codes if outcome_of(code) is Outcome.SOLVED} == {0, 1, 6}
    for unknown in (7, -6, 42, -1000, 10**6):
        assert outcome_of(unknown) is Outcome.FAILED


def test_time_limit():
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
        raise error("from the callback")

    with pytest.raises(error, match="from the callback"):
        solve(compile_model(m), callback=fail)
    assert m.x[1].value == 0.5


def test_a_step_outside_the_domain_is_cut():
    """The full Newton step for x - log(x) from 5 leads to -15."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=5.0)
    m.cost = pyo.Objective(expr=m.x - pyo.log(m.x))
    result = solve(compile_model(m))
    assert result.outcome is Outcome.SOLVED
    assert result.x[0] == pytest.approx(1.0)
    assert max(line.trials for line in result.history) > 1


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


@pytest.fixture
def liar(monkeypatch):
    """Has Ipopt claim a status wherever it stands."""

    def settle(status, x=None, multiplier=0.0):
        def run(problem, functions, start, options):
            zeros, point = np.zeros(problem.n), start.x if x is None else np.full(problem.n, x)
            return IpoptExit(status=status, x=point, lagrange=np.full(problem.m, multiplier), zl=zeros, zu=zeros)

        monkeypatch.setattr(sys.modules[solve.__module__], "run", run)

    return settle


@pytest.mark.parametrize("status", [0, 1, 6])
def test_success_is_checked_not_believed(liar, status):
    problem = compile_model(quadratic())
    solution = solve(problem).x
    liar(status)
    result = solve(problem)
    assert result.outcome is Outcome.STALLED
    assert "does not meet" in result.message
    assert solve(problem, warm_start=Start(x=solution)).outcome is Outcome.SOLVED
    liar(status, np.nan)
    assert solve(problem).outcome is Outcome.EVALUATION_ERROR


@pytest.mark.parametrize(("status", "multiplier", "told"), [(-1, -1e16, True), (1, 1e16, True), (-1, 1e3, False), (2, 1e16, False)])
def test_multipliers_without_end_point_to_constraints_that_repeat_each_other(liar, status, multiplier, told):
    m = quadratic()
    m.c = pyo.Constraint(expr=m.x[1] + m.x[2] == 1)
    m.again = pyo.Constraint(expr=2 * m.x[1] + 2 * m.x[2] == 2)
    problem = compile_model(m)
    liar(status, multiplier=multiplier)
    assert ("perturb_always_cd" in solve(problem).message) is told
    asked = solve(problem, options={"perturb_always_cd": "yes"})
    assert "perturb_always_cd" not in asked.message


def test_an_unknown_status_is_never_success(liar):
    problem = compile_model(quadratic())
    solution = solve(problem).x
    liar(17)
    result = solve(problem, warm_start=Start(x=solution))
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
    assert residuals(problem, x, np.array([0.2]), zl, np.zeros(2)).complementarity == pytest.approx(1.3)  # 6.5 * 0.2 is more
    m.c.set_value(m.x[1] * m.x[2] >= -4)
    m.x[2].setub(4.0)
    other, zu = compile_model(m), np.array([3.0 if name == "x[2]" else 0.0 for name in order])
    assert residuals(other, x, np.array([-0.4]), zl, np.zeros(2)).complementarity == pytest.approx(2.2)  # (1.5 + 4) * 0.4
    assert residuals(other, x, np.zeros(1), zl, zu).complementarity == pytest.approx(3.0)  # |4 - x2| * 3
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
def test_a_number_that_is_not_finite_cuts_the_step(function):
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=-1.0)
    m.c = pyo.Constraint(expr=pyo.sqrt(m.x) + m.x**1.5 <= 3)
    m.cost = pyo.Objective(expr=pyo.log(m.x))
    functions = Evaluations(compile_model(m), lambda *numbers: True)
    arguments = (np.array([-1.0]), np.ones(1), 1.0) if function == "hessian" else (np.array([-1.0] if function != "gradient" else [0.0]),)
    with pytest.raises(CyIpoptEvaluationError):
        getattr(functions, function)(*arguments)


@pytest.mark.parametrize(
    ("build", "told"),
    [
        (lambda m: m.c.add(pyo.log(m.x[2]) <= 3), "constraint 'c[1]' has no finite value there"),
        (lambda m: [m.c.add(1 / m.x[i] <= 3) for i in (1, 2)], "constraint 'c[1]' and 1 more has no finite"),
        (lambda m: m.cost.set_value(pyo.log(m.x[1])), "the objective has no finite value"),
        (lambda m: m.c.add(pyo.sqrt(m.x[2]) >= 1), "one of their derivatives has none"),
        (lambda m: m.x[1].set_value(math.nan, skip_validation=True), "variable 'x[1]' is no finite number there"),
    ],
)
def test_what_is_no_number_at_the_start_is_named(build, told):
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize=0.0)
    m.cost = pyo.Objective(expr=m.x[1] ** 2 + m.x[2] ** 2)
    m.c = pyo.ConstraintList()
    build(m)
    result = solve(compile_model(m))
    assert result.outcome is Outcome.EVALUATION_ERROR
    assert told in result.message

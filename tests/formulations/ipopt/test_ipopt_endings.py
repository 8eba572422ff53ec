"""Solves: known optima, warm starts, options.

Every way one can end, no exception lost, and the check that does not take Ipopt's word.
"""

import math
import pathlib
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyomo.environ as pyo
import pytest
from cyipopt import CyIpoptEvaluationError

from formulations.ipopt import Start, UnknownOptionError, compile_model, solve
from formulations.ipopt.linear_solver import LINEAR_SOLVERS
from formulations.ipopt.options import known_options
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


@pytest.mark.parametrize(("fixed", "words"), [
    (True, "4 equations for 1 free variable (speed): unfix mass or leave an equation out"),
    (False, "4 equations for 2 free variables (speed, mass): leave an equation out"),
])  # fmt: skip
def test_more_equations_than_variables_are_counted(fixed: bool, words: str):
    m = pyo.ConcreteModel()
    m.speed, m.mass = pyo.Var(initialize=1.0), pyo.Var(initialize=2.0)
    m.rows = pyo.Constraint([1, 2, 3, 4], rule=lambda m, i: m.speed**i + m.mass == 3)
    m.goal = pyo.Objective(expr=m.speed)
    if fixed:
        m.mass.fix()
    result = solve(compile_model(m))
    assert result.outcome is Outcome.REFUSED
    assert result.message == f"Not_Enough_Degrees_Of_Freedom: {words}"


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
            return IpoptExit(
                status=status, x=point, lagrange=np.full(problem.m, multiplier), zl=zeros, zu=zeros
            )

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


@pytest.mark.parametrize(
    ("status", "multiplier", "told"),
    [(-1, -1e16, True), (1, 1e16, True), (-1, 1e3, False), (2, 1e16, False)],
)
def test_multipliers_without_end_point_to_constraints_that_repeat_each_other(
    liar, status, multiplier, told
):
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
    assert found.dual_infeasibility == pytest.approx(
        1.05
    )  # d/dx2: 1 + 0.1 * 0.5; d/dx1: 1 + 0.3 - 2
    assert found.complementarity == pytest.approx(1.0)  # |x1 - 1| * 2; the constraint: 6.5 * 0.1
    assert residuals(problem, x, np.array([0.2]), zl, np.zeros(2)).complementarity == pytest.approx(
        1.3
    )  # 6.5 * 0.2 is more
    m.c.set_value(m.x[1] * m.x[2] >= -4)
    m.x[2].setub(4.0)
    other, zu = compile_model(m), np.array([3.0 if name == "x[2]" else 0.0 for name in order])
    assert residuals(other, x, np.array([-0.4]), zl, np.zeros(2)).complementarity == pytest.approx(
        2.2
    )  # (1.5 + 4) * 0.4
    assert residuals(other, x, np.zeros(1), zl, zu).complementarity == pytest.approx(
        3.0
    )  # |4 - x2| * 3
    wrong = residuals(problem, x, np.array([-3.0]), zl, np.zeros(2))
    assert (
        wrong.dual_infeasibility >= 3.0
    )  # there is no lower bound that a negative multiplier could belong to


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


@pytest.mark.parametrize(
    "function", ["objective", "gradient", "constraints", "jacobian", "hessian"]
)
def test_a_number_that_is_not_finite_cuts_the_step(function):
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=-1.0)
    m.c = pyo.Constraint(expr=pyo.sqrt(m.x) + m.x**1.5 <= 3)
    m.cost = pyo.Objective(expr=pyo.log(m.x))
    functions = Evaluations(compile_model(m), lambda *numbers: True)
    arguments = (
        (np.array([-1.0]), np.ones(1), 1.0)
        if function == "hessian"
        else (np.array([-1.0] if function != "gradient" else [0.0]),)
    )
    with pytest.raises(CyIpoptEvaluationError):
        getattr(functions, function)(*arguments)


@pytest.mark.parametrize(("build", "told"), [
    (lambda m: m.c.add(pyo.log(m.x[2]) <= 3), "constraint 'c[1]' has no finite value there"),
    (lambda m: [m.c.add(1 / m.x[i] <= 3) for i in (1, 2)],
     "constraint 'c[1]' and 1 more has no finite"),
    (lambda m: m.cost.set_value(pyo.log(m.x[1])), "the objective has no finite value"),
    (lambda m: m.c.add(pyo.sqrt(m.x[2]) >= 1), "the slope of constraint 'c[1]' is infinite at x[2] = 0"),
    (lambda m: m.x[1].set_value(math.nan, skip_validation=True),
     "variable 'x[1]' is no finite number there"),
])  # fmt: skip
def test_what_is_no_number_at_the_start_is_named(build, told):
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize=0.0)
    m.cost = pyo.Objective(expr=m.x[1] ** 2 + m.x[2] ** 2)
    m.c = pyo.ConstraintList()
    build(m)
    result = solve(compile_model(m))
    assert result.outcome is Outcome.EVALUATION_ERROR
    assert told in result.message


def rosenbrock() -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize={1: -1.2, 2: 1.0}, bounds=(-2, 2))
    m.o = pyo.Objective(expr=100 * (m.x[2] - m.x[1] ** 2) ** 2 + (1 - m.x[1]) ** 2)
    m.c = pyo.Constraint(expr=m.x[1] + m.x[2] <= 1)
    return m


def test_the_start_is_not_written_over():
    problem = compile_model(rosenbrock())
    start = Start(x=np.array([0.5, 0.5]), lagrange=np.zeros(1), zl=np.ones(2), zu=np.ones(2))
    solve(problem, warm_start=start)
    assert start.x.tolist() == [0.5, 0.5]
    assert start.zl.tolist() == [1.0, 1.0]


@pytest.mark.parametrize("name", ["values", "derivatives", "hessian"])
def test_an_exception_of_a_function_arrives_as_it_was(monkeypatch, name: str):
    problem = compile_model(rosenbrock())
    calls = {"left": 4}
    original = getattr(problem, name)

    def broken(*arguments):
        calls["left"] -= 1
        if calls["left"] < 0:
            raise KeyboardInterrupt("in the middle")
        return original(*arguments)

    monkeypatch.setattr(problem, name, broken)
    with pytest.raises(KeyboardInterrupt, match="in the middle"):
        solve(problem)


@pytest.mark.parametrize("linear_solver", LINEAR_SOLVERS)
def test_nothing_is_printed(linear_solver: str, capfd):
    solve(compile_model(rosenbrock()), options={"linear_solver": linear_solver})
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("linear_solver", LINEAR_SOLVERS)
def test_a_run_inside_a_run_disturbs_neither(linear_solver: str):
    alone, inside = solve(compile_model(rosenbrock())), []

    def callback(line):
        inside.append(
            solve(compile_model(rosenbrock()), options={"linear_solver": linear_solver}).x
        )

    assert np.array_equal(solve(compile_model(rosenbrock()), callback=callback).x, alone.x)
    assert np.array_equal(inside, [inside[0]] * (alone.iterations + 1))
    assert np.allclose(inside[0], alone.x, rtol=0, atol=1e-8)


@pytest.mark.parametrize("linear_solver", LINEAR_SOLVERS)
def test_runs_in_threads_disturb_none(linear_solver: str):
    def found(_: int) -> list[float]:
        return solve(problems.pop(), options={"linear_solver": linear_solver}).x.tolist()

    problems = [compile_model(rosenbrock()) for _ in range(8)]  # Pyomo's compiler is for one thread
    with ThreadPoolExecutor(4) as pool:
        points = list(pool.map(found, range(8)))
    assert points == points[:1] * 8


@pytest.mark.slow
def test_ctrl_c_ends_a_run_wherever_it_strikes():
    program = """
import os, signal, threading, time, pyomo.environ as pyo
from formulations.ipopt import compile_model, solve
m = pyo.ConcreteModel()
m.x = pyo.Var(range(2000), initialize=-1.2, bounds=(-2, 2))
m.o = pyo.Objective(expr=sum(100 * (m.x[i + 1] - m.x[i] ** 2) ** 2 + (1 - m.x[i]) ** 2 for i in range(1999)))
problem = compile_model(m)
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background is started with Ctrl-C ignored
def strike(line):
    if line.iteration == 0:
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
try:
    while True:
        solve(problem, callback=strike)
except KeyboardInterrupt:
    print("interrupted")
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_primal_dual_start_at_the_solution_ends_at_once():
    problem = compile_model(three_carts(100))
    cold = solve(problem)
    warm = solve(
        problem, warm_start=Start(x=cold.x, lagrange=cold.lagrange, zl=cold.zl, zu=cold.zu)
    )
    assert warm.iterations <= 2 < cold.iterations
    assert warm.objective == pytest.approx(cold.objective, rel=1e-9)
    partly = solve(problem, warm_start=Start(x=cold.x, lagrange=cold.lagrange))
    assert partly.iterations <= 3


def test_history_has_one_line_an_iteration_and_seconds_add_up():
    m = quadratic(bounds=(-1, 1.5))
    m.c = pyo.Constraint(expr=pyo.exp(m.x[1]) + m.x[2] <= 3)
    began = time.process_time()
    result = solve(compile_model(m))
    assert 0.0 < result.seconds.cpu <= time.process_time() - began
    assert [line.iteration for line in result.history] == list(range(result.iterations + 1))
    assert result.history[-1].objective == pytest.approx(result.objective, rel=1e-6)
    assert (result.history[0].mu, result.history[0].alpha_pr) == (
        0.1,
        0.0,
    )  # Ipopt's first barrier parameter, and no step yet
    assert (
        max(result.history[-1].inf_pr, result.history[-1].inf_du) <= 1e-8 < result.history[0].inf_du
    )
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


@pytest.mark.parametrize(("options", "words"), [
    ({"tolerance": 1e-6}, "tol"), ({"max_itr": 5}, "max_iter"),
    ({"linear_solver": "ma97"}, "mumps"), ({"mehrotra_algorithm": "yes"}, "ends the process"),
    ({"tol": "small"}, "number"), ({"max_iter": 2.5}, "whole number"),
    ({"max_iter": float("inf")}, "whole number of at most 2147483647"),
    ({"max_iter": 10**12}, "whole number of at most 2147483647"),
    ({"mu_strategy": "fast"}, "adaptive"), ({"tol": -1.0}, "does not accept"),
    ({"tol": float("nan")}, "number"),
])  # fmt: skip
def test_options_that_cannot_be_are_refused_in_a_sentence(options, words, capfd):
    with pytest.raises(UnknownOptionError, match=words):
        solve(compile_model(quadratic()), options=options)


def test_options_are_converted_used_and_recorded():
    result = solve(
        compile_model(quadratic()),
        options={"tol": "1e-6", "max_iter": 50.0, "mu_strategy": "adaptive", "recalc_y": True},
    )
    assert result.outcome is Outcome.SOLVED
    assert (result.options["tol"], result.options["max_iter"], result.options["recalc_y"]) == (
        1e-6,
        50,
        "yes",
    )


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
        tries = _CHOICES.get(
            name, ("mumps",) if name == "linear_solver" else [0.4, 1.5, 10.0] if real else [1, 0, 5]
        )
        accepted = 0
        for value in tries:
            try:
                nlp.add_option(name, value)
            except TypeError:
                continue
            accepted += 1
        assert accepted == len(tries) if name in _CHOICES else accepted > 0, name


@pytest.mark.parametrize(
    "start",
    [
        Start(x=np.zeros(3)),
        Start(x=np.array([np.nan, 0.0])),
        Start(x=np.zeros(2), lagrange=np.zeros(5)),
    ],
)
def test_a_start_of_the_wrong_shape_is_refused(start):
    with pytest.raises(ValueError, match="warm_start"):
        solve(compile_model(quadratic()), warm_start=start)
    with pytest.raises(ValueError, match="time_limit"):
        solve(compile_model(quadratic()), time_limit=0.0)

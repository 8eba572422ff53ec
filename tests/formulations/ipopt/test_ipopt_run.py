"""Runs of Ipopt end as they should, lose no exception and do not disturb each other."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.ipopt import Start, compile_model, solve
from formulations.ipopt.errors import UnknownOptionError
from formulations.ipopt.linear_solver import LINEAR_SOLVERS
from formulations.solution import Outcome


def rosenbrock() -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize={1: -1.2, 2: 1.0}, bounds=(-2, 2))
    m.o = pyo.Objective(expr=100 * (m.x[2] - m.x[1] ** 2) ** 2 + (1 - m.x[1]) ** 2)
    m.c = pyo.Constraint(expr=m.x[1] + m.x[2] <= 1)
    return m


def test_a_primal_dual_warm_start_saves_iterations():
    problem = compile_model(rosenbrock())
    cold = solve(problem)
    warm = solve(problem, warm_start=Start(x=cold.x, lagrange=cold.lagrange, zl=cold.zl, zu=cold.zu))
    assert warm.outcome is Outcome.SOLVED
    assert warm.iterations < cold.iterations / 2


def test_the_start_is_not_written_over():
    problem = compile_model(rosenbrock())
    start = Start(x=np.array([0.5, 0.5]), lagrange=np.zeros(1), zl=np.ones(2), zu=np.ones(2))
    solve(problem, warm_start=start)
    assert start.x.tolist() == [0.5, 0.5]
    assert start.zl is not None
    assert start.zl.tolist() == [1.0, 1.0]


def test_a_callback_stops():
    result = solve(compile_model(rosenbrock()), callback=lambda line: line.iteration < 3)
    assert result.outcome is Outcome.INTERRUPTED
    assert result.iterations == 3


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError, RuntimeError])
def test_an_exception_of_the_callback_arrives_as_it_was(error: type[BaseException]):
    def callback(line):
        raise error("from the callback")

    with pytest.raises(error, match="from the callback"):
        solve(compile_model(rosenbrock()), callback=callback)


@pytest.mark.parametrize("name", ["rows_at", "entries_at", "hessian"])
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


def test_time_runs_out():
    result = solve(compile_model(rosenbrock()), time_limit=1e-9)
    assert result.outcome is Outcome.TIME_LIMIT


def test_the_step_is_cut_where_a_function_is_not_finite():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=10.0)
    m.o = pyo.Objective(expr=m.x - 2 * pyo.log(m.x))  # a full Newton step from 10 leads to x < 0
    result = solve(compile_model(m))
    assert result.outcome is Outcome.SOLVED
    assert result.x[0] == pytest.approx(2.0, rel=1e-6)


def test_an_infeasible_problem_is_told():
    m = rosenbrock()
    m.d = pyo.Constraint(expr=m.x[1] ** 2 + m.x[2] ** 2 >= 20)
    assert solve(compile_model(m)).outcome is Outcome.INFEASIBLE


def test_an_impossible_value_is_refused():
    with pytest.raises(UnknownOptionError, match="'tol'"):
        solve(compile_model(rosenbrock()), options={"tol": -1.0})


@pytest.mark.parametrize("linear_solver", LINEAR_SOLVERS)
def test_nothing_is_printed(linear_solver: str, capfd):
    solve(compile_model(rosenbrock()), options={"linear_solver": linear_solver})
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("linear_solver", LINEAR_SOLVERS)
def test_a_run_inside_a_run_disturbs_neither(linear_solver: str):
    alone, inside = solve(compile_model(rosenbrock())), []

    def callback(line):
        inside.append(solve(compile_model(rosenbrock()), options={"linear_solver": linear_solver}).x)

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
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")

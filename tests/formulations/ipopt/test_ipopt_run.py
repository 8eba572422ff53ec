"""Runs of Ipopt end as they should, lose no exception and do not disturb each other."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.ipopt import Start, compile_model, solve
from formulations.ipopt.linear_solver import LINEAR_SOLVERS


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

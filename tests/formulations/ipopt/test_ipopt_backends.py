"""Every installed back end gives the same answers, ends in the same ways and lets no exception cross Ipopt."""

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.ipopt import Start, compile_model, solve
from formulations.ipopt.backend import Backend
from formulations.ipopt.backend_cyipopt import Cyipopt
from formulations.ipopt.backends import backends, default_backend
from formulations.ipopt.errors import UnknownOptionError
from formulations.solution import Outcome
from models.errors import MachineError


@pytest.fixture(params=backends(), ids=lambda backend: backend.name)
def backend(request) -> Backend:
    if not request.param.available():
        pytest.skip(f"{request.param.name} has no wheel for this machine")
    return request.param


def rosenbrock() -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize={1: -1.2, 2: 1.0}, bounds=(-2, 2))
    m.o = pyo.Objective(expr=100 * (m.x[2] - m.x[1] ** 2) ** 2 + (1 - m.x[1]) ** 2)
    m.c = pyo.Constraint(expr=m.x[1] + m.x[2] <= 1)
    return m


def test_the_same_optimum_and_multipliers(backend: Backend):
    result = solve(compile_model(rosenbrock()), options={"tol": 1e-10}, backend=backend)
    reference = solve(compile_model(rosenbrock()), options={"tol": 1e-10}, backend=Cyipopt())
    assert result.outcome is Outcome.SOLVED
    assert result.backend == backend.name
    assert np.allclose(result.x, reference.x, rtol=0, atol=1e-8)
    assert np.allclose(result.lagrange, reference.lagrange, rtol=1e-6, atol=1e-8)


def test_a_primal_dual_warm_start_saves_iterations(backend: Backend):
    problem = compile_model(rosenbrock())
    cold = solve(problem, backend=backend)
    warm = solve(problem, backend=backend, warm_start=Start(x=cold.x, lagrange=cold.lagrange, zl=cold.zl, zu=cold.zu))
    assert warm.outcome is Outcome.SOLVED
    assert warm.iterations < cold.iterations / 2


def test_the_start_is_not_written_over(backend: Backend):
    problem = compile_model(rosenbrock())
    start = Start(x=np.array([0.5, 0.5]), lagrange=np.zeros(1), zl=np.ones(2), zu=np.ones(2))
    solve(problem, backend=backend, warm_start=start)
    assert start.x.tolist() == [0.5, 0.5]
    assert start.zl is not None
    assert start.zl.tolist() == [1.0, 1.0]


def test_a_callback_stops(backend: Backend):
    result = solve(compile_model(rosenbrock()), backend=backend, callback=lambda line: line.iteration < 3)
    assert result.outcome is Outcome.INTERRUPTED
    assert result.iterations == 3


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError, RuntimeError])
def test_an_exception_of_the_callback_arrives_as_it_was(backend: Backend, error: type[BaseException]):
    def callback(line):
        raise error("from the callback")

    with pytest.raises(error, match="from the callback"):
        solve(compile_model(rosenbrock()), backend=backend, callback=callback)


@pytest.mark.parametrize("name", ["rows_at", "entries_at", "hessian"])
def test_an_exception_of_a_function_arrives_as_it_was(backend: Backend, monkeypatch, name: str):
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
        solve(problem, backend=backend)


def test_time_runs_out(backend: Backend):
    result = solve(compile_model(rosenbrock()), backend=backend, time_limit=1e-9)
    assert result.outcome is Outcome.TIME_LIMIT


def test_the_step_is_cut_where_a_function_is_not_finite(backend: Backend):
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=10.0)
    m.o = pyo.Objective(expr=m.x - 2 * pyo.log(m.x))  # a full Newton step from 10 leads to x < 0
    result = solve(compile_model(m), backend=backend)
    assert result.outcome is Outcome.SOLVED
    assert result.x[0] == pytest.approx(2.0, rel=1e-6)


def test_an_infeasible_problem_is_told(backend: Backend):
    m = rosenbrock()
    m.d = pyo.Constraint(expr=m.x[1] ** 2 + m.x[2] ** 2 >= 20)
    assert solve(compile_model(m), backend=backend).outcome is Outcome.INFEASIBLE


def test_an_impossible_value_is_refused(backend: Backend):
    with pytest.raises(UnknownOptionError, match="'tol'"):
        solve(compile_model(rosenbrock()), backend=backend, options={"tol": -1.0})


def test_an_option_of_a_newer_ipopt_goes_to_the_back_end_that_knows_it():
    assert default_backend(["max_resto_iter", "grad_f_constant"]).name == "cyipopt"


def test_one_may_insist_on_a_back_end(monkeypatch):
    monkeypatch.setenv("TOUCHSTONE_IPOPT", "cyipopt")
    assert default_backend().name == "cyipopt"
    monkeypatch.setenv("TOUCHSTONE_IPOPT", "snopt")
    with pytest.raises(MachineError, match="'snopt'"):
        default_backend()

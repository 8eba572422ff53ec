"""Who factorises: by default ours where it can be had, else MUMPS; both come to the same optimum; what is insisted on is told where it is missing."""

import subprocess
import sys

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations import ContactFormulation, build_model
from formulations.ipopt import compile_model, linear_solver, solve
from formulations.ipopt.linear_solver import LINEAR_SOLVERS
from formulations.solution import Outcome
from models.catalog import load_scene
from models.errors import MachineError


def parabola() -> pyo.ConcreteModel:
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize=1.0, bounds=(0, 2))
    m.o = pyo.Objective(expr=(m.x[1] - 3) ** 2 + m.x[2] ** 2)
    m.c = pyo.Constraint(expr=m.x[1] + m.x[2] == 1.5)
    return m


@pytest.fixture
def no_compiler(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")


def test_both_come_to_the_same_plan():
    problem = compile_model(build_model(load_scene("three_cart"), ContactFormulation.SOFTPLUS, eps=1e-3))
    ours, theirs = (solve(problem, options={"linear_solver": name}) for name in LINEAR_SOLVERS)
    assert ours.outcome is theirs.outcome is Outcome.SOLVED
    assert (ours.options["linear_solver"], theirs.options["linear_solver"]) == LINEAR_SOLVERS
    assert np.isclose(ours.objective, theirs.objective, rtol=1e-6)
    assert np.allclose(ours.x, theirs.x, rtol=0, atol=1e-4 * np.abs(theirs.x).max())


def test_ours_is_the_default_and_the_environment_names_another(monkeypatch):
    monkeypatch.delenv("TOUCHSTONE_LINEAR_SOLVER", raising=False)
    assert solve(compile_model(parabola())).options["linear_solver"] == "ldlt"
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "mumps")
    assert solve(compile_model(parabola())).options["linear_solver"] == "mumps"
    assert solve(compile_model(parabola()), options={"linear_solver": "ldlt"}).options["linear_solver"] == "ldlt"
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "ma57")
    with pytest.raises(MachineError, match="'ma57'; there are ldlt and mumps"):
        solve(compile_model(parabola()))


def test_without_a_compiler_mumps_serves(no_compiler, monkeypatch):
    monkeypatch.delenv("TOUCHSTONE_LINEAR_SOLVER", raising=False)
    result = solve(compile_model(parabola()))
    assert result.outcome is Outcome.SOLVED
    assert result.options["linear_solver"] == "mumps"
    with pytest.raises(MachineError, match="no C compiler"):
        solve(compile_model(parabola()), options={"linear_solver": "ldlt"})
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "ldlt")
    with pytest.raises(MachineError, match="no C compiler"):
        solve(compile_model(parabola()))


def test_an_ipopt_that_loads_no_solver_is_left_with_mumps(monkeypatch):
    monkeypatch.delenv("TOUCHSTONE_LINEAR_SOLVER", raising=False)
    monkeypatch.setattr(linear_solver, "loads_solvers", lambda: False)
    assert solve(compile_model(parabola())).options["linear_solver"] == "mumps"
    with pytest.raises(MachineError, match="without loading linear solvers"):
        solve(compile_model(parabola()), options={"linear_solver": "ldlt"})


_ANOTHER_PROCESS = """
import pyomo.environ as pyo
from formulations.ipopt import compile_model, solve
from models.errors import MachineError
m = pyo.ConcreteModel()
m.x = pyo.Var(initialize=1.0)
m.o = pyo.Objective(expr=(m.x - 3) ** 2)
result = solve(compile_model(m))
print(result.outcome.name, result.options["linear_solver"])
try:
    solve(compile_model(m), options={"linear_solver": "ldlt"})
except MachineError as error:
    print(error)
"""


@pytest.mark.slow
def test_a_library_that_cannot_be_loaded_leaves_mumps(monkeypatch, tmp_path):
    monkeypatch.delenv("TOUCHSTONE_LINEAR_SOLVER", raising=False)
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    (tmp_path / "damaged").write_bytes(b"")
    (tmp_path / "damaged").replace(linear_solver.ldlt_library())  # not written over: this process has it mapped
    told = subprocess.run([sys.executable, "-c", _ANOTHER_PROCESS], capture_output=True, text=True, check=True).stdout
    assert told.startswith("SOLVED mumps\n")
    assert "cannot be loaded" in told


@pytest.mark.slow
def test_a_library_that_has_gone_is_made_again(monkeypatch, tmp_path):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    first = linear_solver.ldlt_library()
    first.unlink()
    assert solve(compile_model(parabola()), options={"linear_solver": "ldlt"}).outcome is Outcome.SOLVED
    assert first.exists()


@pytest.mark.slow
def test_a_cache_named_from_here_is_built_in(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TOUCHSTONE_CACHE", "beside")
    assert linear_solver.ldlt_library().parent == tmp_path / "beside"


def test_a_compiler_that_fails_is_tried_once(monkeypatch, tmp_path, caplog):
    compiler, tried = tmp_path / "cc", tmp_path / "tried"
    compiler.write_text(
        f'#!/bin/sh\n[ "$1" = --version ] && echo "one without headers" && exit\necho >> {tried}\necho "no headers here" >&2\nexit 1\n'
    )
    compiler.chmod(0o755)
    monkeypatch.delenv("TOUCHSTONE_LINEAR_SOLVER", raising=False)
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CC", str(compiler))
    with caplog.at_level("INFO"):
        for _ in range(3):
            assert solve(compile_model(parabola())).options["linear_solver"] == "mumps"
    assert tried.read_text() == "\n"
    assert caplog.text.count("no headers here") == 1


def test_an_option_of_mumps_asks_for_mumps(monkeypatch):
    monkeypatch.delenv("TOUCHSTONE_LINEAR_SOLVER", raising=False)
    assert solve(compile_model(parabola()), options={"mumps_pivtol": 1e-3}).options["linear_solver"] == "mumps"
    both = {"mumps_pivtol": 1e-3, "linear_solver": "ldlt"}
    assert solve(compile_model(parabola()), options=both).options["linear_solver"] == "ldlt"

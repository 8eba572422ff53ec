"""Both solvers by Pyomo's second interface: results, loading, duals and reduced costs, and errors where the answer is not optimal."""

import io

import pyomo.environ as pyo
import pytest
from pyomo.contrib.solver.common.factory import SolverFactory
from pyomo.contrib.solver.common.results import SolutionStatus, TerminationCondition
from pyomo.contrib.solver.common.util import NoDualsError, NoFeasibleSolutionError, NoOptimalSolutionError
from pyomo.mpec import Complementarity, complements

import formulations  # noqa: F401 - registers the solvers
from formulations.ipopt import ModelRefusedError, UnknownOptionError


def program(sense=pyo.minimize) -> pyo.ConcreteModel:
    """(x - 3)^2 + (y - 1)^2 with x + 2 y = 4 and x <= 2: x = 2, y = 1; the row's multiplier is 0, the bound's -2."""
    model = pyo.ConcreteModel()
    model.x, model.y = pyo.Var(bounds=(0, 2), initialize=1), pyo.Var(initialize=1)
    sign = 1 if sense == pyo.minimize else -1
    model.cost = pyo.Objective(expr=sign * ((model.x - 3) ** 2 + (model.y - 1) ** 2 + 0.5 * model.y), sense=sense)
    model.row = pyo.Constraint(expr=model.x + 2 * model.y == 4)
    model.dual, model.rc = pyo.Suffix(direction=pyo.Suffix.IMPORT), pyo.Suffix(direction=pyo.Suffix.IMPORT)
    return model


@pytest.mark.parametrize("name", ["touchstone_ipopt", "mpec_ipopt"])
@pytest.mark.parametrize("sense", [pyo.minimize, pyo.maximize])
def test_values_duals_and_reduced_costs(name, sense):
    model, sign = program(sense), 1 if sense == pyo.minimize else -1
    solver = SolverFactory(name)
    results = solver.solve(model)
    assert (results.termination_condition, results.solution_status) == (
        TerminationCondition.convergenceCriteriaSatisfied,
        SolutionStatus.optimal,
    )
    assert (model.x.value, model.y.value) == pytest.approx((2, 1), abs=1e-7)
    assert results.incumbent_objective == pytest.approx(sign * 1.5, abs=1e-6)
    assert results.solver_name == name
    assert results.extra_info.iteration_count > 0
    assert solver.last_result.solved
    # y = (4 - x) / 2: a right-hand side that grows by 1 moves y by 1/2; a bound that grows moves x by 1 and y by -1/2
    assert model.dual[model.row] == pytest.approx(sign * 0.25, abs=1e-6)
    assert model.rc[model.x] == pytest.approx(sign * -2.25, abs=1e-6)
    assert model.rc[model.y] == pytest.approx(0, abs=1e-6)


def test_loading_waits_until_asked():
    model = program()
    results = SolverFactory("touchstone_ipopt").solve(model, load_solutions=False)
    assert (model.x.value, model.y.value) == (1, 1)
    loader = results.solution_loader
    assert loader.get_number_of_solutions() == 1
    assert loader.get_vars([model.x])[model.x] == pytest.approx(2, abs=1e-7)
    assert len(loader.get_vars([model.x])) == 1
    loader.load_vars()
    assert model.x.value == pytest.approx(2, abs=1e-7)
    assert len(model.dual) == 0


def test_a_complementarity():
    model = pyo.ConcreteModel()
    model.x, model.y = pyo.Var(initialize=1), pyo.Var(initialize=1)
    model.cost = pyo.Objective(expr=(model.x - 1) ** 2 + (model.y - 2) ** 2)
    model.pair = Complementarity(expr=complements(model.x >= 0, model.y >= 0))
    results = SolverFactory("mpec_ipopt").solve(model, solver_options={"strategy": "scholtes"}, time_limit=60)
    assert (model.x.value, model.y.value, results.incumbent_objective) == pytest.approx((0, 2, 1), abs=1e-8)
    assert "scholtes" in results.extra_info.message


def test_what_is_not_optimal_is_an_error_unless_the_user_says_otherwise():
    model = program()
    model.contradiction = pyo.Constraint(expr=model.x >= 2.5)
    solver = SolverFactory("touchstone_ipopt")
    with pytest.raises(NoOptimalSolutionError, match=r"raise_exception_on_nonoptimal_result.*Infeasible"):
        solver.solve(model)
    assert (model.x.value, model.y.value) == (1, 1)
    results = solver.solve(model, raise_exception_on_nonoptimal_result=False, load_solutions=False)
    assert results.termination_condition is TerminationCondition.locallyInfeasible
    assert results.incumbent_objective is None
    limited = solver.solve(program(), raise_exception_on_nonoptimal_result=False, load_solutions=False, solver_options={"max_iter": 1})
    assert limited.termination_condition is TerminationCondition.iterationLimit


def test_without_a_point_there_is_nothing_to_load():
    model = pyo.ConcreteModel()
    model.x = pyo.Var(initialize=-1)
    model.cost = pyo.Objective(expr=pyo.sqrt(model.x))
    solver = SolverFactory("touchstone_ipopt")
    with pytest.raises(NoFeasibleSolutionError):
        solver.solve(model, raise_exception_on_nonoptimal_result=False)
    results = solver.solve(model, raise_exception_on_nonoptimal_result=False, load_solutions=False)
    assert (results.solution_status, results.termination_condition) == (SolutionStatus.noSolution, TerminationCondition.error)
    assert results.solution_loader.get_number_of_solutions() == 0


def test_a_point_without_multipliers_says_so():
    model = pyo.ConcreteModel()
    model.x, model.y = pyo.Var(initialize=1), pyo.Var(initialize=1)
    model.cost = pyo.Objective(expr=(model.x - 1) ** 2 + (model.y - 2) ** 2)
    model.pair = Complementarity(expr=complements(model.x >= 0, model.y >= 0))
    results = SolverFactory("mpec_ipopt").solve(
        model, solver_options={"polish": False}, load_solutions=False, raise_exception_on_nonoptimal_result=False
    )
    with pytest.raises(NoDualsError):
        results.solution_loader.get_duals()


def test_refusals_and_output():
    solver, heard = SolverFactory("touchstone_ipopt"), io.StringIO()
    with pytest.raises(UnknownOptionError, match="tolerance"):
        solver.solve(program(), solver_options={"tolerance": 1})
    whole = program()
    whole.x.domain = pyo.Integers
    with pytest.raises(ModelRefusedError, match="x"):
        solver.solve(whole)
    solver.solve(program(), tee=heard)
    assert "EXIT: Optimal" in heard.getvalue()
    assert solver.available()
    assert len(solver.version()) == 3


def test_the_first_interface_keeps_its_solvers():
    from formulations.ipopt.pyomo_solver import TouchstoneIpopt

    assert isinstance(pyo.SolverFactory("touchstone_ipopt"), TouchstoneIpopt)

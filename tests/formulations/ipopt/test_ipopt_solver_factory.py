"""SolverFactory("touchstone_ipopt"), by either interface of Pyomo, on models that have nothing to do with contact, with the manners Pyomo's users expect; equations that repeat each other: by luck of rounding Ipopt ends without an answer, and the plugin asks it once more in another way."""

import io

import numpy as np
import pyomo.environ as pyo
import pytest
from pyomo.contrib.solver.common.factory import SolverFactory
from pyomo.contrib.solver.common.results import SolutionStatus
from pyomo.contrib.solver.common.results import TerminationCondition as Ended
from pyomo.contrib.solver.common.util import (
    NoDualsError,
    NoFeasibleSolutionError,
    NoOptimalSolutionError,
)
from pyomo.opt import SolverStatus, TerminationCondition

import formulations  # noqa: F401 - registers the solver
from formulations.ipopt import (
    ModelRefusedError,
    TouchstoneIpopt,
    UnknownOptionError,
    compile_model,
    pyomo_solver,
    solve,
)
from formulations.ipopt.pyomo_solver import dual_start
from formulations.solution import Outcome
from tests.formulations.nearest import nearest


@pytest.fixture
def solver():
    return pyo.SolverFactory("touchstone_ipopt")


def hs71(m):
    """Hock and Schittkowski (1981), problem 71; optimum 17.0140173."""
    m.x = pyo.Var([1, 2, 3, 4], bounds=(1, 5), initialize={1: 1, 2: 5, 3: 5, 4: 1})
    x = m.x
    m.product = pyo.Constraint(expr=x[1] * x[2] * x[3] * x[4] >= 25)
    m.sphere = pyo.Constraint(expr=sum(x[i] ** 2 for i in x) == 40)
    m.cost = pyo.Objective(expr=x[1] * x[4] * (x[1] + x[2] + x[3]) + x[3])
    return 17.0140173


def hs6(m):
    """Problem 6; optimum 0."""
    m.x = pyo.Var([1, 2], initialize={1: -1.2, 2: 1})
    m.c = pyo.Constraint(expr=10 * (m.x[2] - m.x[1] ** 2) == 0)
    m.cost = pyo.Objective(expr=(1 - m.x[1]) ** 2)
    return 0.0


def hs39(m):
    """Problem 39; optimum -1."""
    m.x = pyo.Var([1, 2, 3, 4], initialize=2)
    m.a = pyo.Constraint(expr=m.x[2] - m.x[1] ** 3 - m.x[3] ** 2 == 0)
    m.b = pyo.Constraint(expr=m.x[1] ** 2 - m.x[2] - m.x[4] ** 2 == 0)
    m.cost = pyo.Objective(expr=-m.x[1])
    return -1.0


def hs100(m):
    """Problem 100; optimum 680.6300573."""
    m.x = pyo.Var(range(1, 8), initialize={1: 1, 2: 2, 3: 0, 4: 4, 5: 0, 6: 1, 7: 1})
    x = m.x
    m.a = pyo.Constraint(
        expr=127 - 2 * x[1] ** 2 - 3 * x[2] ** 4 - x[3] - 4 * x[4] ** 2 - 5 * x[5] >= 0
    )
    m.b = pyo.Constraint(expr=282 - 7 * x[1] - 3 * x[2] - 10 * x[3] ** 2 - x[4] + x[5] >= 0)
    m.c = pyo.Constraint(expr=196 - 23 * x[1] - x[2] ** 2 - 6 * x[6] ** 2 + 8 * x[7] >= 0)
    m.d = pyo.Constraint(
        expr=-4 * x[1] ** 2 - x[2] ** 2 + 3 * x[1] * x[2] - 2 * x[3] ** 2 - 5 * x[6] + 11 * x[7]
        >= 0
    )
    m.cost = pyo.Objective(
        expr=(x[1] - 10) ** 2
        + 5 * (x[2] - 12) ** 2
        + x[3] ** 4
        + 3 * (x[4] - 11) ** 2
        + 10 * x[5] ** 6
        + 7 * x[6] ** 2
        + x[7] ** 4
        - 4 * x[6] * x[7]
        - 10 * x[6]
        - 8 * x[7]
    )
    return 680.6300573


@pytest.mark.parametrize("problem", [hs6, hs39, hs71, hs100])
def test_hock_and_schittkowski(solver, problem):
    m = pyo.ConcreteModel()
    optimum = problem(m)
    pyo.assert_optimal_termination(solver.solve(m))
    # The book prints its optima to seven digits or so; those at 0 are degenerate, where 1e-8 in x
    # is what the tolerance leaves.
    assert pyo.value(m.cost) == pytest.approx(optimum, rel=2e-7, abs=2e-7)


def linear(sense):
    """min 2a + 3b (or max of its negative) with a + b >= 1 - and a <= 0.4 - solved by hand: a = 0.4, b = 0.6, duals 3 and -1."""
    sign = 1 if sense == pyo.minimize else -1
    m = pyo.ConcreteModel()
    m.a = pyo.Var(bounds=(0, 0.4), initialize=0.2)
    m.b = pyo.Var(bounds=(0, None), initialize=0.2)
    m.demand = pyo.Constraint(expr=m.a + m.b >= 1)
    m.cost = pyo.Objective(expr=sign * (2 * m.a + 3 * m.b), sense=sense)
    m.dual = pyo.Suffix(direction=pyo.Suffix.IMPORT_EXPORT)
    m.ipopt_zL_out = pyo.Suffix(direction=pyo.Suffix.IMPORT)
    m.ipopt_zU_out = pyo.Suffix(direction=pyo.Suffix.IMPORT)
    return m


@pytest.mark.parametrize("sense", [pyo.minimize, pyo.maximize])
def test_duals_are_the_change_of_the_objective(solver, sense):
    sign = 1 if sense == pyo.minimize else -1
    m = linear(sense)
    solver.solve(m)
    assert (m.a.value, m.b.value) == pytest.approx((0.4, 0.6), abs=1e-6)
    assert m.dual[m.demand] == pytest.approx(sign * 3.0, abs=1e-5)
    assert m.ipopt_zU_out[m.a] == pytest.approx(-sign, abs=1e-5)
    assert m.ipopt_zL_out[m.b] == pytest.approx(0.0, abs=1e-5)
    before = pyo.value(m.cost)
    m.demand.set_value(m.a + m.b >= 1.01)
    dual = m.dual[m.demand]
    solver.solve(m)
    assert (pyo.value(m.cost) - before) / 0.01 == pytest.approx(dual, rel=1e-4)


@pytest.mark.parametrize("sense", [pyo.minimize, pyo.maximize])
def test_duals_start_the_next_solve(solver, sense):
    m = linear(sense)
    m.ipopt_zL_in = pyo.Suffix(direction=pyo.Suffix.EXPORT)
    m.ipopt_zU_in = pyo.Suffix(direction=pyo.Suffix.EXPORT)
    solver.solve(m)
    cold = solver.last_result.iterations
    m.ipopt_zL_in.update(m.ipopt_zL_out)
    m.ipopt_zU_in.update(m.ipopt_zU_out)
    start = dual_start(compile_model(m))
    assert start is not None
    for name in ("x", "lagrange", "zl", "zu"):
        assert getattr(start, name) == pytest.approx(getattr(solver.last_result, name), rel=1e-12)
    solver.solve(m, warmstart=True)
    assert solver.last_result.options["warm_start_init_point"] == "yes"
    assert solver.last_result.iterations <= 2 < cold
    solver.solve(m)
    assert "warm_start_init_point" not in solver.last_result.options


def test_results_tell_what_happened(solver):
    m = pyo.ConcreteModel(name="seventy-one")
    optimum = hs71(m)
    results = solver.solve(m)
    assert results.solver.status == SolverStatus.ok
    assert results.solver.termination_condition == TerminationCondition.optimal
    assert results.problem.upper_bound == pytest.approx(optimum)
    assert (results.problem.number_of_variables, results.problem.number_of_constraints) == (4, 2)
    assert (
        results.solver.statistics.black_box.number_of_iterations
        == solver.last_result.iterations
        > 0
    )
    assert results.problem.name == "seventy-one"


def test_a_solution_can_be_loaded_later(solver):
    m = linear(pyo.minimize)
    results = solver.solve(m, load_solutions=False)
    assert m.a.value == 0.2
    assert len(m.dual) == 0
    m.solutions.load_from(results)
    assert m.b.value == pytest.approx(0.6, abs=1e-6)
    assert m.dual[m.demand] == pytest.approx(3.0, abs=1e-5)
    assert m.ipopt_zU_out[m.a] == pytest.approx(-1.0, abs=1e-5)


@pytest.mark.parametrize(("change", "options", "condition"), [
    (lambda m: m.demand.set_value(m.a + m.b**2 <= -1), {}, TerminationCondition.infeasible),
    (lambda m: (m.b.setlb(None), m.demand.deactivate()), {}, TerminationCondition.unbounded),
    (lambda m: None, {"max_iter": 1}, TerminationCondition.maxIterations),
    (lambda m: m.add_component("e",
                               pyo.Constraint([1, 2, 3], rule=lambda m, i: m.a * i == i * m.b)), {},
                               TerminationCondition.invalidProblem),
])  # fmt: skip
def test_a_solve_without_solution_is_a_warning(solver, change, options, condition, caplog):
    m = linear(pyo.minimize)
    change(m)
    results = solver.solve(m, options=options)
    assert results.solver.termination_condition == condition
    assert results.solver.status == SolverStatus.warning
    assert not pyo.check_optimal_termination(results)
    assert str(condition) in caplog.text


def test_an_error_is_raised_unless_nothing_is_to_be_loaded(solver):
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=-1.0)
    m.cost = pyo.Objective(expr=pyo.log(m.x))
    with pytest.raises(ValueError, match="no solution to load"):
        solver.solve(m)
    assert m.x.value == -1.0
    results = solver.solve(m, load_solutions=False)
    assert results.solver.status == SolverStatus.error


def test_options_stay_and_can_be_given_for_one_solve(solver):
    m = linear(pyo.minimize)
    solver.options["tol"] = 1e-5
    solver.solve(m, options={"max_iter": 77}, options_string="mu_init=0.01", timelimit=12)
    used = solver.last_result.options
    assert (used["tol"], used["max_iter"], used["mu_init"], used["max_wall_time"]) == (
        1e-5,
        77,
        0.01,
        12.0,
    )
    solver.solve(m)
    assert "max_iter" not in solver.last_result.options
    with pytest.raises(UnknownOptionError, match="max_iter"):
        solver.solve(m, options={"maxiter": 3})
    assert dict(pyo.SolverFactory("touchstone_ipopt", options={"tol": 1e-4}).options) == {
        "tol": 1e-4
    }


@pytest.mark.parametrize("tee", [False, True])
def test_a_log_file_takes_the_log_and_how_it_ended(solver, capsys, tmp_path, tee):
    solver.solve(linear(pyo.minimize), logfile=tmp_path / "log", tee=tee)
    told = (tmp_path / "log").read_text()
    assert "inf_pr" in told
    assert told.endswith(f"touchstone_ipopt: {solver.last_result.message}\n")
    assert ("inf_pr" in capsys.readouterr().out) == tee
    with pytest.raises(OSError, match="nowhere"):
        solver.solve(linear(pyo.minimize), logfile=tmp_path / "nowhere" / "log")


def test_the_manners_of_a_pyomo_solver(solver):
    assert solver.available()
    assert solver.license_is_valid()
    assert solver.warm_start_capable()
    assert solver.version() >= (3, 12)
    assert not solver.has_capability("integer")
    with pyo.SolverFactory("touchstone_ipopt") as opened:
        opened.solve(linear(pyo.minimize), symbolic_solver_labels=True, keepfiles=False)
    with pytest.raises(TypeError, match="tea"):
        solver.solve(linear(pyo.minimize), tea=True)
    with pytest.raises(TypeError, match="nonsense"):
        TouchstoneIpopt(nonsense=1)


def test_refusals_come_before_anything_runs(solver):
    m = linear(pyo.minimize)
    m.n = pyo.Var(domain=pyo.Binary)
    m.more = pyo.Constraint(expr=m.n <= m.a)
    with pytest.raises(ModelRefusedError, match="'n'"):
        solver.solve(m)
    assert solver.last_result is None


def test_fixed_and_absent_variables_are_left_alone(solver):
    m = linear(pyo.minimize)
    m.absent = pyo.Var(initialize=9.0)
    m.f = pyo.Var(initialize=0.5)
    m.f.fix()
    m.more = pyo.Constraint(expr=m.b >= m.f + 0.3)
    solver.solve(m)
    assert (m.absent.value, m.f.value) == (9.0, 0.5)
    assert m.absent.stale
    assert m.b.value == pytest.approx(0.8, abs=1e-6)


def test_a_block_can_be_solved_alone(solver):
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=3.0)
    m.part = pyo.Block()
    m.part.y = pyo.Var(initialize=1.0)
    m.part.cost = pyo.Objective(expr=(m.part.y - m.x) ** 2 + pyo.exp(-m.x))
    m.x.fix()
    solver.solve(m.part)
    assert m.part.y.value == pytest.approx(3.0)


SEEDS = 60


def repeated(seed: int, n: int = 30) -> pyo.ConcreteModel:
    """The point nearest to another under random sparse equations that hold somewhere, some of them given twice."""
    random = np.random.default_rng(seed)
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(n), initialize=0.0)
    inside, wanted = random.normal(size=n), random.normal(size=n)
    m.c = pyo.ConstraintList()
    for _ in range(n // 2):
        chosen, factors = random.choice(n, size=3, replace=False), random.normal(size=3)
        for _ in range(1 + int(random.random() < 0.2)):
            m.c.add(
                sum(factor * m.x[int(place)] for factor, place in zip(factors, chosen, strict=True))
                == float(factors @ inside[chosen])
            )
    m.cost = pyo.Objective(expr=sum((m.x[i] - wanted[i]) ** 2 for i in range(n)))
    return m


def least(m: pyo.ConcreteModel) -> float:
    """The optimum in closed form: the distance to the plane of the equations."""
    rows = np.zeros((len(m.c), len(m.x)))
    right, wanted = np.zeros(len(m.c)), np.zeros(len(m.x))
    for place, constraint in enumerate(m.c.values()):
        right[place] = pyo.value(constraint.upper)
        for i in m.x:
            m.x[i].set_value(1.0)
            rows[place, i] = pyo.value(constraint.body)
            m.x[i].set_value(0.0)
    for i in m.x:
        at_0 = pyo.value(m.cost)
        m.x[i].set_value(1.0)
        wanted[i] = (1.0 - (pyo.value(m.cost) - at_0)) / 2.0
        m.x[i].set_value(0.0)
    return float(np.linalg.norm(np.linalg.pinv(rows) @ (right - rows @ wanted)) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("linear_solver", ["ldlt", "mumps"])
def test_the_optimum_is_found_whatever_rounding_does(linear_solver):
    for seed in range(SEEDS):
        m = repeated(seed)
        expected = least(m)
        results = pyo.SolverFactory("touchstone_ipopt").solve(
            m, options={"linear_solver": linear_solver}
        )
        pyo.assert_optimal_termination(results)
        assert pyo.value(m.cost) == pytest.approx(expected, rel=1e-6, abs=1e-8), seed


@pytest.mark.slow
@pytest.mark.parametrize("linear_solver", ["ldlt", "mumps"])
def test_what_the_message_says_helps(linear_solver):
    for seed in range(SEEDS):
        problem = compile_model(repeated(seed))
        assert (
            solve(
                problem, options={"linear_solver": linear_solver, "perturb_always_cd": "yes"}
            ).outcome
            is Outcome.SOLVED
        )
        plain = solve(problem, options={"linear_solver": linear_solver, "max_iter": 200})
        assert (
            plain.outcome is Outcome.SOLVED
            or np.max(np.abs(plain.lagrange)) < 1e8
            or "perturb_always_cd" in plain.message
        )


@pytest.mark.parametrize(("ends", "options", "asked", "ended"), [
    (["stalled", "solved"], {}, [None, "yes"], "optimal"),
    (["stalled", "stalled"], {}, [None, "yes"], "feasible"),
    (["stalled", "solved"], {"perturb_always_cd": "no"}, ["no"], "feasible"),
    (["solved"], {}, [None], "optimal"),
])  # fmt: skip
def test_one_more_solve_where_nobody_said_how(monkeypatch, ends, options, asked, ended):
    m, seen, left = repeated(0), [], iter(ends)

    def fake(problem, *, options, **others):
        seen.append(options.get("perturb_always_cd"))
        found = solve(problem, options={"perturb_always_cd": "yes"}, **others)
        if next(left) == "solved":
            return found
        lost = {
            "outcome": Outcome.STALLED,
            "status": 1,
            "lagrange": np.full(len(found.lagrange), 1e16),
            "options": dict(options),
        }
        return pyomo_solver.replace(found, **lost)

    monkeypatch.setattr(pyomo_solver, "solve", fake)
    results = pyo.SolverFactory("touchstone_ipopt").solve(m, options=options)
    assert seen == asked
    assert str(results.solver.termination_condition) == ended
    assert ("solved again" in results.solver.message) is (len(asked) == 2 and ended == "optimal")


def program(sense=pyo.minimize) -> pyo.ConcreteModel:
    """(x - 3)^2 + (y - 1)^2 with x + 2 y = 4 and x <= 2: x = 2, y = 1.

    The row's multiplier is 0, the bound's -2.
    """
    model = pyo.ConcreteModel()
    model.x, model.y = pyo.Var(bounds=(0, 2), initialize=1), pyo.Var(initialize=1)
    sign = 1 if sense == pyo.minimize else -1
    model.cost = pyo.Objective(
        expr=sign * ((model.x - 3) ** 2 + (model.y - 1) ** 2 + 0.5 * model.y), sense=sense
    )
    model.row = pyo.Constraint(expr=model.x + 2 * model.y == 4)
    model.dual, model.rc = (
        pyo.Suffix(direction=pyo.Suffix.IMPORT),
        pyo.Suffix(direction=pyo.Suffix.IMPORT),
    )
    return model


@pytest.mark.parametrize("name", ["touchstone_ipopt", "mpec_ipopt"])
@pytest.mark.parametrize("sense", [pyo.minimize, pyo.maximize])
def test_values_duals_and_reduced_costs(name, sense):
    model, sign = program(sense), 1 if sense == pyo.minimize else -1
    solver = SolverFactory(name)
    results = solver.solve(model)
    assert (results.termination_condition, results.solution_status) == (
        Ended.convergenceCriteriaSatisfied,
        SolutionStatus.optimal,
    )
    assert (model.x.value, model.y.value) == pytest.approx((2, 1), abs=1e-7)
    assert results.incumbent_objective == pytest.approx(sign * 1.5, abs=1e-6)
    assert results.solver_name == name
    assert results.extra_info.iteration_count > 0
    assert solver.last_result.solved
    # y = (4 - x) / 2: a right-hand side that grows by 1 moves y by 1/2; a bound that grows moves x
    # by 1 and y by -1/2
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
    model = nearest()
    results = SolverFactory("mpec_ipopt").solve(
        model, solver_options={"strategy": "scholtes"}, time_limit=60
    )
    assert (model.x.value, model.y.value, results.incumbent_objective) == pytest.approx(
        (0, 2, 1), abs=1e-8
    )
    assert "scholtes" in results.extra_info.message


def test_what_is_not_optimal_is_an_error_unless_the_user_says_otherwise():
    model = program()
    model.contradiction = pyo.Constraint(expr=model.x >= 2.5)
    solver = SolverFactory("touchstone_ipopt")
    with pytest.raises(
        NoOptimalSolutionError, match=r"raise_exception_on_nonoptimal_result.*Infeasible"
    ):
        solver.solve(model)
    assert (model.x.value, model.y.value) == (1, 1)
    results = solver.solve(model, raise_exception_on_nonoptimal_result=False, load_solutions=False)
    assert results.termination_condition is Ended.locallyInfeasible
    assert results.incumbent_objective is None
    limited = solver.solve(
        program(),
        raise_exception_on_nonoptimal_result=False,
        load_solutions=False,
        solver_options={"max_iter": 1},
    )
    assert limited.termination_condition is Ended.iterationLimit


def test_without_a_point_there_is_nothing_to_load():
    model = pyo.ConcreteModel()
    model.x = pyo.Var(initialize=-1)
    model.cost = pyo.Objective(expr=pyo.sqrt(model.x))
    solver = SolverFactory("touchstone_ipopt")
    with pytest.raises(NoFeasibleSolutionError):
        solver.solve(model, raise_exception_on_nonoptimal_result=False)
    results = solver.solve(model, raise_exception_on_nonoptimal_result=False, load_solutions=False)
    assert (results.solution_status, results.termination_condition) == (
        SolutionStatus.noSolution,
        Ended.error,
    )
    assert results.solution_loader.get_number_of_solutions() == 0


def test_a_point_without_multipliers_says_so():
    model = nearest()
    results = SolverFactory("mpec_ipopt").solve(
        model,
        solver_options={"polish": False},
        load_solutions=False,
        raise_exception_on_nonoptimal_result=False,
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

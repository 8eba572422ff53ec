"""Equations that repeat each other: by luck of rounding Ipopt ends without an answer, and the plugin asks it once more in another way."""

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.ipopt import compile_model, pyomo_solver, solve
from formulations.solution import Outcome

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
            m.c.add(sum(factor * m.x[int(place)] for factor, place in zip(factors, chosen, strict=True)) == float(factors @ inside[chosen]))
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
        results = pyo.SolverFactory("touchstone_ipopt").solve(m, options={"linear_solver": linear_solver})
        pyo.assert_optimal_termination(results)
        assert pyo.value(m.cost) == pytest.approx(expected, rel=1e-6, abs=1e-8), seed


@pytest.mark.slow
@pytest.mark.parametrize("linear_solver", ["ldlt", "mumps"])
def test_what_the_message_says_helps(linear_solver):
    for seed in range(SEEDS):
        problem = compile_model(repeated(seed))
        assert solve(problem, options={"linear_solver": linear_solver, "perturb_always_cd": "yes"}).outcome is Outcome.SOLVED
        plain = solve(problem, options={"linear_solver": linear_solver, "max_iter": 200})
        assert plain.outcome is Outcome.SOLVED or np.max(np.abs(plain.lagrange)) < 1e8 or "perturb_always_cd" in plain.message


@pytest.mark.parametrize(
    ("ends", "options", "asked", "ended"),
    [
        (["stalled", "solved"], {}, [None, "yes"], "optimal"),
        (["stalled", "stalled"], {}, [None, "yes"], "feasible"),
        (["stalled", "solved"], {"perturb_always_cd": "no"}, ["no"], "feasible"),
        (["solved"], {}, [None], "optimal"),
    ],
)
def test_one_more_solve_where_nobody_said_how(monkeypatch, ends, options, asked, ended):
    m, seen, left = repeated(0), [], iter(ends)

    def fake(problem, *, options, **others):
        seen.append(options.get("perturb_always_cd"))
        found = solve(problem, options={"perturb_always_cd": "yes"}, **others)
        if next(left) == "solved":
            return found
        lost = {"outcome": Outcome.STALLED, "status": 1, "lagrange": np.full(len(found.lagrange), 1e16), "options": dict(options)}
        return pyomo_solver.replace(found, **lost)

    monkeypatch.setattr(pyomo_solver, "solve", fake)
    results = pyo.SolverFactory("touchstone_ipopt").solve(m, options=options)
    assert seen == asked
    assert str(results.solver.termination_condition) == ended
    assert ("once more" in results.solver.message) is (len(asked) == 2 and ended == "optimal")

"""Random quadratic programs with complementarity against all their branches, each a convex quadratic program; and a plan through contact."""

import itertools

import numpy as np
import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements

from formulations import ContactFormulation, build_model
from formulations.ipopt import compile_model, solve
from formulations.mpec import STRATEGY_NAMES, MpecSettings, certify, load, solve_mpec

_PAIRS = 4


def random_problem(seed: int) -> pyo.ConcreteModel:
    """min |z - goal|^2 over z = (x, y) with 0 <= y complements N x + M y + q >= 0, M positive definite: every x has its one y."""
    random = np.random.default_rng(seed)
    matrix = random.normal(size=(_PAIRS, _PAIRS))
    matrix = matrix @ matrix.T + 0.1 * np.eye(_PAIRS)
    couple, q, goal = random.normal(size=(_PAIRS, 2)), random.normal(size=_PAIRS), 2 * random.normal(size=_PAIRS + 2)
    m = pyo.ConcreteModel(name=f"random {seed}")
    m.x = pyo.Var(range(2), bounds=(-5, 5), initialize=0.0)
    m.y = pyo.Var(range(_PAIRS), bounds=(0, None), initialize=0.0)
    m.cost = pyo.Objective(expr=sum((m.x[i] - goal[i]) ** 2 for i in range(2)) + sum((m.y[i] - goal[2 + i]) ** 2 for i in range(_PAIRS)))
    m.force = pyo.Expression(
        range(_PAIRS),
        rule=lambda m, i: q[i] + sum(couple[i, j] * m.x[j] for j in range(2)) + sum(matrix[i, j] * m.y[j] for j in range(_PAIRS)),
    )
    m.pair = Complementarity(range(_PAIRS), rule=lambda m, i: complements(m.y[i] >= 0, m.force[i] >= 0))
    return m


def branches(seed: int) -> list[float]:
    """Optimal values of all branches that have one."""
    values = []
    for closed in itertools.product((True, False), repeat=_PAIRS):
        m = random_problem(seed)
        m.pair.deactivate()
        m.side = pyo.Constraint(range(_PAIRS), rule=lambda m, i: m.force[i] >= 0)
        m.held = pyo.Constraint(range(_PAIRS), rule=lambda m, i, closed=closed: (m.force[i] if closed[i] else m.y[i]) == 0)
        result = solve(compile_model(m))
        if result.solved:
            values.append(result.objective)
    return sorted(values)


@pytest.mark.parametrize("seed", range(8))
def test_random_problems_end_at_the_best_branch(seed):
    values = branches(seed)
    result = solve_mpec(random_problem(seed))
    assert result.solved, result.message
    assert result.certificate.holds
    assert result.certificate.complementarity <= 1e-12
    assert min(abs(result.objective - value) for value in values) <= 1e-6  # it is the value of a branch
    assert result.objective <= values[0] + 1e-6


@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
def test_what_is_called_solved_is_certified(strategy):
    for seed in range(20, 24):
        m = random_problem(seed)
        result = solve_mpec(m, MpecSettings(strategy=strategy, search=0))
        assert result.solved, result.message
        load(result)
        assert certify(m).holds  # again, from the loaded values alone


@pytest.mark.slow
def test_a_plan_through_contact():
    """Three carts, 40 steps of 0.125 s: complementarity exact, strongly stationary, the model unchanged."""
    m = build_model("three_cart", ContactFormulation.COMPLEMENTARITY, steps=40, step=0.125)
    result = solve_mpec(m)
    assert result.solved, result.message
    assert result.certificate.complementarity <= 1e-12
    assert result.certificate.primal <= 1e-10
    assert result.certificate.stationarity.letter == "S"
    assert m.complementarity_contact.ctype is Complementarity
    assert not hasattr(m, "mpec_bound")

"""SolverFactory("mpec_ipopt"): the model is left as it was, the answer is certified, endings are honest."""

from __future__ import annotations

import math

import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, complements

import formulations.mpec
from formulations.mpec import STRATEGY_NAMES, MpecIpopt, Stationarity, certify


def jr1() -> pyo.ConcreteModel:
    m = pyo.ConcreteModel(name="jr1")
    m.z1 = pyo.Var()
    m.z2 = pyo.Var(bounds=(0, None))
    m.cost = pyo.Objective(expr=(m.z1 - 1) ** 2 + m.z2**2)
    m.pair = Complementarity(expr=complements(m.z2 >= 0, m.z2 - m.z1 >= 0))
    return m


def ralph1() -> pyo.ConcreteModel:
    """min 2x - y, 0 <= y complements y - x >= 0, x >= 0: the origin is B-stationary, but its multipliers are not those of an S point."""
    m = pyo.ConcreteModel(name="ralph1")
    m.x = pyo.Var(bounds=(0, None), initialize=1)
    m.y = pyo.Var(bounds=(0, None), initialize=1)
    m.cost = pyo.Objective(expr=2 * m.x - m.y)
    m.pair = Complementarity(expr=complements(m.y >= 0, m.y - m.x >= 0))
    return m


def solve(model, **options):
    solver = pyo.SolverFactory("mpec_ipopt")
    solver.options.update(options)
    return solver.solve(model), solver.last_result


@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
def test_every_strategy_solves_jr1(strategy):
    m = jr1()
    results, told = solve(m, strategy=strategy)
    pyo.assert_optimal_termination(results)
    assert pyo.value(m.cost) == pytest.approx(0.5, abs=1e-9)
    assert (m.z1.value, m.z2.value) == pytest.approx((0.5, 0.5), abs=1e-8)
    assert told.certificate.stationarity is Stationarity.STRONG
    assert min(abs(p.first) if abs(p.first) < abs(p.second) else abs(p.second) for p in told.pairs) <= 1e-12


@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
def test_ralph1_is_b_stationary_but_not_strongly(strategy):
    m = ralph1()
    results, told = solve(m, strategy=strategy)
    pyo.assert_optimal_termination(results)
    assert (m.x.value, m.y.value) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert told.certificate.stationarity is Stationarity.MORDUKHOVICH
    assert told.certificate.b_stationary is True
    assert told.certificate.biactive == 1


def test_the_plugin_is_registered_under_its_name():
    assert isinstance(pyo.SolverFactory("mpec_ipopt"), MpecIpopt)
    assert formulations.mpec.MpecIpopt is MpecIpopt


def test_a_point_that_is_not_stationary_is_not_certified():
    m = jr1()
    m.z1.value, m.z2.value = 0.0, 0.0  # feasible, biactive, and downhill along z1 = z2
    certificate = certify(m)
    assert certificate.feasible
    assert certificate.b_stationary is False
    assert certificate.descent < -0.1
    assert not certificate.holds


def test_a_violated_complementarity_is_measured_in_the_models_units():
    m = jr1()
    m.z1.value, m.z2.value = -1.0, 3.0
    certificate = certify(m)
    assert certificate.complementarity == pytest.approx(3.0)
    assert certificate.product == pytest.approx(12.0)
    assert not certificate.feasible
    assert math.isfinite(certificate.dual)

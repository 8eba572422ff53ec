"""SolverFactory("mpec_ipopt"): the model is left as it was, the answer is certified, endings are honest."""

import math

import pyomo.environ as pyo
import pytest

import formulations.mpec
from benchmarks.mpec.macmpec.toy import jr1, ralph1
from formulations.mpec import STRATEGY_NAMES, MpecIpopt, MpecSettings, Stationarity, certify, solve_mpec
from tests.formulations.mpec.nearest import solver


@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
@pytest.mark.parametrize(
    ("problem", "point", "stationarity", "biactive"),
    [(jr1, (0.5, 0.5), Stationarity.STRONG, 0), (ralph1, (0.0, 0.0), Stationarity.MORDUKHOVICH, 1)],
)
def test_every_strategy_ends_at_the_solution_and_knows_its_class(strategy, problem, point, stationarity, biactive):
    """The origin of ralph1 is B-stationary, but its multipliers are not those of an S point."""
    m, plugin = problem(), solver(strategy=strategy)
    pyo.assert_optimal_termination(plugin.solve(m))
    told = plugin.last_result
    assert (m.a.value, m.b.value) == pytest.approx(point, abs=1e-8)
    assert (told.certificate.stationarity, told.certificate.b_stationary, told.certificate.biactive) == (stationarity, True, biactive)
    assert all(min(abs(pair.first), abs(pair.second)) <= 1e-12 for pair in told.pairs)


@pytest.mark.parametrize("strategy", STRATEGY_NAMES)
def test_every_relaxation_leads_there_without_polish(strategy):
    """Where the path went astray, the branches would hide it."""
    result = solve_mpec(jr1(), MpecSettings(strategy=strategy, polish=False))
    assert result.solved, result.message
    assert not result.polished
    assert result.residual <= 1e-8
    assert result.objective == pytest.approx(0.5, abs=1e-7)


def test_the_plugin_is_registered_under_its_name():
    assert isinstance(pyo.SolverFactory("mpec_ipopt"), MpecIpopt)
    assert formulations.mpec.MpecIpopt is MpecIpopt


def test_a_point_that_is_not_stationary_is_not_certified():
    m = jr1()
    m.a.value, m.b.value = 0.0, 0.0  # feasible, biactive, and downhill along a = b
    certificate = certify(m)
    assert certificate.feasible
    assert certificate.b_stationary is False
    assert certificate.descent < -0.1
    assert not certificate.holds


def test_a_violated_complementarity_is_measured_in_the_models_units():
    m = jr1()
    m.a.value, m.b.value = -1.0, 3.0
    certificate = certify(m)
    assert certificate.complementarity == pytest.approx(3.0)
    assert certificate.product == pytest.approx(12.0)
    assert not certificate.feasible
    assert math.isfinite(certificate.dual)

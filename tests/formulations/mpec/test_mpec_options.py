"""Options of the plugin: those that reach Ipopt, those that are refused by name."""

import pyomo.environ as pyo
import pytest

from formulations.ipopt import UnknownOptionError
from formulations.mpec import MpecIpopt, read_settings, solve_mpec
from tests.formulations.mpec.nearest import nearest, solver


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"strategy": "magic"}, ["'strategy'", "scholtes", "'magic'"]), ({"strateg": "scholtes"}, ["'strateg'", "did you mean strategy?"]),
        ({"zzzz": 1}, ["'zzzz'", "neither Ipopt's", "strategy, eps_start, eps_end"]), ({"eps_start": -1.0}, ["'eps_start'", "positive"]),
        ({"eps_end": "small"}, ["'eps_end'", "number"]), ({"polish": "maybe"}, ["'polish'", "True or False"]),
        ({"max_biactive": 1.5}, ["'max_biactive'", "whole"]), ({"max_biactive": float("nan")}, ["'max_biactive'", "whole"]),
        ({"search": float("inf")}, ["'search'", "whole"]), ({"starts": 0}, ["'starts'", "at least 1"]), ({"work": -1}, ["'work'", "at least 0"]),
        ({"linear_solver": "ma57"}, ["ma57"]),
    ],
)  # fmt: skip
def test_wrong_options_are_named(options, words):
    with pytest.raises(UnknownOptionError) as caught:
        solver(**options).solve(nearest())
    for word in words:
        assert word in str(caught.value)


def test_options_reach_ipopt_and_the_record():
    settings = read_settings({"strategy": "scholtes", "max_iter": 77, "polish": "no"})
    assert settings.ipopt == {"max_iter": 77}
    result = solve_mpec(nearest(), settings)
    assert result.options["max_iter"] == 77
    assert not result.polished
    assert result.residual < 1e-6


@pytest.mark.parametrize("sense", [pyo.minimize, pyo.maximize])
def test_multipliers_of_pairs_are_a_suffix(sense):
    """At (0, 2): the cost changes by -2 when x >= 0 becomes x >= 1e-3, and not with what y is compared with."""
    m, sign = nearest(), 1 if sense == pyo.minimize else -1
    m.cost.deactivate()
    m.signed = pyo.Objective(expr=sign * m.cost.expr, sense=sense)
    m.pair_dual = pyo.Suffix(direction=pyo.Suffix.IMPORT)
    solver().solve(m)
    assert m.pair_dual[m.pair] == pytest.approx((-2.0 * sign, 0.0), abs=1e-8)


def test_unknown_keywords_are_refused():
    with pytest.raises(TypeError, match="nonsense"):
        solver().solve(nearest(), nonsense=1)
    with pytest.raises(TypeError, match="nonsense"):
        MpecIpopt(nonsense=1)


@pytest.mark.parametrize("plugin", ["mpec_ipopt", "touchstone_ipopt"])
def test_arguments_of_another_kind_are_refused_in_a_sentence(plugin):
    m = nearest()
    m.pair.deactivate()
    for timelimit in ("10", True, 0.0, float("nan")):
        with pytest.raises(ValueError, match="timelimit is a positive number of seconds"):
            pyo.SolverFactory(plugin).solve(m, timelimit=timelimit)
    with pytest.raises(TypeError, match="options as a dict, not 'tol=1e-9'; options_string takes a text"):
        pyo.SolverFactory(plugin).solve(m, options="tol=1e-9")
    pyo.SolverFactory(plugin).solve(m, options_string="tol=1e-9", timelimit=60)

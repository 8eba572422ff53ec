"""Tapes: every instruction, blocks of instances, registers, places."""

import numpy as np
import pytest

from formulations.ipopt.graph import UNARY, Graph
from formulations.ipopt.tape import record

REFERENCE = {
    **{name: getattr(np, name.replace("asin", "arcsin").replace("acos", "arccos").replace("atan", "arctan")) for name in UNARY},
    "softplus": lambda z: np.logaddexp(0.0, z),
    "logistic": lambda z: 1.0 / (1.0 + np.exp(-z)),
    "sech2": lambda z: np.cosh(z) ** -2.0,
}  # fmt: skip


def run(tape, x, data=None, scale=None, place=None, size=None):
    """Sum (size,) of a tape at x (variables, instances)."""
    instances = x.shape[1]
    columns = np.arange(x.size, dtype=np.int32).reshape(x.shape)
    scale = np.ones(instances) if scale is None else scale
    size = tape.outputs * instances if size is None else size
    place = np.arange(size, dtype=np.int32) if place is None else place
    total = np.zeros(size)
    tape.run(x.ravel(), columns, np.zeros((0, 0)) if data is None else data, scale, place, total)
    return total


@pytest.mark.parametrize("name", REFERENCE)
def test_record_function_equals_numpy(name):
    x = np.linspace(1.1, 1.9, 70) if name == "acosh" else np.linspace(0.1, 0.9, 70)
    graph = Graph()
    tape = record(graph, [graph.call(name, graph.variable(0))], {}, {0: 0})
    np.testing.assert_allclose(run(tape, x[None]), REFERENCE[name](x), rtol=1e-14)


@pytest.mark.parametrize("z", [-1e4, -40.0, 0.0, 40.0, 1e4, np.inf, -np.inf, np.nan])
def test_record_softplus_logistic_sech2_no_overflow(z):
    graph = Graph()
    nodes = [graph.call(name, graph.variable(0)) for name in ("softplus", "logistic", "sech2")]
    with np.errstate(all="ignore"):
        expected = [np.logaddexp(0.0, z), 1.0 / (1.0 + np.exp(-z)), np.cosh(z) ** -2.0]
    found = run(record(graph, nodes, {}, {0: 0}), np.array([[z]]))
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-300)


@pytest.mark.parametrize("instances", [1, 31, 32, 33, 100])
def test_record_many_instances_equals_numpy(instances):
    x, y, p = np.random.default_rng(instances).uniform(0.5, 2.0, (3, instances))
    graph = Graph()
    a, b, datum = graph.variable(3), graph.variable(7), graph.datum(0)
    ratio = graph.div(graph.sub(a, b), datum)
    outputs = [graph.add(graph.mul(ratio, ratio), graph.neg(b)), a, datum, graph.constant(2.5)]
    outputs += [graph.falling_power(a, datum, 2), graph.pow(a, b), ratio, ratio]
    tape = record(graph, outputs, {datum: 0}, {3: 0, 7: 1})
    r = (x - y) / p
    expected = [r * r - y, x, p, 2.5 + 0 * x, p * (p - 1) * x ** (p - 2), x**y, r, r]
    found = run(tape, np.stack([x, y]), p[None]).reshape(len(outputs), -1)
    np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_record_long_chain_few_registers():
    graph = Graph()
    node = graph.variable(0)
    for k in range(500):
        node = graph.add(graph.mul(node, graph.variable(0)), graph.constant(0.5 + k % 3))
    tape = record(graph, [node], {}, {0: 0})
    assert tape.registers <= len(tape.numbers) + tape.variables + 2
    x, expected = np.array([[0.3, -0.7]]), np.array([0.3, -0.7])
    for k in range(500):
        expected = expected * x[0] + (0.5 + k % 3)
    np.testing.assert_array_equal(run(tape, x), expected)


def test_run_places_scaled_and_left_out():
    graph = Graph()
    x = graph.variable(0)
    tape = record(graph, [x, graph.mul(x, x)], {}, {0: 0})
    place = np.array([[0, 1, 1], [-1, 0, 2]], dtype=np.int32)
    found = run(
        tape, np.array([[2.0, 3.0, 5.0]]), scale=np.array([1.0, 10.0, 0.5]), place=place, size=3
    )
    np.testing.assert_array_equal(found, [2.0 + 90.0, 30.0 + 2.5, 12.5])


def test_record_datum_not_hoisted_value_error():
    graph = Graph()
    with pytest.raises(ValueError, match="datum 4 is used but was not hoisted"):
        record(graph, [graph.mul(graph.variable(0), graph.datum(4))], {}, {0: 0})

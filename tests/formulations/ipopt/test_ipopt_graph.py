"""The algebra alone: simplification changes no value, and equal expressions are one node."""

import math
import operator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formulations.ipopt.graph import Graph, hessian_sparsity
from formulations.ipopt.shapes import generate, hoist

X, P = 0.625, -1.75
PLAIN = {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "pow": operator.pow}

leaves = st.sampled_from([("x", X), ("p", P), *((c, c) for c in (0.0, 1.0, -1.0, 2.0, 0.5, -3.0))])
steps = st.lists(
    st.tuples(st.sampled_from(["add", "sub", "mul", "div", "neg", "pow"]), st.integers(0, 50), st.integers(0, 50)), max_size=12
)


def leaf(graph, name):
    if name == "x":
        return graph.variable(0)
    return graph.datum(0) if name == "p" else graph.constant(name)


def evaluate(graph, node):
    outputs, hoisted = [node], hoist(graph, [node])
    data = [n for n in range(len(graph.op)) if graph.op[n] == "datum"]
    prepared = np.empty((len(hoisted), 1))
    out = np.empty((1, 1))
    with np.errstate(all="ignore"):
        generate(graph, hoisted, data, {}, "prepare")(None, [np.array([P])] * len(data), prepared)
        generate(graph, outputs, hoisted, {0: 0}, "value")([np.array([X])], list(prepared), out)
    return out[0, 0]


@pytest.mark.slow
@settings(max_examples=400, deadline=None, derandomize=True)
@given(st.lists(leaves, min_size=2, max_size=5), steps)
def test_simplification_changes_no_value(start, program):
    graph = Graph()
    nodes, values = [leaf(graph, name) for name, _ in start], [value for _, value in start]
    for operation, i, j in program:
        a, b = i % len(nodes), j % len(nodes)
        u, v = values[a], values[b]
        try:
            value = -u if operation == "neg" else PLAIN[operation](u, v)
        except (ArithmeticError, ValueError):
            continue
        if isinstance(value, complex) or not 1e-6 < abs(value) + 1e-5 < 1e6:
            continue
        nodes.append(graph.neg(nodes[a]) if operation == "neg" else getattr(graph, operation)(nodes[a], nodes[b]))
        values.append(value)
    for node, value in zip(nodes, values, strict=True):
        assert evaluate(graph, node) == pytest.approx(value, rel=1e-9, abs=1e-9)


def test_equal_expressions_are_one_node():
    graph = Graph()
    x, p = graph.variable(0), graph.datum(0)
    assert graph.mul(x, p) == graph.mul(p, x)
    assert graph.add(graph.call("sin", x), p) == graph.add(p, graph.call("sin", x))
    assert graph.sub(x, x) == graph.zero
    assert graph.neg(graph.sub(x, p)) == graph.sub(p, x)
    assert graph.mul(graph.constant(2), graph.mul(graph.constant(3), x)) == graph.mul(graph.constant(6), x)
    assert graph.call("cos", graph.constant(0.0)) == graph.one


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_the_sparsity_of_a_product_has_both_triangles(order):
    graph = Graph()
    x = {i: graph.variable(i) for i in order}
    curved = graph.call("exp", graph.add(x[1], x[2]))
    found = {tuple(pair) for pair in hessian_sparsity(graph, graph.mul(x[0], curved)).T.tolist()}
    assert found == {(1, 0), (2, 0), (1, 1), (2, 1), (2, 2)}


def test_what_has_no_value_is_kept_for_the_evaluation_to_report():
    graph = Graph()
    assert math.isinf(evaluate(graph, graph.call("log", graph.zero)))
    assert math.isnan(evaluate(graph, graph.pow(graph.constant(-8.0), graph.constant(0.3))))
    assert math.isinf(evaluate(graph, graph.div(graph.one, graph.zero)))

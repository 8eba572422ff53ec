"""Exact derivatives on a Graph: linear split, reverse-mode gradient, and the sparsity of the Hessian.

All three walk the nodes in descending order once, so their cost is proportional to the number of operations, however deep.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from formulations.ipopt.graph import CONSTANT, VARIABLE, Graph


def _partial_derivatives(graph: Graph, node: int) -> tuple[tuple[int, int], ...]:
    """((operand, d node / d operand), ...) for the operands that depend on a variable."""
    op, args = graph.op[node], graph.args[node]
    a = args[0]
    if op == "add":
        return (a, graph.one), (args[1], graph.one)
    if op == "sub":
        return (a, graph.one), (args[1], graph.constant(-1.0))
    if op == "mul":
        return (a, args[1]), (args[1], a)
    if op == "div":
        return (a, graph.div(graph.one, args[1])), (args[1], graph.neg(graph.div(node, args[1])))
    if op == "pow":
        return _power_derivatives(graph, node)
    if op == "falling_power":
        order = graph.constant_value(args[2]) or 0.0
        return ((a, graph.falling_power(a, args[1], int(order) + 1)),)
    return ((a, _UNARY_DERIVATIVES[op](graph, a, node)),)


def _power_derivatives(graph: Graph, node: int) -> tuple[tuple[int, int], ...]:
    base, exponent = graph.args[node]
    by_base = graph.mul(exponent, graph.pow(base, graph.sub(exponent, graph.one)))
    if graph.op[exponent] == CONSTANT:
        return ((base, by_base),)
    by_exponent = graph.mul(node, graph.call("log", base))
    return (base, by_base), (exponent, by_exponent)


def _reciprocal_root(graph: Graph, inside: int) -> int:
    return graph.div(graph.one, graph.call("sqrt", inside))


# d f(a) / d a, written so that the derivative keeps its relative accuracy and does not overflow where the function itself does not.
_UNARY_DERIVATIVES = {
    "neg": lambda g, a, n: g.constant(-1.0),
    "exp": lambda g, a, n: n,
    "log": lambda g, a, n: g.div(g.one, a),
    "log10": lambda g, a, n: g.div(g.constant(1.0 / math.log(10.0)), a),
    "sqrt": lambda g, a, n: g.div(g.constant(0.5), n),
    "sin": lambda g, a, n: g.call("cos", a),
    "cos": lambda g, a, n: g.neg(g.call("sin", a)),
    "tan": lambda g, a, n: g.add(g.one, g.mul(n, n)),
    "asin": lambda g, a, n: _reciprocal_root(g, g.sub(g.one, g.mul(a, a))),
    "acos": lambda g, a, n: g.neg(_reciprocal_root(g, g.sub(g.one, g.mul(a, a)))),
    "atan": lambda g, a, n: g.div(g.one, g.add(g.one, g.mul(a, a))),
    "sinh": lambda g, a, n: g.call("cosh", a),
    "cosh": lambda g, a, n: g.call("sinh", a),
    "tanh": lambda g, a, n: g.call("sech2", a),
    "sech2": lambda g, a, n: g.mul(g.constant(-2.0), g.mul(g.call("tanh", a), n)),
    "asinh": lambda g, a, n: _reciprocal_root(g, g.add(g.one, g.mul(a, a))),
    "acosh": lambda g, a, n: _reciprocal_root(g, g.mul(g.sub(a, g.one), g.add(a, g.one))),
    "atanh": lambda g, a, n: g.div(g.one, g.mul(g.sub(g.one, a), g.add(g.one, a))),
    "softplus": lambda g, a, n: g.call("logistic", a),
    "logistic": lambda g, a, n: g.mul(n, g.call("logistic", g.neg(a))),
}


def gradient(graph: Graph, root: int) -> dict[int, int]:
    """{variable index: node of d root / d variable}; a variable whose derivative is structurally zero is absent."""
    adjoint: dict[int, int] = {root: graph.one}
    found: dict[int, int] = {}
    for node in reversed(graph.reachable(root)):
        bar = adjoint.pop(node, None)
        if bar is None or bar == graph.zero or graph.is_data[node]:
            continue
        if graph.op[node] == VARIABLE:
            found[graph.args[node][0]] = bar
            continue
        if graph.is_leaf(node):
            continue
        for operand, slope in _partial_derivatives(graph, node):
            if not graph.is_data[operand]:
                step = graph.mul(bar, slope)
                adjoint[operand] = graph.add(adjoint[operand], step) if operand in adjoint else step
    return found


@dataclass(frozen=True, kw_only=True)
class LinearParts:
    """root = constant + sum_i linear[i] * variable_i + nonlinear, where constant and linear[i] are data nodes."""

    constant: int
    linear: dict[int, int] = field(default_factory=dict)
    nonlinear: int


def split_linear(graph: Graph, root: int) -> LinearParts:
    """Separate what is affine in the variables; products with data are carried through sums, so h*(a*x + y*z) gives h*a for x."""
    weight: dict[int, int] = {root: graph.one}
    constant, nonlinear = graph.zero, graph.zero
    linear: dict[int, int] = {}

    def share(node: int, amount: int) -> None:
        weight[node] = graph.add(weight[node], amount) if node in weight else amount

    for node in reversed(graph.reachable(root)):
        w = weight.pop(node, None)
        if w is None or w == graph.zero:
            continue
        op, args = graph.op[node], graph.args[node]
        if graph.is_data[node]:
            constant = graph.add(constant, graph.mul(w, node))
        elif op == VARIABLE:
            linear[args[0]] = w
        elif op == "add":
            share(args[0], w)
            share(args[1], w)
        elif op == "sub":
            share(args[0], w)
            share(args[1], graph.neg(w))
        elif op == "neg":
            share(args[0], graph.neg(w))
        elif op == "mul" and graph.is_data[args[0]]:
            share(args[1], graph.mul(w, args[0]))
        elif op == "mul" and graph.is_data[args[1]]:
            share(args[0], graph.mul(w, args[1]))
        elif op == "div" and graph.is_data[args[1]]:
            share(args[0], graph.div(w, args[1]))
        else:
            nonlinear = graph.add(nonlinear, graph.mul(w, node))
    return LinearParts(constant=constant, linear=linear, nonlinear=nonlinear)


_LINEAR_OPERATIONS = frozenset({"add", "sub", "neg"})


def hessian_sparsity(graph: Graph, root: int) -> np.ndarray:
    """Pairs of variables between which the root can be curved; a superset of the true pattern.

    Index sets are bit masks in Python integers: a nonlinear operation joins the variables of its operands. Raises nothing.

    Returns
    -------
    (2, entries) variable indices i >= j [-]
    """
    depends: dict[int, int] = {}
    partners: dict[int, int] = {}

    def join(left: int, right: int) -> None:
        for i in _bits(left).tolist():
            partners[i] = partners.get(i, 0) | right

    for node in graph.reachable(root):
        op, args = graph.op[node], graph.args[node]
        if graph.is_data[node]:
            depends[node] = 0
        elif op == VARIABLE:
            depends[node] = 1 << args[0]
        else:
            masks = [depends[operand] for operand in args]
            joined = 0
            for mask in masks:
                joined |= mask
            depends[node] = joined
            if op in _LINEAR_OPERATIONS:
                continue
            if op == "mul":
                join(masks[0], masks[1])
                join(masks[1], masks[0])
            elif op == "div":
                join(masks[1], joined)
                join(masks[0], masks[1])
            else:
                join(joined, joined)
    found = [np.empty((2, 0), dtype=np.intp)]
    for i in sorted(partners):
        columns = _bits(partners[i] & ((2 << i) - 1))
        found.append(np.stack([np.full(len(columns), i), columns]))
    return np.concatenate(found, axis=1)


def _bits(mask: int) -> np.ndarray:
    """Positions of the ones in a non-negative integer, ascending."""
    octets = np.frombuffer(mask.to_bytes((mask.bit_length() + 7) // 8, "little"), dtype=np.uint8)
    return np.flatnonzero(np.unpackbits(octets, bitorder="little"))

"""Graph -> numpy source -> function. One statement an operation, so that neither nesting nor recursion limits the size.

A generated function takes `x` (one row for each variable slot), `p` (one row for each hoisted data value) and writes `out`; every row
is an array over the instances of the shape, so that a thousand equal terms cost as many numpy calls as one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from formulations.ipopt.graph import CONSTANT, DATUM, SEED, VARIABLE, Graph

_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
_NUMPY = {
    "exp": "exp", "log": "log", "log10": "log10", "sqrt": "sqrt", "sin": "sin", "cos": "cos", "tan": "tan",
    "asin": "arcsin", "acos": "arccos", "atan": "arctan", "sinh": "sinh", "cosh": "cosh", "tanh": "tanh",
    "asinh": "arcsinh", "acosh": "arccosh", "atanh": "arctanh",
}  # fmt: skip


def _softplus(z):
    return np.logaddexp(0.0, z)


def _logistic(z):
    """1 / (1 + exp(-z)), to full relative accuracy on both sides (and without SciPy, whose import costs 0.9 CPU s once Pyomo is there)."""
    small = np.exp(-np.abs(z))
    return np.where(z >= 0.0, 1.0, small) / (1.0 + small)


def _sech2(z):
    """1 / cosh(z)**2, which overflows for no z."""
    c = np.cosh(z)
    return (1.0 / c) / c


def _falling_power(base, exponent, order):
    """p (p-1) .. (p-order+1) base**(p-order), and 0 where the factor is 0 (so that x**p at x = 0 is right for p = 0, 1, 2, ..)."""
    factor = np.ones_like(exponent)
    for k in range(int(order)):
        factor = factor * (exponent - k)
    return np.where(factor == 0.0, 0.0, factor * np.power(base, exponent - order))


_NAMESPACE = {
    "softplus": _softplus, "logistic": _logistic, "sech2": _sech2, "falling_power": _falling_power, "power": np.power, "divide": np.divide,
    "negative": np.negative, "inf": np.inf, "nan": np.nan, **{f"{name}_": getattr(np, target) for name, target in _NUMPY.items()},
}  # fmt: skip


def _name(graph: Graph, node: int, hoisted: Mapping[int, int]) -> str:
    if graph.op[node] == CONSTANT:
        value = repr(graph.args[node][0])
        return f"({value})" if value.startswith("-") else value
    return f"p[{hoisted[node]}]" if node in hoisted else f"t{node}"


def _statement(graph: Graph, node: int, hoisted: Mapping[int, int], row: Mapping[int, int]) -> str:
    op, args = graph.op[node], graph.args[node]
    if op == VARIABLE:
        return f"t{node} = x[{row[args[0]]}]"
    if op == SEED:
        return f"t{node} = seed[{row[args[0]]}]"
    names = [_name(graph, a, hoisted) for a in args]
    if op == "div" and all(graph.op[a] == CONSTANT for a in args):  # Python would raise where numpy gives inf or NaN
        return f"t{node} = divide({names[0]}, {names[1]})"
    if op in _INFIX:
        return f"t{node} = {names[0]} {_INFIX[op]} {names[1]}"
    if op == "neg":
        return f"t{node} = -{names[0]}"
    if op == "pow":
        return f"t{node} = power({names[0]}, {names[1]})"
    if op in _NUMPY:
        return f"t{node} = {op}_({names[0]})"
    return f"t{node} = {op}({', '.join(names)})"


def hoist(graph: Graph, roots: Sequence[int]) -> list[int]:
    """Data nodes, structural constants apart, that the roots use directly: computed once per refresh and handed in as `p`."""
    needed: set[int] = set()
    seen = set(roots)
    stack = list(roots)
    while stack:
        node = stack.pop()
        if graph.op[node] == CONSTANT:
            continue
        if graph.is_data[node]:
            needed.add(node)
            continue
        if graph.is_leaf(node):
            continue
        for operand in graph.args[node]:
            if operand not in seen:
                seen.add(operand)
                stack.append(operand)
    return sorted(needed)


def generate(graph: Graph, outputs: Sequence[int], hoisted: Sequence[int], row: Mapping[int, int], name: str) -> Callable[..., None]:
    """A function `(x, p, out, seed=None)` that writes outputs[k] to out[k].

    `hoisted` are the data nodes that p holds, in order; `row[i]` is the row of x (and of seed) that holds variable i.
    """
    slot = {node: k for k, node in enumerate(hoisted)}
    order: list[int] = []
    seen = set(outputs)
    stack = list(seen)
    while stack:
        node = stack.pop()
        if node in slot or graph.op[node] == CONSTANT:
            continue
        order.append(node)
        if graph.is_leaf(node):
            if graph.op[node] == DATUM:
                raise ValueError(f"datum {graph.args[node][0]} is used by a generated function but was not hoisted")
            continue
        for operand in graph.args[node]:
            if operand not in seen:
                seen.add(operand)
                stack.append(operand)
    lines = [f"def {name}(x, p, out, seed=None):"]
    lines += [f"    {_statement(graph, node, slot, row)}" for node in sorted(order)]
    lines += [f"    out[{k}] = {_name(graph, node, slot)}" for k, node in enumerate(outputs)]
    lines.append("    return")
    namespace = dict(_NAMESPACE)
    exec(compile("\n".join(lines), f"<term shape: {name}>", "exec"), namespace)  # source made above from numbers and known names
    return namespace[name]

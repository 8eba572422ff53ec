"""A hash-consed expression graph, in which the term shapes of a model are differentiated.

    x, p = graph.variable(0), graph.datum(0)
    f = graph.mul(p, graph.call("exp", x))  # p * exp(x)

A node is an integer larger than its operands: ascending order evaluates, descending order
back-propagates, without recursion. Leaves are variables, data (literals, Params, fixed variables)
and structural constants such as exponents.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

VARIABLE = "variable"
DATUM = "datum"
CONSTANT = "constant"
SEED = "seed"

# Functions of one argument in Pyomo expressions, and their values at structural constants.
UNARY = {
    "exp": math.exp, "log": math.log, "log10": math.log10, "sqrt": math.sqrt,
    "sin": math.sin, "cos": math.cos, "tan": math.tan, "asin": math.asin, "acos": math.acos,
    "atan": math.atan,
    "sinh": math.sinh, "cosh": math.cosh, "tanh": math.tanh, "asinh": math.asinh,
    "acosh": math.acosh, "atanh": math.atanh,
}  # fmt: skip


class Graph:
    """Nodes `0 .. len(op)-1`: `op[n]` is the operation, `args[n]` its operands.

    The operand of a leaf is its index or number.
    """

    def __init__(self) -> None:
        self.op: list[str] = []
        self.args: list[tuple] = []
        self.is_data: list[bool] = []
        self._known: dict[tuple, int] = {}
        self.zero = self.constant(0.0)
        self.one = self.constant(1.0)

    def _node(self, op: str, args: tuple, is_data: bool) -> int:
        key = (op, args)
        node = self._known.get(key)
        if node is None:
            node = self._known[key] = len(self.op)
            self.op.append(op)
            self.args.append(args)
            self.is_data.append(is_data)
        return node

    def _operation(self, op: str, *operands: int) -> int:
        return self._node(op, operands, all(self.is_data[a] for a in operands))

    # -- leaves

    def variable(self, index: int) -> int:
        """Return the node of a variable."""
        return self._node(VARIABLE, (index,), False)

    def datum(self, index: int) -> int:
        """Return the node of a number that each refresh reads again."""
        return self._node(DATUM, (index,), True)

    def seed(self, index: int) -> int:
        """Return the node of a direction's component in a Hessian-vector product."""
        return self._node(SEED, (index,), False)

    def constant(self, value: float) -> int:
        """Return the node of a structural constant; -0.0 becomes 0.0."""
        return self._node(CONSTANT, (float(value) + 0.0,), True)

    def constant_value(self, node: int) -> float | None:
        """Return the number of a structural constant, None for other nodes."""
        return self.args[node][0] if self.op[node] == CONSTANT else None

    # -- arithmetic

    def add(self, a: int, b: int) -> int:
        """Return the node of a + b, simplified."""
        ca, cb = self.constant_value(a), self.constant_value(b)
        if ca is not None and cb is not None:
            return self.constant(ca + cb)
        if ca == 0.0:
            return b
        if cb == 0.0:
            return a
        if self.op[b] == "neg":
            return self.sub(a, self.args[b][0])
        if self.op[a] == "neg":
            return self.sub(b, self.args[a][0])
        return self._operation("add", *((a, b) if a <= b else (b, a)))

    def sub(self, a: int, b: int) -> int:
        """Return the node of a - b, simplified."""
        ca, cb = self.constant_value(a), self.constant_value(b)
        if ca is not None and cb is not None:
            return self.constant(ca - cb)
        if a == b:
            return self.zero
        if cb == 0.0:
            return a
        if ca == 0.0:
            return self.neg(b)
        if self.op[b] == "neg":
            return self.add(a, self.args[b][0])
        return self._operation("sub", a, b)

    def neg(self, a: int) -> int:
        """Return the node of -a, simplified."""
        ca = self.constant_value(a)
        if ca is not None:
            return self.constant(-ca)
        if self.op[a] == "neg":
            return self.args[a][0]
        if self.op[a] == "sub":
            return self._operation("sub", self.args[a][1], self.args[a][0])
        return self._operation("neg", a)

    def mul(self, a: int, b: int) -> int:
        """Return the node of a b; constants are moved to the front and merged."""
        ca, cb = self.constant_value(a), self.constant_value(b)
        if ca is not None and cb is not None:
            return self.constant(ca * cb)
        if cb is not None:
            a, b, ca = b, a, cb
        if ca is not None:
            if ca == 0.0:
                return self.zero
            if ca == 1.0:
                return b
            if ca == -1.0:
                return self.neg(b)
            if self.op[b] == "mul":
                inner = self.constant_value(self.args[b][0])
                if inner is not None:
                    return self.mul(self.constant(ca * inner), self.args[b][1])
            if self.op[b] == "neg":
                return self.mul(self.constant(-ca), self.args[b][0])
            return self._operation("mul", a, b)
        if self.op[a] == "neg":
            return self.neg(self.mul(self.args[a][0], b))
        if self.op[b] == "neg":
            return self.neg(self.mul(a, self.args[b][0]))
        return self._operation("mul", *((a, b) if a <= b else (b, a)))

    def div(self, a: int, b: int) -> int:
        """Return the node of a / b.

        A quotient by 1 + exp(z), or by a product with it, becomes a product with a logistic
        function, which does not overflow.
        """
        ca, cb = self.constant_value(a), self.constant_value(b)
        if ca == 0.0:
            return self.zero
        if cb is not None and cb != 0.0:
            if ca is not None:
                return self.constant(ca / cb)
            if cb == 1.0:
                return a
            if cb == -1.0:
                return self.neg(a)
        if self.op[a] == "neg":
            return self.neg(self.div(self.args[a][0], b))
        if self.op[b] == "neg":
            return self.neg(self.div(a, self.args[b][0]))
        exponent = self._one_plus_exp(b)
        if exponent is not None:
            return self.mul(a, self.call("logistic", self.neg(exponent)))
        if self.op[b] == "mul":
            left, right = self.args[b]
            for factor, other in ((left, right), (right, left)):
                exponent = self._one_plus_exp(factor)
                if exponent is not None:
                    return self.div(self.mul(a, self.call("logistic", self.neg(exponent))), other)
        return self._operation("div", a, b)

    def pow(self, base: int, exponent: int) -> int:
        """Return the node of base ** exponent.

        Structural exponents become products, quotients and roots that are correct at base 0.
        """
        c = self.constant_value(exponent)
        if c is None:
            return (
                self.falling_power(base, exponent, 0)
                if self.is_data[exponent]
                else self._operation("pow", base, exponent)
            )
        number = self.constant_value(base)
        if number is not None:
            try:
                return self.constant(number**c)
            # 0**-1, or a complex root: the evaluation reports it.
            except (ArithmeticError, TypeError, ValueError):
                return self._operation("pow", base, exponent)
        if c == 0.0:
            return self.one
        if c == 0.5:
            return self.call("sqrt", base)
        if c in (1.0, 2.0, 3.0, 4.0):
            square = base if c == 1.0 else self.mul(base, base)
            return {
                1.0: lambda: base,
                2.0: lambda: square,
                3.0: lambda: self.mul(base, square),
                4.0: lambda: self.mul(square, square),
            }[c]()
        if c in (-1.0, -2.0):
            return self.div(self.one, self.pow(base, self.constant(-c)))
        return self._operation("pow", base, exponent)

    def falling_power(self, base: int, exponent: int, order: int) -> int:
        """Return the derivative of this order of base**p, for a data exponent p.

        It is p (p-1) .. (p-order+1) base**(p-order), and 0 if a factor is 0.
        """
        return self._node(
            "falling_power",
            (base, exponent, self.constant(order)),
            self.is_data[base] and self.is_data[exponent],
        )

    # -- functions

    def call(self, name: str, a: int) -> int:
        """Return the node of a function: one of `UNARY`, logistic, softplus or sech2."""
        ca = self.constant_value(a)
        if ca is not None and name in UNARY:
            try:
                return self.constant(UNARY[name](ca))
            except (ArithmeticError, ValueError):  # log(0): the evaluation reports it
                return self._operation(name, a)
        if name in ("log", "log10") and self.op[a] == "add":
            smooth = self._log_of_sum(a)
            if smooth is not None:
                return (
                    smooth
                    if name == "log"
                    else self.mul(self.constant(1.0 / math.log(10.0)), smooth)
                )
        return self._operation(name, a)

    def _one_plus_exp(self, node: int) -> int | None:
        if self.op[node] != "add":
            return None
        a, b = self.args[node]
        for left, right in ((a, b), (b, a)):
            if self.constant_value(left) == 1.0 and self.op[right] == "exp":
                return self.args[right][0]
        return None

    def _log_of_sum(self, node: int) -> int | None:
        """Return log(1 + exp(z)) and log(exp(y) + exp(z)) by softplus, which does not overflow."""
        exponent = self._one_plus_exp(node)
        if exponent is not None:
            return self._operation("softplus", exponent)
        a, b = self.args[node]
        if self.op[a] == "exp" and self.op[b] == "exp":
            y, z = self.args[a][0], self.args[b][0]
            return self.add(y, self._operation("softplus", self.sub(z, y)))
        return None

    # -- queries

    def reachable(
        self, *roots: int, until: Callable[[int], bool] = lambda node: False
    ) -> list[int]:
        """Return the roots and all nodes they depend on, ascending; `until` ends a branch."""
        seen = set(roots)
        stack = list(seen)
        while stack:
            node = stack.pop()
            if self.is_leaf(node) or until(node):
                continue
            for operand in self.args[node]:
                if operand not in seen:
                    seen.add(operand)
                    stack.append(operand)
        return sorted(seen)

    def is_leaf(self, node: int) -> bool:
        """Return whether the node has no operands."""
        return self.op[node] in (VARIABLE, DATUM, CONSTANT, SEED)


def _partial_derivatives(graph: Graph, node: int) -> tuple[tuple[int, int], ...]:
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


# d f(a) / d a, written so that the derivative keeps its relative accuracy and does not overflow
# where the function does not.
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
    """Return {variable index: node of d root / d variable}, without structural zeros."""
    adjoint: dict[int, int] = {root: graph.one}
    slopes: dict[int, int] = {}
    for node in reversed(graph.reachable(root)):
        bar = adjoint.pop(node, None)
        if bar is None or bar == graph.zero or graph.is_data[node]:
            continue
        if graph.op[node] == VARIABLE:
            slopes[graph.args[node][0]] = bar
            continue
        if graph.is_leaf(node):
            continue
        for operand, slope in _partial_derivatives(graph, node):
            if not graph.is_data[operand]:
                step = graph.mul(bar, slope)
                adjoint[operand] = graph.add(adjoint[operand], step) if operand in adjoint else step
    return slopes


def split_linear(graph: Graph, root: int) -> tuple[int, dict[int, int], int]:
    """Split root = constant + sum_i linear[i] * variable_i + nonlinear; the first parts are data.

    Data factors are carried through sums: h*(a*x + y*z) gives h*a for x.
    """
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
    return constant, linear, nonlinear


_LINEAR_OPERATIONS = frozenset({"add", "sub", "neg"})


def hessian_sparsity(graph: Graph, root: int) -> np.ndarray:
    """Return a superset (2, entries) of the variable pairs i >= j with second derivatives [-].

    Index sets are bit masks; a nonlinear operation joins those of its operands. Raises nothing.
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
    pairs = [np.empty((2, 0), dtype=np.intp)]
    for i in sorted(partners):
        columns = _bits(partners[i] & ((2 << i) - 1))
        pairs.append(np.stack([np.full(len(columns), i), columns]))
    return np.concatenate(pairs, axis=1)


def _bits(mask: int) -> np.ndarray:
    octets = np.frombuffer(mask.to_bytes((mask.bit_length() + 7) // 8, "little"), dtype=np.uint8)
    return np.flatnonzero(np.unpackbits(octets, bitorder="little"))

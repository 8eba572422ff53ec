"""A hash-consed expression graph: the algebra in which the term shapes of a model are differentiated.

A node is an integer. Its operands are always smaller integers, so ascending node number is an order of evaluation and descending
node number an order of back-propagation: nothing here recurses, and an expression ten thousand operations deep is an ordinary one.
Building the same operation on the same operands twice gives the same node, hence common subexpressions are shared for free.

    graph = Graph()
    x, p = graph.variable(0), graph.datum(0)
    f = graph.mul(p, graph.call("exp", x))        # p * exp(x)

Leaves: `variable(i)` is the i-th variable of the term, `datum(k)` its k-th number (a literal of the model, a Param, a fixed Var) and
`constant(c)` a number that belongs to the structure (an exponent, the 1 of `log(1 + exp(z))`). A node that depends on no variable
is *data*: it is worth computing once per refresh and not once per evaluation.
"""

from __future__ import annotations

import math
from collections.abc import Callable

VARIABLE, DATUM, CONSTANT, SEED = "variable", "datum", "constant", "seed"

# Functions of one argument that a Pyomo expression can hold, and the numbers they give on structural constants.
UNARY = {
    "exp": math.exp, "log": math.log, "log10": math.log10, "sqrt": math.sqrt,
    "sin": math.sin, "cos": math.cos, "tan": math.tan, "asin": math.asin, "acos": math.acos, "atan": math.atan,
    "sinh": math.sinh, "cosh": math.cosh, "tanh": math.tanh, "asinh": math.asinh, "acosh": math.acosh, "atanh": math.atanh,
}  # fmt: skip


class Graph:
    """Nodes `0 .. len(op)-1`: `op[n]` names the operation, `args[n]` holds operand nodes (for a leaf: its index or number)."""

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

    # -- leaves ---------------------------------------------------------------------------------------------------------------

    def variable(self, index: int) -> int:
        """The i-th variable of the term."""
        return self._node(VARIABLE, (index,), False)

    def datum(self, index: int) -> int:
        """The k-th number of the term: data, read again at each refresh."""
        return self._node(DATUM, (index,), True)

    def seed(self, index: int) -> int:
        """Component `index` of the direction in a Hessian-vector product."""
        return self._node(SEED, (index,), False)

    def constant(self, value: float) -> int:
        """A number that belongs to the structure; -0.0 is 0.0."""
        return self._node(CONSTANT, (float(value) + 0.0,), True)

    def constant_value(self, node: int) -> float | None:
        """The number of a structural constant, None for every other node."""
        return self.args[node][0] if self.op[node] == CONSTANT else None

    # -- arithmetic -------------------------------------------------------------------------------------------------------------

    def add(self, a: int, b: int) -> int:
        """Node of a + b, simplified where structural constants or signs allow."""
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
        """Node of a - b; zero where both are the same node."""
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
        """Node of -a; a sign in front of a sign or a difference goes inside."""
        ca = self.constant_value(a)
        if ca is not None:
            return self.constant(-ca)
        if self.op[a] == "neg":
            return self.args[a][0]
        if self.op[a] == "sub":
            return self._operation("sub", self.args[a][1], self.args[a][0])
        return self._operation("neg", a)

    def mul(self, a: int, b: int) -> int:
        """Node of a b; constants come first and are multiplied together."""
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
        """Node of a / b; a quotient by 1 + exp(z) is a product with a logistic function, which does not overflow."""
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
        return self._operation("div", a, b)

    def pow(self, base: int, exponent: int) -> int:
        """Node of base ** exponent. A structural exponent gives products, quotients and roots that are right at base 0."""
        c = self.constant_value(exponent)
        if c is None:
            return self.falling_power(base, exponent, 0) if self.is_data[exponent] else self._operation("pow", base, exponent)
        known = self.constant_value(base)
        if known is not None:
            try:
                return self.constant(known**c)
            except (ArithmeticError, TypeError, ValueError):  # 0**-1, or a complex root: let the evaluation report it
                return self._operation("pow", base, exponent)
        if c == 0.0:
            return self.one
        if c == 0.5:
            return self.call("sqrt", base)
        if c in (1.0, 2.0, 3.0, 4.0):
            square = base if c == 1.0 else self.mul(base, base)
            return {1.0: lambda: base, 2.0: lambda: square, 3.0: lambda: self.mul(base, square), 4.0: lambda: self.mul(square, square)}[c]()
        if c in (-1.0, -2.0):
            return self.div(self.one, self.pow(base, self.constant(-c)))
        return self._operation("pow", base, exponent)

    def falling_power(self, base: int, exponent: int, order: int) -> int:
        """Derivative of order `order` of base**p for a data exponent p: p (p-1) .. (p-order+1) base**(p-order), and 0 where a factor is 0."""
        return self._node("falling_power", (base, exponent, self.constant(order)), self.is_data[base] and self.is_data[exponent])

    # -- functions --------------------------------------------------------------------------------------------------------------

    def call(self, name: str, a: int) -> int:
        """One of `UNARY`, or the primitives the derivatives need: logistic, softplus, sech2."""
        ca = self.constant_value(a)
        if ca is not None and name in UNARY:
            try:
                return self.constant(UNARY[name](ca))
            except (ArithmeticError, ValueError):  # log(0): let the evaluation report it
                return self._operation(name, a)
        if name in ("log", "log10") and self.op[a] == "add":
            smooth = self._log_of_sum(a)
            if smooth is not None:
                return smooth if name == "log" else self.mul(self.constant(1.0 / math.log(10.0)), smooth)
        return self._operation(name, a)

    def _one_plus_exp(self, node: int) -> int | None:
        """The z of a node 1 + exp(z), in either order; None for another node."""
        if self.op[node] != "add":
            return None
        a, b = self.args[node]
        for left, right in ((a, b), (b, a)):
            if self.constant_value(left) == 1.0 and self.op[right] == "exp":
                return self.args[right][0]
        return None

    def _log_of_sum(self, node: int) -> int | None:
        """log(1 + exp(z)) = softplus(z) and log(exp(y) + exp(z)) = y + softplus(z - y): no overflow whatever z is."""
        exponent = self._one_plus_exp(node)
        if exponent is not None:
            return self._operation("softplus", exponent)
        a, b = self.args[node]
        if self.op[a] == "exp" and self.op[b] == "exp":
            y, z = self.args[a][0], self.args[b][0]
            return self.add(y, self._operation("softplus", self.sub(z, y)))
        return None

    # -- questions --------------------------------------------------------------------------------------------------------------

    def reachable(self, *roots: int, until: Callable[[int], bool] = lambda node: False) -> list[int]:
        """Every node the roots depend on, the roots included, ascending: an order of evaluation. Behind a node `until` holds for nothing is looked at."""
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
        """Whether a node has no operands."""
        return self.op[node] in (VARIABLE, DATUM, CONSTANT, SEED)

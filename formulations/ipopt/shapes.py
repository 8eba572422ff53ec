"""Term shapes: a signature (what the expression walker wrote down) becomes three generated functions, once per process.

    0.5 * k * (q[3] - q[1])**2   and   0.5 * k * (q[8] - q[2])**2

have one signature: two variable slots, one Param slot. It is analysed once: the affine part goes to
the sparse linear rows, what is left is differentiated exactly, and what depends on data alone is
computed once per refresh.

A generated function is numpy source with one statement an operation, so that neither nesting nor
recursion limits the size. It takes `x` (one row for each variable slot), `p` (one row for each
hoisted data value) and writes `out`; every row is an array over the instances of the shape, so that
a thousand equal terms cost as many numpy calls as one. `TermGroup` holds all terms of one shape in
one model.

Hessians of large terms are a generated Hessian-vector product, multiplied by few directions:
columns that share no row are read off one product (Curtis, Powell and Reid, 1974), so that a sum of
five thousand separate terms needs one direction, a dense Hessian as many as it has columns.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from formulations.ipopt.graph import (
    CONSTANT,
    DATUM,
    SEED,
    UNARY,
    VARIABLE,
    Graph,
    gradient,
    hessian_sparsity,
    split_linear,
)
from formulations.ipopt.read import Bucket

_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/"}


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
    """Derivative of base**p of this order: p (p-1) ..

    (p-order+1) base**(p-order), and 0 where the factor is 0 (so that x**p at x = 0 is right for p =
    0, 1, 2, ..).
    """
    factor = np.ones_like(exponent)
    for k in range(int(order)):
        factor = factor * (exponent - k)
    return np.where(factor == 0.0, 0.0, factor * np.power(base, exponent - order))


_NAMESPACE = {
    "softplus": _softplus, "logistic": _logistic, "sech2": _sech2, "falling_power": _falling_power,
    "pow": np.power, "div": np.divide,
    "neg": np.negative, "inf": np.inf, "nan": np.nan, **{name: getattr(np, name) for name in UNARY},
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
    if op in _INFIX and not (
        op == "div" and all(graph.op[a] == CONSTANT for a in args)
    ):  # there Python would raise, numpy gives inf or NaN
        return f"t{node} = {names[0]} {_INFIX[op]} {names[1]}"
    return f"t{node} = {op}({', '.join(names)})"


def hoist(graph: Graph, roots: Sequence[int]) -> dict[int, int]:
    """{data node, structural constants apart, that the roots use directly: its place in `p`}: computed once per refresh and handed in."""
    found = graph.reachable(*roots, until=lambda node: graph.is_data[node])
    return {
        node: k
        for k, node in enumerate(
            node for node in found if graph.is_data[node] and graph.op[node] != CONSTANT
        )
    }


def generate(
    graph: Graph,
    outputs: Sequence[int],
    hoisted: Mapping[int, int],
    row: Mapping[int, int],
    name: str,
) -> Callable[..., None]:
    """A function `(x, p, out, seed=None)` that writes outputs[k] to out[k].

    `hoisted[node]` is the row of p that holds a data node; `row[i]` is the row of x (and of seed)
    that holds variable i.
    """
    order = [
        n
        for n in graph.reachable(*outputs, until=hoisted.__contains__)
        if n not in hoisted and graph.op[n] != CONSTANT
    ]
    for node in order:
        if graph.op[node] == DATUM:
            raise ValueError(
                f"datum {graph.args[node][0]} is used by a generated function but was not hoisted"
            )
    lines = [f"def {name}(x, p, out, seed=None):"]
    lines += [f"    {_statement(graph, node, hoisted, row)}" for node in order]
    lines += [f"    out[{k}] = {_name(graph, node, hoisted)}" for k, node in enumerate(outputs)]
    lines.append("    return")
    namespace = dict(_NAMESPACE)
    exec(
        compile("\n".join(lines), f"<term shape: {name}>", "exec"), namespace
    )  # source made above from numbers and known names
    return namespace[name]


# Working set of one block of directions [numbers]: 64 MB.
_BLOCK = 8_000_000
# A pattern with a larger filled share than this is taken as dense: looking for columns without a
# common row would cost and find none.
_DENSE_SHARE = 0.1


def _product_nodes(graph: Graph, slopes: dict[int, int]) -> dict[int, int]:
    """{i: node of sum_j H[i, j] seed[j]}, by differentiating the directional derivative once more."""
    along = graph.zero
    for slot, slope in slopes.items():
        along = graph.add(along, graph.mul(slope, graph.seed(slot)))
    return gradient(graph, along)


def column_groups(pairs: np.ndarray, size: int) -> np.ndarray:
    """Groups of the Hessian's columns, such that two columns of a group have no common row.

    Raises nothing.

    Parameters
    ----------
    pairs : (2, entries) rows and columns of one triangle [-]
    size : number of columns

    Returns
    -------
    (size,) group of each column [-]
    """
    groups = np.arange(size)
    if pairs.shape[1] > _DENSE_SHARE * size * size:
        return groups
    rows_of: list[list[int]] = [[] for _ in range(size)]
    for i, j in pairs.T.tolist():
        rows_of[j].append(i)
        if i != j:
            rows_of[i].append(j)
    taken: list[set[int]] = [
        set() for _ in range(size)
    ]  # groups that already have an entry in this row
    for column in range(size):
        group = 0
        while any(group in taken[row] for row in rows_of[column]):
            group += 1
        groups[column] = group
        for row in rows_of[column]:
            taken[row].add(group)
    return groups


def _generate_by_products(
    graph: Graph,
    products: dict[int, int],
    pairs: np.ndarray,
    hoisted: Mapping[int, int],
    row: dict[int, int],
    operations: int,
) -> Callable[..., None]:
    """A function `(x, p, out)` that writes the Hessian entry of local pair pairs[:, k] to out[k].

    x (curved variables, instances) and out (entries, instances) as in `generate`; pairs (2,
    entries) [-].
    """
    order = list(products)
    product = generate(graph, [products[i] for i in order], hoisted, row, "hessian_product")
    size = len(row)
    place = np.full(size, -1, dtype=np.intp)
    place[[row[slot] for slot in order]] = np.arange(len(order))
    groups = column_groups(pairs, size)
    count = int(groups.max()) + 1
    entry_place, entry_group = place[pairs[0]], groups[pairs[1]]
    by_group = np.argsort(entry_group, kind="stable")
    starts = np.searchsorted(entry_group[by_group], np.arange(count + 1))

    def hessian(x: np.ndarray, p: list[np.ndarray], out: np.ndarray) -> None:
        """Write the entries into out (entries, instances) [row per variable^2].

        Raises nothing: NaN or inf where the model has no number.
        """
        instances = out.shape[1]
        block = max(1, min(count, _BLOCK // max(1, operations * instances)))
        for start in range(0, count, block):
            stop = min(count, start + block)
            seed = (groups[:, None] == np.arange(start, stop)).astype(float)[:, :, None]
            columns = np.empty((len(order), stop - start, instances))
            product(x, p, columns, seed)
            mine = by_group[starts[start] : starts[stop]]
            at = entry_place[mine]
            out[mine] = np.where((at >= 0)[:, None], columns[at, entry_group[mine] - start], 0.0)

    return hessian


# Above this product of variables and operations a symbolic Hessian would cost more source than it
# saves; the Hessian is then evaluated through one generated Hessian-vector product. 20 000
# operations compile in about 0.3 s.
_SYMBOLIC_HESSIAN_LIMIT = 20_000

Signature = tuple[Hashable, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpressionShape:
    """One analysed signature.

    Slots number the variables of a term; functions take rows over instances (see codegen).

    prepare(None, data, out) fills out (1 + len(linear) + number of hoisted values, instances):
    constant, linear coefficients, hoisted values.
    """

    linear: tuple[int, ...]  # slots with a linear coefficient
    curved: tuple[
        int, ...
    ]  # slots of the nonlinear part: row k of `x` in the functions below is slot curved[k]
    hoisted: int
    prepare: Callable[..., None]
    value: Callable[..., None] | None  # None: the term is affine
    slope_slots: tuple[int, ...]  # positions in `curved` of the gradient entries
    slope: Callable[..., None] | None
    hessian_pairs: np.ndarray  # (2, entries) positions in `curved` of each Hessian entry
    hessian: Callable[..., None] | None


@lru_cache(
    maxsize=20_000
)  # a process that builds new models for ever must not keep every shape it met; a scene needs about fifteen
def shape_of(signature: Signature) -> ExpressionShape:
    """The compiled shape of a signature, the same in the whole process."""
    return _compile_shape(*parse(signature))


def parse(signature: Signature) -> tuple[Graph, int]:
    """Graph and root of a signature: operands first (`"shared"` as first token) or operator first (everything else)."""
    graph = Graph()
    numbers = params = 0
    shared = signature[0] == "shared"
    # Operator-first text is read backwards, so that operands are ready when their operator comes;
    # then data slots count backwards too.
    tokens = signature[1:] if shared else signature[::-1]
    total_numbers, total_params = tokens.count("n"), tokens.count("p")
    values: list[int] = []
    made: list[int] = []

    for token in tokens:
        if isinstance(token, int):
            node = graph.variable(token)
        elif token == "n":
            node = graph.datum(numbers if shared else total_numbers - 1 - numbers)
            numbers += 1
        elif token == "p":
            node = graph.datum(total_numbers + (params if shared else total_params - 1 - params))
            params += 1
        elif isinstance(token, tuple) and token[0] == "c":
            node = graph.constant(token[1])
        elif isinstance(token, tuple) and token[0] == "ref":
            node = made[token[1]]
        else:
            node = _apply(graph, token, values, shared)
            made.append(node)
        values.append(node)
    return graph, values[-1]


def _apply(graph: Graph, token: Hashable, values: list[int], shared: bool) -> int:
    if isinstance(token, tuple) and token[0] == "^":  # ("^", structural exponent)
        return graph.pow(values.pop(), graph.constant(token[1]))
    if isinstance(token, tuple):  # ("+", number of summands)
        count = token[1]
        terms = values[len(values) - count :]
        del values[len(values) - count :]
        return _sum(graph, terms if shared else terms[::-1])
    if token == "neg":
        return graph.neg(values.pop())
    if token in UNARY:
        return graph.call(str(token), values.pop())
    first, second = values.pop(), values.pop()
    left, right = (second, first) if shared else (first, second)
    return {"*": graph.mul, "/": graph.div, "^": graph.pow}[str(token)](left, right)


def _sum(graph: Graph, terms: list[int]) -> int:
    """Left-to-right sum, as Pyomo evaluates it; 0 for no term."""
    total = graph.zero
    for term in terms:
        total = graph.add(total, term)
    return total


def _compile_shape(graph: Graph, root: int) -> ExpressionShape:
    constant, linear, nonlinear = split_linear(graph, root)
    slopes = gradient(graph, nonlinear)
    used = {graph.args[n][0] for n in graph.reachable(nonlinear) if graph.op[n] == "variable"}
    curved = tuple(sorted(used))
    local = {slot: k for k, slot in enumerate(curved)}
    slope_nodes = list(slopes.values())

    operations = len(graph.reachable(*slope_nodes, nonlinear))
    entries: dict[tuple[int, int], int] = {}
    products: dict[int, int] = {}
    directional = len(slopes) * operations > _SYMBOLIC_HESSIAN_LIMIT
    if directional:
        products = _product_nodes(graph, slopes)
        pairs = hessian_sparsity(graph, nonlinear)
    else:
        entries = _symbolic_hessian(graph, slopes)
        pairs = np.array(list(entries), dtype=np.intp).reshape(-1, 2).T

    hoisted = hoist(graph, [nonlinear, *slope_nodes, *products.values(), *entries.values()])
    slots = tuple(sorted(linear))
    raw = {node: graph.args[node][0] for node, op in enumerate(graph.op) if op == DATUM}
    prepare = generate(graph, [constant, *(linear[s] for s in slots), *hoisted], raw, {}, "prepare")
    pairs = np.searchsorted(np.array(curved, dtype=np.intp), pairs)
    hessian = None
    if directional:
        hessian = _generate_by_products(graph, products, pairs, hoisted, local, operations)
    elif entries:
        hessian = generate(graph, list(entries.values()), hoisted, local, "hessian")
    return ExpressionShape(
        linear=slots,
        curved=curved,
        hoisted=len(hoisted),
        prepare=prepare,
        value=generate(graph, [nonlinear], hoisted, local, "value") if curved else None,
        slope_slots=tuple(local[s] for s in slopes),
        slope=generate(graph, slope_nodes, hoisted, local, "slope") if slope_nodes else None,
        hessian_pairs=pairs,
        hessian=hessian,
    )


def _symbolic_hessian(graph: Graph, slopes: dict[int, int]) -> dict[tuple[int, int], int]:
    """{(i, j), i >= j: node of the second derivative}."""
    nodes: dict[tuple[int, int], int] = {}
    for i, slope in slopes.items():
        for j, node in gradient(graph, slope).items():
            if j <= i and node != graph.zero:
                nodes[i, j] = node
    return nodes


class TermGroup:
    """N instances of a shape. Arrays over instances are the last axis.

    rows, weights: (N,) the row of the model each term belongs to, and the number it is multiplied
        by there
    columns: (slots, N) the variable in each slot
    """

    def __init__(self, shape: ExpressionShape, bucket: Bucket) -> None:
        self.shape = shape
        self.rows = np.array(bucket.rows, dtype=np.intp)
        self.weights = np.array(bucket.weights, dtype=float)
        count = len(self.rows)
        self.columns = np.array(bucket.slots, dtype=np.intp).reshape(count, -1).T.copy()
        self._numbers = np.array(bucket.numbers, dtype=float).reshape(count, -1).T
        self._params = np.array(bucket.params, dtype=np.intp).reshape(count, -1).T
        self._curved = self.columns[list(shape.curved)]
        self._prepared = np.empty((1 + len(shape.linear) + shape.hoisted, count))
        self._hoisted: list[np.ndarray] = []

    # -- structure
    #   --------------------------------------------------------------------------------------------------------------

    @property
    def affine_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Places of the affine part, slot after slot; values in `affine_values` after a refresh.

        Raises nothing.

        Returns
        -------
        rows, columns (linear slots * N,) [-]
        """
        slots = list(self.shape.linear)
        return np.tile(self.rows, len(slots)), self.columns[slots].ravel()

    @property
    def slope_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Places of the nonlinear part's gradient entries.

        Raises nothing.

        Returns
        -------
        rows, columns (gradient slots * N,) [-]
        """
        slots = list(self.shape.slope_slots)
        return np.tile(self.rows, len(slots)), self._curved[slots].ravel()

    @property
    def curvature_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Places of the Hessian entries.

        Raises nothing.

        Returns
        -------
        larger column, smaller column (pairs * N,) [-]
        """
        first, second = (self._curved[slots].ravel() for slots in self.shape.hessian_pairs)
        return np.maximum(first, second), np.minimum(first, second)

    # -- values
    #   -----------------------------------------------------------------------------------------------------------------

    def refresh(self, data: np.ndarray) -> None:
        """Compute everything that depends on data alone, from all data of the model (data,) [units of the data].

        Raises nothing: NaN or inf where the model has no number.
        """
        self.shape.prepare(None, [*self._numbers, *data[self._params]], self._prepared)
        self._hoisted = list(self._prepared[1 + len(self.shape.linear) :])

    @property
    def constants(self) -> np.ndarray:
        """Weighted constant parts (N,) [units of the rows]. Raises nothing."""
        return self.weights * self._prepared[0]

    @property
    def affine_values(self) -> np.ndarray:
        """Weighted linear coefficients (linear slots * N,), in the order of `affine_entries` [row per variable]. Raises nothing."""
        return (self.weights * self._prepared[1 : 1 + len(self.shape.linear)]).ravel()

    @property
    def is_curved(self) -> bool:
        """Whether the terms have a nonlinear part."""
        return self.shape.value is not None

    def values(self, x: np.ndarray) -> np.ndarray:
        """Weighted values (N,) of the nonlinear parts at x (n,) [units of the rows].

        Raises nothing: NaN or inf where the model has no number.
        """
        out = np.empty((1, len(self.rows)))
        self.shape.value(x[self._curved], self._hoisted, out)  # pyright: ignore[reportOptionalCall] - asked only where is_curved
        return self.weights * out[0]

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Weighted gradient entries (gradient slots * N,) at x (n,), in the order of `slope_entries` [row per variable].

        Raises nothing: NaN or inf where the model has no number.
        """
        out = np.empty((len(self.shape.slope_slots), len(self.rows)))
        if self.shape.slope is not None:
            self.shape.slope(x[self._curved], self._hoisted, out)
        return (self.weights * out).ravel()

    def curvatures(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Weighted Hessian entries times the multiplier of each term's row.

        Raises nothing: NaN or inf where the model has no number.

        Parameters
        ----------
        x : (n,) point [units of the variables]
        multipliers : (constraints + 1,) of all rows [objective per row]

        Returns
        -------
        (pairs * N,) entries in the order of `curvature_entries` [objective per variable^2]
        """
        out = np.empty((self.shape.hessian_pairs.shape[1], len(self.rows)))
        if self.shape.hessian is not None:
            self.shape.hessian(x[self._curved], self._hoisted, out)
        return (self.weights * multipliers[self.rows] * out).ravel()

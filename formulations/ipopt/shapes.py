"""Term shapes: a signature (what the expression walker wrote down) becomes three generated functions, once per process.

    0.5 * k * (q[3] - q[1])**2   and   0.5 * k * (q[8] - q[2])**2

have one signature: two variable slots, one Param slot. It is analysed once: the affine part goes to the sparse linear rows, what is
left is differentiated exactly, and what depends on data alone is computed once per refresh.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from formulations.ipopt.codegen import generate, hoist
from formulations.ipopt.differentiate import gradient, hessian_sparsity, split_linear
from formulations.ipopt.graph import UNARY, Graph
from formulations.ipopt.hessian_products import generate_by_products, product_nodes

# Above this product of variables and operations a symbolic Hessian would cost more source than it saves; the Hessian is then evaluated
# through one generated Hessian-vector product. 20 000 operations compile in about 0.3 s.
SYMBOLIC_HESSIAN_LIMIT = 20_000
# A process that builds new models for ever must not keep every shape it met; a scene needs about fifteen.
CACHE_LIMIT = 20_000

Signature = tuple[Hashable, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """One analysed signature. Slots number the variables of a term; functions take rows over instances (see codegen).

    prepare(data) fills (1 + len(linear) + number of hoisted values, instances): constant, linear coefficients, hoisted values.
    """

    linear: tuple[int, ...]  # slots with a linear coefficient
    curved: tuple[int, ...]  # slots of the nonlinear part: row k of `x` in the functions below is slot curved[k]
    hoisted: int
    prepare: Callable[..., None]
    value: Callable[..., None] | None  # None: the term is affine
    slope_slots: tuple[int, ...]  # positions in `curved` of the gradient entries
    slope: Callable[..., None] | None
    hessian_pairs: np.ndarray  # (2, entries) positions in `curved` of each Hessian entry
    hessian: Callable[..., None] | None

    @property
    def prepared(self) -> int:
        return 1 + len(self.linear) + self.hoisted


_cache: dict[Signature, Shape] = {}


def shape_of(signature: Signature) -> Shape:
    """The compiled shape of a signature, from the process-wide cache when it was met before."""
    shape = _cache.get(signature)
    if shape is None:
        if len(_cache) >= CACHE_LIMIT:
            del _cache[next(iter(_cache))]
        shape = _cache[signature] = compile_shape(*parse(signature))
    return shape


def parse(signature: Signature) -> tuple[Graph, int]:
    """(graph, root) of a signature: operands first (`"shared"` as first token) or operator first (everything else)."""
    graph = Graph()
    numbers = params = 0
    shared = signature[0] == "shared"
    # Operator-first text is read backwards, so that operands are ready when their operator comes; then data slots count backwards too.
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


def compile_shape(graph: Graph, root: int) -> Shape:
    split = split_linear(graph, root)
    slopes = gradient(graph, split.nonlinear)
    used = {graph.args[n][0] for n in graph.reachable(split.nonlinear) if graph.op[n] == "variable"}
    curved = tuple(sorted(used))
    local = {slot: k for k, slot in enumerate(curved)}
    slope_nodes = list(slopes.values())

    operations = len(graph.reachable(*slope_nodes, split.nonlinear))
    entries: dict[tuple[int, int], int] = {}
    products: dict[int, int] = {}
    directional = len(slopes) * operations > SYMBOLIC_HESSIAN_LIMIT
    if directional:
        products = product_nodes(graph, slopes)
        pairs = hessian_sparsity(graph, split.nonlinear)
    else:
        entries = _symbolic_hessian(graph, slopes)
        pairs = np.array(list(entries), dtype=np.intp).reshape(-1, 2).T

    hoisted = hoist(graph, [split.nonlinear, *slope_nodes, *products.values(), *entries.values()])
    linear = tuple(sorted(split.linear))
    prepare = generate_prepare(graph, [split.constant, *(split.linear[s] for s in linear), *hoisted])
    pairs = np.searchsorted(np.array(curved, dtype=np.intp), pairs)
    hessian = None
    if directional:
        hessian = generate_by_products(graph, products, pairs, hoisted, local, operations)
    elif entries:
        hessian = generate(graph, list(entries.values()), hoisted, local, "hessian")
    return Shape(
        linear=linear,
        curved=curved,
        hoisted=len(hoisted),
        prepare=prepare,
        value=generate(graph, [split.nonlinear], hoisted, local, "value") if curved else None,
        slope_slots=tuple(local[s] for s in slopes),
        slope=generate(graph, slope_nodes, hoisted, local, "slope") if slope_nodes else None,
        hessian_pairs=pairs,
        hessian=hessian,
    )


def generate_prepare(graph: Graph, outputs: list[int]) -> Callable[..., None]:
    """The once-per-refresh function: its `p` are the raw data slots of the shape."""
    data = [n for n in range(len(graph.op)) if graph.op[n] == "datum"]
    inner = generate(graph, outputs, data, {}, "prepare")
    indices = [graph.args[n][0] for n in data]

    def prepare(rows: np.ndarray, out: np.ndarray) -> None:
        inner(None, [rows[i] for i in indices], out)

    return prepare


def _symbolic_hessian(graph: Graph, slopes: dict[int, int]) -> dict[tuple[int, int], int]:
    """{(i, j), i >= j: node of the second derivative}."""
    nodes: dict[tuple[int, int], int] = {}
    for i, slope in slopes.items():
        for j, node in gradient(graph, slope).items():
            if j <= i and node != graph.zero:
                nodes[i, j] = node
    return nodes

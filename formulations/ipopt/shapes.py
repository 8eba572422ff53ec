"""Compile term shapes: a signature becomes tapes, once per process.

    0.5 * k * (q[3] - q[1])**2   and   0.5 * k * (q[8] - q[2])**2

share one signature. The affine part goes to the sparse rows, the rest is differentiated exactly.
Hessians of large terms use Hessian-vector products: columns without a common row share a direction
(Curtis, Powell and Reid, 1974).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from formulations.ipopt.graph import (
    CONSTANT,
    DATUM,
    SEED,
    UNARY,
    Graph,
    gradient,
    hessian_sparsity,
    split_linear,
)
from formulations.ipopt.read import Bucket
from formulations.ipopt.tape import Tape, record


def hoist(graph: Graph, roots: Sequence[int]) -> dict[int, int]:
    """Number the data nodes, except structural constants, that the roots use directly."""
    nodes = graph.reachable(*roots, until=lambda node: graph.is_data[node])
    return {
        node: k
        for k, node in enumerate(
            node for node in nodes if graph.is_data[node] and graph.op[node] != CONSTANT
        )
    }


# A pattern with a larger filled share counts as dense: columns without a common row are unlikely.
_DENSE_SHARE = 0.1


def _product_nodes(graph: Graph, slopes: dict[int, int]) -> dict[int, int]:
    """Return {i: node of sum_j H[i, j] seed[j]}."""
    along = graph.zero
    for slot, slope in slopes.items():
        along = graph.add(along, graph.mul(slope, graph.seed(slot)))
    return gradient(graph, along)


def column_groups(pairs: np.ndarray, size: int) -> np.ndarray:
    """Return a group (size,) for each column; columns of one group have no common row [-].

    pairs (2, entries) are rows and columns of one triangle. Raises nothing.
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


# Above this product of variables and operations, one Hessian-vector product replaces the symbolic
# Hessian, whose source would cost more than it saves. 20 000 operations compile in about 0.3 s.
_SYMBOLIC_HESSIAN_LIMIT = 20_000

Signature = tuple[Hashable, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpressionShape:
    """One analysed signature; slots number the variables of a term.

    `prepare` maps the numbers and Params of a term to its constant, linear coefficients and hoisted
    values.
    """

    linear: tuple[int, ...]  # slots with a linear coefficient
    curved: tuple[int, ...]  # slots of the nonlinear part: variable k of the tapes is curved[k]
    hoisted: int
    prepare: Tape
    value: Tape | None  # None: the term is affine
    slope_slots: tuple[int, ...]  # positions in `curved` of the gradient entries
    slope: Tape | None
    hessian_pairs: np.ndarray  # (2, entries) positions in `curved` of each Hessian entry
    hessian: Tape | None
    # directions: (curved, directions) of the product; output: (2, entries) output and direction of
    # each Hessian entry, output < 0 without one. None: the outputs of `hessian` are the entries.
    directions: np.ndarray | None = None
    output: np.ndarray | None = None


# Bounded for processes that build new models forever; a scene needs about fifteen shapes.
@lru_cache(maxsize=20_000)
def shape_of(signature: Signature) -> ExpressionShape:
    """Return the compiled shape of a signature."""
    return _compile_shape(*parse(signature))


def parse(signature: Signature) -> tuple[Graph, int]:
    """Return graph and root of a signature; operands come first only after `"shared"`."""
    graph = Graph()
    numbers = params = 0
    shared = signature[0] == "shared"
    # Operator-first text is read backwards, so that operands precede their operator; data slots
    # then count backwards too.
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
    prepare = record(graph, [constant, *(linear[s] for s in slots), *hoisted], raw, {})
    pairs = np.searchsorted(np.array(curved, dtype=np.intp), pairs)
    hessian = directions = output = None
    if directional:
        seeds = {n: len(hoisted) + local[graph.args[n][0]] for n in _seeds(graph)}
        hessian = record(graph, list(products.values()), {**hoisted, **seeds}, local)
        directions, output = _directions(pairs, [local[slot] for slot in products], len(curved))
    elif entries:
        hessian = record(graph, list(entries.values()), hoisted, local)
    return ExpressionShape(
        linear=slots,
        curved=curved,
        hoisted=len(hoisted),
        prepare=prepare,
        value=record(graph, [nonlinear], hoisted, local) if curved else None,
        slope_slots=tuple(local[s] for s in slopes),
        slope=record(graph, slope_nodes, hoisted, local) if slope_nodes else None,
        hessian_pairs=pairs,
        hessian=hessian,
        directions=directions,
        output=output,
    )


def _seeds(graph: Graph) -> list[int]:
    return [node for node, op in enumerate(graph.op) if op == SEED]


def _directions(
    pairs: np.ndarray, products: Sequence[int], size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return directions (size, count), and the product and direction (2, entries) of each entry.

    products: the Hessian row of each output; entries of other rows are zero.
    """
    groups = column_groups(pairs, size)
    of_row = np.full(size, -1, dtype=np.intp)
    of_row[list(products)] = np.arange(len(products))
    directions = (groups[:, None] == np.arange(groups.max() + 1)).astype(float)
    return directions, np.stack([of_row[pairs[0]], groups[pairs[1]]])


def _symbolic_hessian(graph: Graph, slopes: dict[int, int]) -> dict[tuple[int, int], int]:
    nodes: dict[tuple[int, int], int] = {}
    for i, slope in slopes.items():
        for j, node in gradient(graph, slope).items():
            if j <= i and node != graph.zero:
                nodes[i, j] = node
    return nodes


_NONE = np.empty(0)
_NOWHERE = np.empty(0, dtype=np.int32)


class TermGroup:
    """N instances of a shape; the last axis of arrays is the instance.

    rows, weights: (N,) the row of each term, and its factor
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
        self._curved = self.columns[list(shape.curved)].astype(np.int32)
        self._prepared = np.empty((1 + len(shape.linear) + shape.hoisted, count))
        self._hoisted = self._prepared[1 + len(shape.linear) :]
        self._along = self._hoisted
        self._curved_along = self._curved
        if shape.directions is not None:
            self._curved_along = np.tile(self._curved, shape.directions.shape[1])

    # -- structure

    @property
    def affine_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns (linear slots * N,) of the affine part [-]. Raises nothing."""
        slots = list(self.shape.linear)
        return np.tile(self.rows, len(slots)), self.columns[slots].ravel()

    @property
    def slope_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns (gradient slots * N,) of the nonlinear gradient [-].

        Raises nothing.
        """
        slots = list(self.shape.slope_slots)
        return np.tile(self.rows, len(slots)), self._curved[slots].ravel().astype(np.intp)

    @property
    def curvature_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Return larger and smaller columns (pairs * N,) of the Hessian [-]. Raises nothing."""
        first, second = (
            self._curved[slots].ravel().astype(np.intp) for slots in self.shape.hessian_pairs
        )
        return np.maximum(first, second), np.minimum(first, second)

    def curvature_places(self, places: np.ndarray) -> np.ndarray:
        """Spread the places (pairs * N,) of the entries for `add_curvatures` [-].

        Raises nothing.
        """
        places = places.astype(np.int32).reshape(-1, len(self.rows))
        shape = self.shape
        if shape.hessian is None or shape.directions is None or shape.output is None:
            return places
        stored, (output, direction) = shape.output[0] >= 0, shape.output
        size = (shape.hessian.outputs, shape.directions.shape[1], len(self.rows))
        spread = np.full(size, -1, dtype=np.int32)
        spread[output[stored], direction[stored]] = places[stored]
        return spread

    # -- values

    def refresh(self, data: np.ndarray) -> None:
        """Compute the data-only parts from all data of the model (data,) [data units].

        Raises nothing.
        """
        inputs = np.ascontiguousarray(np.concatenate([self._numbers, data[self._params]]))
        place = np.arange(self._prepared.size, dtype=np.int32)
        self._prepared[:] = 0.0
        self.shape.prepare.run(
            _NONE, _NOWHERE, inputs, np.ones(len(self.rows)), place, self._prepared
        )
        if self.shape.directions is not None:
            seeds = np.repeat(self.shape.directions, len(self.rows), axis=1)
            count = self.shape.directions.shape[1]
            self._along = np.concatenate([np.tile(self._hoisted, count), seeds])

    @property
    def constants(self) -> np.ndarray:
        """Return the weighted constant parts (N,) [row units]. Raises nothing."""
        return self.weights * self._prepared[0]

    @property
    def affine_values(self) -> np.ndarray:
        """Return the weighted coefficients (linear slots * N,) [row per variable].

        Raises nothing.
        """
        return (self.weights * self._prepared[1 : 1 + len(self.shape.linear)]).ravel()

    @property
    def is_curved(self) -> bool:
        """Return whether the terms have a nonlinear part."""
        return self.shape.value is not None

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the weighted nonlinear values (N,) at x (n,) [row units]. Raises nothing."""
        out = np.zeros(len(self.rows))
        self.add_values(x, np.arange(len(out), dtype=np.int32), out)
        return out

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Return the weighted gradient (gradient slots * N,) at x (n,) [row per variable].

        Raises nothing.
        """
        out = np.zeros(len(self.shape.slope_slots) * len(self.rows))
        self.add_slopes(x, np.arange(len(out), dtype=np.int32), out)
        return out

    def add_values(self, x: np.ndarray, places: np.ndarray, total: np.ndarray) -> None:
        """Add the weighted values at x (n,) to their places (N,) in total [row units].

        Raises nothing.
        """
        if self.shape.value is not None:
            self.shape.value.run(x, self._curved, self._hoisted, self.weights, places, total)

    def add_slopes(self, x: np.ndarray, places: np.ndarray, total: np.ndarray) -> None:
        """Add the weighted gradient at x (n,) to its places (slots * N,) in total.

        Raises nothing.
        """
        if self.shape.slope is not None:
            self.shape.slope.run(x, self._curved, self._hoisted, self.weights, places, total)

    def add_curvatures(
        self, x: np.ndarray, multipliers: np.ndarray, places: np.ndarray, total: np.ndarray
    ) -> None:
        """Add the Hessian entries at x (n,), weighted by multipliers (constraints + 1,), to total.

        places come from `curvature_places`; total is in [objective per variable^2]. Raises nothing.
        """
        if self.shape.hessian is None:
            return
        scale = self.weights * multipliers[self.rows]
        if self.shape.directions is not None:
            scale = np.tile(scale, self.shape.directions.shape[1])
        self.shape.hessian.run(x, self._curved_along, self._along, scale, places, total)

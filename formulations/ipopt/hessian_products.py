"""Hessians of large terms: a generated Hessian-vector product, multiplied by few directions.

Columns of the Hessian that share no row are read off one product (Curtis, Powell and Reid, 1974): a sum of five thousand separate terms
needs one direction, a dense Hessian as many as it has columns.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from formulations.ipopt.codegen import generate
from formulations.ipopt.differentiate import gradient
from formulations.ipopt.graph import Graph

# Working set of one block of directions [numbers]: 64 MB.
_BLOCK = 8_000_000
# A pattern with a larger filled share than this is taken as dense: looking for columns without a common row would cost and find none.
_DENSE_SHARE = 0.1


def product_nodes(graph: Graph, slopes: dict[int, int]) -> dict[int, int]:
    """{i: node of sum_j H[i, j] seed[j]}, by differentiating the directional derivative once more."""
    along = graph.zero
    for slot, slope in slopes.items():
        along = graph.add(along, graph.mul(slope, graph.seed(slot)))
    return gradient(graph, along)


def column_groups(pairs: np.ndarray, size: int) -> np.ndarray:
    """(size,) group of each column, such that two columns of a group have no common row; pairs (2, entries) is one triangle."""
    groups = np.arange(size)
    if pairs.shape[1] > _DENSE_SHARE * size * size:
        return groups
    rows_of: list[list[int]] = [[] for _ in range(size)]
    for i, j in pairs.T.tolist():
        rows_of[j].append(i)
        if i != j:
            rows_of[i].append(j)
    taken: list[set[int]] = [set() for _ in range(size)]  # groups that already have an entry in this row
    for column in range(size):
        group = 0
        while any(group in taken[row] for row in rows_of[column]):
            group += 1
        groups[column] = group
        for row in rows_of[column]:
            taken[row].add(group)
    return groups


def generate_by_products(
    graph: Graph, products: dict[int, int], pairs: np.ndarray, hoisted: list[int], row: dict[int, int], operations: int
) -> Callable[..., None]:
    """A function `(x, p, out)` that writes the Hessian entry of local pair pairs[:, k] to out[k]; `row` as in codegen."""
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

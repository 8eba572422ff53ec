"""Derivatives of a column of expressions by the chain rule over what its entries share, as definitions to be evaluated in order.

    pushed = push_forward(f, [(x, dx)])        # df = (df/dx) dx, forward: one tangent for each shared subexpression
    pulled = pull_back(f, w, [x])              # (df/dx)' w, backward: one adjoint for each shared subexpression
    forward_function("void name", (x, p, tangent(x)), "df", f, [x])       # the same as C functions
    backward_function("void name", (x, p, w), f, w, [x])                  # this one adds to x_bar

Differentiated whole, an expression whose parts are shared many times is written out once for each of them: minutes of computer algebra for a box
pushed by a finger, and thousands of operations that are found to be equal again afterwards.
Griewank and Walther, Evaluating Derivatives (2008), sections 3.1 and 3.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp

from models.codegen.c_function import Definitions, Vector, c_function


@dataclass(frozen=True)
class Derivative:
    """Columns (one: of a forward product; one for each vector: of a backward one) in the symbols of `definitions`, each in terms of those before."""

    definitions: Definitions
    columns: tuple[sp.Matrix, ...]


def push_forward(function: sp.Matrix, directions: Sequence[tuple[Vector, Vector]]) -> Derivative:
    """(df/dx) dx of a column f (m, 1), summed over the pairs (x, dx): one column (m, 1)."""
    shared, entries = _shared(function)
    moving: dict[sp.Symbol, sp.Expr] = {x: dx for vector, along in directions for x, dx in zip(vector.symbols, along.symbols, strict=True)}
    definitions: list[tuple[sp.Symbol, sp.Expr]] = []
    for number, (symbol, value) in enumerate(shared):
        definitions.append((symbol, value))
        along = _along(value, moving)
        if along != 0:
            moving[symbol] = sp.Symbol(f"tangent{number}", real=True)
            definitions.append((moving[symbol], along))
    return Derivative(tuple(definitions), (sp.Matrix(len(entries), 1, [_along(entry, moving) for entry in entries]),))


def pull_back(function: sp.Matrix, weights: Vector, vectors: Sequence[Vector]) -> Derivative:
    """(df/dx)' w of a column f (m, 1) with weights w (m entries): a column for each x of `vectors`."""
    shared, entries = _shared(function)
    wanted = {symbol for vector in vectors for symbol in vector.symbols}
    for symbol, value in shared:  # what depends on none of them needs no adjoint
        if value.free_symbols & wanted:
            wanted.add(symbol)
    adjoint: dict[sp.Symbol, sp.Expr] = dict.fromkeys(wanted, sp.Integer(0))

    def distribute(value: sp.Expr, weight: sp.Expr) -> None:
        for argument in sorted(value.free_symbols & wanted, key=lambda symbol: symbol.name):
            adjoint[argument] += sp.diff(value, argument) * weight

    for entry, weight in zip(entries, weights.symbols, strict=True):
        distribute(entry, weight)
    backward: list[tuple[sp.Symbol, sp.Expr]] = []
    for number, (symbol, value) in reversed(list(enumerate(shared))):
        if adjoint.get(symbol, 0) == 0:
            continue
        bar = sp.Symbol(f"adjoint{number}", real=True)
        backward.append((bar, adjoint[symbol]))
        distribute(value, bar)
    columns = tuple(sp.Matrix(len(vector.symbols), 1, [adjoint[symbol] for symbol in vector.symbols]) for vector in vectors)
    return Derivative((*shared, *backward), columns)


def tangent(vector: Vector) -> Vector:
    """The direction d<vector> along which a product of <vector> is taken."""
    return vector.like(f"d{vector.name}")


def forward_function(
    head: str, arguments: Sequence[Vector], output: str | None, function: sp.Matrix, vectors: Sequence[Vector], tail: str = ""
) -> str:
    """The C function `head` (its type and name): Jacobian-vector product of a column along d<vector> of each of `vectors`."""
    pushed = push_forward(function, [(vector, tangent(vector)) for vector in vectors])
    result, name = head.split()
    return c_function(result, name, arguments, output, pushed.columns[0], tail=tail, definitions=pushed.definitions)


def backward_function(
    head: str, arguments: Sequence[Vector], function: sp.Matrix, weights: Vector, vectors: Sequence[Vector], tail: str = ""
) -> str:
    """The C function `head`: it adds Jacobian' weights to <vector>_bar of each of `vectors`."""
    pulled = pull_back(function, weights, vectors)
    result, name = head.split()
    outputs = [(f"{vector.name}_bar", column) for vector, column in zip(vectors, pulled.columns, strict=True)]
    return c_function(result, name, arguments, outputs, operator="+=", tail=tail, definitions=pulled.definitions)


def _shared(function: sp.Matrix) -> tuple[list[tuple[sp.Symbol, sp.Expr]], list[sp.Expr]]:
    """Definitions of what the entries share, and the entries in their symbols."""
    return sp.cse(list(function), symbols=sp.numbered_symbols("part", real=True), order="canonical")


def _along(value: sp.Expr, moving: dict[sp.Symbol, sp.Expr]) -> sp.Expr:
    """The derivative of `value` where its symbols change by `moving`."""
    symbols = sorted((symbol for symbol in value.free_symbols if symbol in moving), key=lambda symbol: symbol.name)
    return sp.Add(*(sp.diff(value, symbol) * moving[symbol] for symbol in symbols))

"""Tokens of a term too long to be read as a tree: operands first, every shared subexpression once.

Same alphabet as `TermReader`, with `"shared"` in front and `("ref", k)` for the k-th operation already written.
"""

from __future__ import annotations

from typing import Any, Protocol

from pyomo.common.numeric_types import native_numeric_types

from formulations.ipopt import kinds
from formulations.ipopt.evaluated import as_data
from formulations.ipopt.graph import UNARY


class Places(Protocol):
    """Where leaves belong: what a `TermReader` knows of the model it reads."""

    where: Any

    def place(self, leaf: Any) -> int:
        """Column of a free variable, or ~k for the k-th datum."""
        ...

    def open_named(self, named: Any) -> Any:
        """What a named expression holds."""
        ...


def read_shared(reader: Places, root: Any) -> tuple[tuple, list[int], list[float], list[int]]:
    tokens: list[Any] = ["shared"]
    numbers: list[float] = []
    params: list[int] = []
    slot: dict[int, int] = {}
    written: dict[int, int] = {}  # id(expression) -> number of the operation that computes it
    operations = 0
    stack: list[tuple[Any, Any]] = [(root, None)]
    while stack:
        node, operator = stack.pop()
        if operator is not None:
            tokens.append(operator)
            written[id(node)] = operations
            operations += 1
            continue
        code = kinds.kind_of(node)
        if code == kinds.NAMED:
            stack.append((reader.open_named(node), None))
            continue
        if code == kinds.NUMBER:
            tokens.append(("c", 1.0) if node == 1 else "n")
            if node != 1:
                numbers.append(node)
            continue
        if code == kinds.LEAF:
            where = reader.place(node)
            if where >= 0:
                tokens.append(slot.setdefault(where, len(slot)))
            else:
                tokens.append("p")
                params.append(~where)
            continue
        if id(node) in written:
            tokens.append(("ref", written[id(node)]))
            continue
        operands = list(node.args) if code != kinds.OTHER else []
        if code == kinds.SUM:
            operator = ("+", len(operands))
        elif code in (kinds.PRODUCT, kinds.MONOMIAL):
            operator = "*"
        elif code == kinds.DIVISION:
            operator = "/"
        elif code == kinds.NEGATION:
            operator = "neg"
        elif code == kinds.POWER:
            constant = operands[1].__class__ in native_numeric_types
            operator = ("^", float(operands.pop())) if constant else "^"
        elif code == kinds.FUNCTION and node.getname() in UNARY:
            operator = node.getname()
        else:
            tokens.append("p")
            params.append(~reader.place(as_data(node, reader.where)))
            continue
        stack.append((node, operator))
        stack.extend((operand, None) for operand in reversed(operands))
    return tuple(tokens), list(slot), numbers, params

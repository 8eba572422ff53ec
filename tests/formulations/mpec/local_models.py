"""Models to first order, written by hand: rows, pairs and their gradients."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse

from formulations.certificate.local import LocalModel, Pair, Rows

INF = math.inf


@dataclass(frozen=True, eq=False)
class Source:
    """A stand-in for a component of a model."""

    name: str


@dataclass(frozen=True, eq=False)
class Row:
    """lower <= value <= upper of a source."""

    value: float
    lower: float = -INF
    upper: float = INF
    argument: int | None = None
    source: Source = Source("row")


def row(
    value: float,
    lower: float = -INF,
    upper: float = INF,
    argument: int | None = None,
    name: str = "row",
) -> Row:
    """Return a row of a new source."""
    return Row(value=value, lower=lower, upper=upper, argument=argument, source=Source(name))


def together(*items: Row) -> Rows:
    """Return the rows of a model."""
    value, lower, upper = (
        np.array([getattr(item, name) for item in items], dtype=float)
        for name in ("value", "lower", "upper")
    )
    return Rows(
        sources=tuple(item.source for item in items),
        arguments=tuple(item.argument for item in items),
        value=value,
        lower=lower,
        upper=upper,
    )


def pair(
    first: float,
    second: float,
    *,
    flips: tuple[float, float] = (1.0, 1.0),
    arguments: tuple[int, int] = (0, 1),
    source: Any = None,
) -> Pair:
    """Return a pair with these values of its sides."""
    return Pair(
        source=source or Source("pair"),
        first=first,
        second=second,
        first_flip=flips[0],
        second_flip=flips[1],
        arguments=arguments,
    )


def local(
    x: Sequence[Row], rows: Sequence[tuple[Row, Sequence[float]]] = (),
    pairs: Sequence[tuple[Pair, Sequence[float], Sequence[float]]] = (),
    gradient: Sequence[float] | None = None, objective: float = 0.0, scale: float = 1.0,
) -> LocalModel:  # fmt: skip
    """Return a model of variables by their bounds, and of rows and pairs with their gradients."""
    n = len(x)

    def matrix(items: list[Sequence[float]]) -> sparse.csr_matrix:
        return sparse.csr_matrix(np.array(items, dtype=float).reshape(len(items), n))

    return LocalModel(
        variables=tuple(item.source for item in x), objective=objective,
        gradient=np.zeros(n) if gradient is None else np.array(gradient, dtype=float),
        rows=together(*(item for item, _ in rows), *x),
        jacobian=matrix([slopes for _, slopes in rows]), pairs=tuple(item for item, *_ in pairs),
        first_jacobian=matrix([first for _, first, _ in pairs]),
        second_jacobian=matrix([second for *_, second in pairs]), scale=scale,
    )  # fmt: skip

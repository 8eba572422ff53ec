"""The model at its current values, to first order: values by `pyomo.value`, gradients by Pyomo's own differentiation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyomo.environ as pyo
import scipy.sparse as sparse
from pyomo.core.expr.calculus.derivatives import Modes, differentiate
from pyomo.core.expr.visitor import identify_variables
from pyomo.mpec import Complementarity
from pyomo.repn import generate_standard_repn


@dataclass(frozen=True, kw_only=True, eq=False)
class Row:
    """lower <= value <= upper, of component `source`: a constraint, a variable's bounds, or an argument of a complementarity that must hold."""

    source: Any
    value: float
    lower: float
    upper: float
    argument: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """0 <= first, 0 <= second, complementary. A flip is -1 where a side is the negative of what the user wrote (upper bound);
    arguments: which argument of `complements` each side is."""

    source: Any
    first: float
    second: float
    first_flip: float
    second_flip: float
    arguments: tuple[int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalModel:
    """objective and its gradient (n,) are those of the minimised objective. rows with jacobian (rows, n), then the variables' bounds;
    pairs with gradients first_jacobian, second_jacobian (pairs, n), in the signs of `Pair`."""

    variables: tuple[Any, ...]
    objective: float
    gradient: np.ndarray
    rows: tuple[Row, ...]
    jacobian: sparse.csr_matrix
    bounds: tuple[Row, ...]
    pairs: tuple[Pair, ...]
    first_jacobian: sparse.csr_matrix
    second_jacobian: sparse.csr_matrix


@contextmanager
def values_set(variables: Iterable[Any], numbers: Iterable[float]) -> Iterator[None]:
    """Variables at these numbers for the time being; their values and staleness come back whatever happens."""
    variables = list(variables)
    kept = [(variable, variable.value, variable.stale) for variable in variables]
    try:
        for variable, number in zip(variables, numbers, strict=True):
            variable.set_value(number, skip_validation=True)
        yield
    finally:
        for variable, number, stale in kept:
            variable.set_value(number, skip_validation=True)
            variable.stale = stale


class _Reader:
    """Columns for variables, in order of appearance; gradients as triplets."""

    def __init__(self) -> None:
        self.variables: list[Any] = []
        self._place: dict[int, int] = {}

    def column(self, variable: Any) -> int:
        known = self._place.get(id(variable))
        if known is None:
            known = self._place[id(variable)] = len(self.variables)
            self.variables.append(variable)
        return known

    def gradient(self, expression: Any) -> dict[int, float]:
        """Derivatives by column; NaN where Pyomo cannot evaluate one."""
        if not hasattr(expression, "is_potentially_variable") or not expression.is_potentially_variable():
            return {}
        affine = generate_standard_repn(expression, compute_values=True, quadratic=False)
        if affine.is_linear():
            slopes: dict[int, float] = {}
            for variable, slope in zip(affine.linear_vars, affine.linear_coefs, strict=True):
                slopes[self.column(variable)] = slopes.get(self.column(variable), 0.0) + float(slope)
            return slopes
        variables = list(identify_variables(expression, include_fixed=False))
        try:
            slopes_list = differentiate(expression, wrt_list=variables, mode=Modes.reverse_numeric)
        except (ArithmeticError, ValueError, OverflowError):
            slopes_list = [math.nan] * len(variables)
        return {self.column(variable): float(slope) for variable, slope in zip(variables, slopes_list, strict=True)}


def number_of(expression: Any) -> float:
    """Pyomo's value of an expression; NaN where it has none."""
    try:
        number = pyo.value(expression, exception=False)
    except (ArithmeticError, ValueError, OverflowError):
        return math.nan
    return math.nan if number is None or isinstance(number, complex) else float(number)


def read_local(model: Any, near: float) -> LocalModel:
    """All active components at their current values. near: a box within this of a bound is a pair with that bound."""
    reader = _Reader()
    rows: list[Row] = []
    slopes: list[dict[int, float]] = []

    def add_row(source: Any, body: Any, lower: Any, upper: Any, argument: int | None = None) -> None:
        low = -math.inf if lower is None else number_of(lower)
        high = math.inf if upper is None else number_of(upper)
        rows.append(Row(source=source, value=number_of(body), lower=low, upper=high, argument=argument))
        slopes.append(reader.gradient(body))

    for constraint in model.component_data_objects(pyo.Constraint, active=True, descend_into=pyo.Block):
        lower, body, upper = constraint.to_bounded_expression(evaluate_bounds=True)
        add_row(constraint, body, lower, upper)
    pairs: list[Pair] = []
    first: list[dict[int, float]] = []
    second: list[dict[int, float]] = []
    for condition in model.component_data_objects(Complementarity, active=True, descend_into=pyo.Block):
        sides = [_bounded(condition, argument) for argument in condition._args]
        local = _local_pair(condition, sides, near)
        if local is None:  # an equality among its sides, or a box inside whose bounds the other side is 0
            for argument, (lower, body, upper) in _imposed(sides):
                add_row(condition, body, lower, upper, argument)
            continue
        pair, expressions = local
        pairs.append(pair)
        for store, expression, flip in zip((first, second), expressions, (pair.first_flip, pair.second_flip), strict=True):
            store.append({column: flip * slope for column, slope in reader.gradient(expression).items()})
    objective, gradient = 0.0, {}
    for item in model.component_data_objects(pyo.Objective, active=True, descend_into=pyo.Block):
        sign = 1.0 if item.sense == pyo.minimize else -1.0
        objective, gradient = sign * number_of(item.expr), {c: sign * s for c, s in reader.gradient(item.expr).items()}
    n = len(reader.variables)
    bounds = []
    for variable in reader.variables:
        low, high = variable.bounds
        bounds.append(
            Row(
                source=variable,
                value=number_of(variable),
                lower=-math.inf if low is None else float(low),
                upper=math.inf if high is None else float(high),
            )
        )
    dense = np.zeros(n)
    for column, slope in gradient.items():
        dense[column] = slope
    return LocalModel(
        variables=tuple(reader.variables), objective=objective, gradient=dense, rows=tuple(rows), jacobian=_matrix(slopes, n),
        bounds=tuple(bounds), pairs=tuple(pairs), first_jacobian=_matrix(first, n), second_jacobian=_matrix(second, n),
    )  # fmt: skip


def _bounded(condition: Any, argument: Any) -> tuple[Any, Any, Any]:
    """(lower, body, upper) of an argument, by Pyomo's own reading of it."""
    form = condition._canonical_expression(argument)
    lower, body, upper = (form[0], form[1], form[0]) if len(form) == 2 else form
    low, high = (None if bound is None else number_of(bound) for bound in (lower, upper))
    return (None if low == -math.inf else low), body, (None if high == math.inf else high)


def _local_pair(condition: Any, sides: list[tuple[Any, Any, Any]], near: float) -> tuple[Pair, tuple[Any, Any]] | None:
    """The condition near this point as a pair of expressions, None where nothing is complementary."""
    counts = [(lower is not None) + (upper is not None) for lower, _, upper in sides]
    if counts == [1, 1]:
        (a, a_flip, a_body), (b, b_flip, b_body) = (_distance(*side) for side in sides)
        return Pair(source=condition, first=a, second=b, first_flip=a_flip, second_flip=b_flip, arguments=(0, 1)), (a_body, b_body)
    if sorted(counts) != [0, 2]:
        return None
    arguments = (0, 1) if counts == [2, 0] else (1, 0)
    (lower, body, upper), (_, free, _) = (sides[k] for k in arguments)
    if lower == upper:
        return None
    value, other = number_of(body), number_of(free)
    to_low, to_high = value - lower, upper - value
    if min(to_low, to_high) > near and abs(other) <= near:
        return None
    if to_low <= near or (to_high > near and other > 0):
        return Pair(source=condition, first=to_low, second=other, first_flip=1.0, second_flip=1.0, arguments=arguments), (body, free)
    return Pair(source=condition, first=to_high, second=-other, first_flip=-1.0, second_flip=-1.0, arguments=arguments), (body, free)


def _distance(lower: Any, body: Any, upper: Any) -> tuple[float, float, Any]:
    value = number_of(body)
    return (value - lower, 1.0, body) if upper is None else (upper - value, -1.0, body)


def _imposed(sides: list[tuple[Any, Any, Any]]) -> list[tuple[int, tuple[Any, Any, Any]]]:
    """(number of the argument, relation) for what must hold where there is no choice; inside a box the free side is 0."""
    counts = [(lower is not None) + (upper is not None) for lower, _, upper in sides]
    fixed = any(count == 2 and lower == upper for count, (lower, _, upper) in zip(counts, sides, strict=True))
    if sorted(counts) == [0, 2] and not fixed:
        return [(k, side if counts[k] else (0.0, side[1], 0.0)) for k, side in enumerate(sides)]
    return [(k, side) for k, side in enumerate(sides) if counts[k]]


def _matrix(slopes: list[dict[int, float]], n: int) -> sparse.csr_matrix:
    counts = [len(row) for row in slopes]
    columns = [column for row in slopes for column in row]
    values = [slope for row in slopes for slope in row.values()]
    return sparse.csr_matrix((values, (np.repeat(np.arange(len(slopes)), counts), columns)), shape=(len(slopes), n))

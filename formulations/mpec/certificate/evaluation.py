"""The model at its current values, to first order: values by `pyomo.value`; gradients of repeated shapes together, checked against Pyomo's own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyomo.environ as pyo
import scipy.sparse as sparse
from pyomo.mpec import Complementarity

from formulations.ipopt.errors import MissingValueError
from formulations.mpec.certificate.gradients import empty_expression, gradients_of


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
    notes: tuple[str, ...] = ()


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


def number_of(expression: Any) -> float:
    """Pyomo's value of an expression; NaN where it has none."""
    try:
        number = pyo.value(expression, exception=False)
    except (ArithmeticError, ValueError, OverflowError):
        return math.nan
    return math.nan if number is None or isinstance(number, complex) else float(number)


def _filled(source: Any, expression: Any, number: float) -> float:
    """The number. Raises MissingValueError where there is none because the expression holds one without content."""
    name = empty_expression(expression) if math.isnan(number) else None
    if name is not None:
        raise MissingValueError(
            f"'{source.name}' needs the Expression '{name}', which is empty: give it a value, or deactivate '{source.name}'"
        )
    return number


def read_local(model: Any, near: float) -> LocalModel:
    """All active components at their current values. near: a box within this of a bound is a pair with that bound.

    Raises MissingValueError where one of them needs an Expression that is empty.
    """
    rows: list[Row] = []
    bodies: list[Any] = []

    def add_row(source: Any, body: Any, lower: Any, upper: Any, argument: int | None = None) -> None:
        low = -math.inf if lower is None else number_of(lower)
        high = math.inf if upper is None else number_of(upper)
        rows.append(Row(source=source, value=_filled(source, body, number_of(body)), lower=low, upper=high, argument=argument))
        bodies.append(body)

    for constraint in model.component_data_objects(pyo.Constraint, active=True, descend_into=pyo.Block):
        lower, body, upper = constraint.to_bounded_expression(evaluate_bounds=True)
        add_row(constraint, body, lower, upper)
    pairs: list[Pair] = []
    sides: list[tuple[Any, Any]] = []
    side_values: list[tuple[float, float]] = []
    for condition in model.component_data_objects(Complementarity, active=True, descend_into=pyo.Block):
        bounded = [_bounded(condition, argument) for argument in condition._args]
        local = _local_pair(condition, bounded, near)
        if local is None:  # an equality among its sides, or a box inside whose bounds the other side is 0
            for argument, (lower, body, upper) in _imposed(bounded):
                add_row(condition, body, lower, upper, argument)
            continue
        pair, expressions, numbers = local
        for expression, number in zip(expressions, numbers, strict=True):
            _filled(condition, expression, number)
        pairs.append(pair)
        sides.append(expressions)
        side_values.append(numbers)
    sense, goal, objective = 1.0, 0.0, 0.0
    for item in model.component_data_objects(pyo.Objective, active=True, descend_into=pyo.Block):
        sense, goal = (1.0 if item.sense == pyo.minimize else -1.0), item.expr
        objective = _filled(item, goal, number_of(goal))
    (first, second), (first_values, second_values) = (tuple(zip(*items, strict=True)) or ((), ()) for items in (sides, side_values))
    found = gradients_of([*bodies, *first, *second, goal], [*(row.value for row in rows), *first_values, *second_values, objective])
    m, k = len(rows), len(pairs)
    flips = [sparse.diags([getattr(pair, name) for pair in pairs], shape=(k, k)) for name in ("first_flip", "second_flip")]
    return LocalModel(
        variables=found.variables,
        objective=sense * objective,
        gradient=sense * found.matrix[m + 2 * k].toarray().ravel(),
        rows=tuple(rows),
        jacobian=found.matrix[:m],
        bounds=tuple(_bounds_of(variable) for variable in found.variables),
        pairs=tuple(pairs),
        first_jacobian=(flips[0] @ found.matrix[m : m + k]).tocsr(),
        second_jacobian=(flips[1] @ found.matrix[m + k : m + 2 * k]).tocsr(),
        notes=found.notes,
    )


def _bounds_of(variable: Any) -> Row:
    low, high = variable.bounds
    return Row(
        source=variable,
        value=number_of(variable),
        lower=-math.inf if low is None else float(low),
        upper=math.inf if high is None else float(high),
    )


def _bounded(condition: Any, argument: Any) -> tuple[Any, Any, Any]:
    """(lower, body, upper) of an argument, by Pyomo's own reading of it."""
    form = condition._canonical_expression(argument)
    lower, body, upper = (form[0], form[1], form[0]) if len(form) == 2 else form
    low, high = (None if bound is None else number_of(bound) for bound in (lower, upper))
    return (None if low == -math.inf else low), body, (None if high == math.inf else high)


def _local_pair(condition: Any, sides: list[tuple[Any, Any, Any]], near: float) -> tuple[Pair, tuple[Any, Any], tuple[float, float]] | None:
    """The condition near this point as a pair, its two expressions and their values; None where nothing is complementary."""
    counts = [(lower is not None) + (upper is not None) for lower, _, upper in sides]
    if counts == [1, 1]:
        (a, a_flip, a_body, a_value), (b, b_flip, b_body, b_value) = (_distance(*side) for side in sides)
        pair = Pair(source=condition, first=a, second=b, first_flip=a_flip, second_flip=b_flip, arguments=(0, 1))
        return pair, (a_body, b_body), (a_value, b_value)
    if sorted(counts) != [0, 2]:
        return None
    arguments = (0, 1) if counts == [2, 0] else (1, 0)
    (lower, body, upper), (_, free, _) = (sides[k] for k in arguments)
    if lower >= upper:  # equal: an equality; above: a range that holds no number, which is a row nothing can meet
        return None
    value, other = number_of(body), number_of(free)
    to_low, to_high = value - lower, upper - value
    if min(to_low, to_high) > near and abs(other) <= near:
        return None
    low = to_low <= near or (to_high > near and other > 0)
    flip, distance = (1.0, to_low) if low else (-1.0, to_high)
    pair = Pair(source=condition, first=distance, second=flip * other, first_flip=flip, second_flip=flip, arguments=arguments)
    return pair, (body, free), (value, other)


def _distance(lower: Any, body: Any, upper: Any) -> tuple[float, float, Any, float]:
    value = number_of(body)
    return (value - lower, 1.0, body, value) if upper is None else (upper - value, -1.0, body, value)


def _imposed(sides: list[tuple[Any, Any, Any]]) -> list[tuple[int, tuple[Any, Any, Any]]]:
    """(number of the argument, relation) for what must hold where there is no choice; inside a box the free side is 0."""
    counts = [(lower is not None) + (upper is not None) for lower, _, upper in sides]
    fixed = any(count == 2 and lower == upper for count, (lower, _, upper) in zip(counts, sides, strict=True))
    if sorted(counts) == [0, 2] and not fixed:
        return [(k, side if counts[k] else (0.0, side[1], 0.0)) for k, side in enumerate(sides)]
    return [(k, side) for k, side in enumerate(sides) if counts[k]]

"""Reading the model again: data, bounds, and whether the structure is still the one that was compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from pyomo.core.expr import value

from formulations.ipopt.components import active_constraints, active_objective, sense_of
from formulations.ipopt.errors import MissingValueError, StructureChangedError
from formulations.ipopt.evaluated import EvaluatedExpression
from formulations.ipopt.layout import Layout


def check_structure(layout: Layout) -> None:
    """Raise StructureChangedError, naming the first difference."""
    again = "compile the model again"
    constraints = active_constraints(layout.model)
    if len(constraints) != len(layout.constraints):
        raise StructureChangedError(f"{len(constraints)} constraints are active, {len(layout.constraints)} were compiled: {again}")
    for now, then, expression in zip(constraints, layout.constraints, layout.expressions, strict=True):
        if now is not then:
            raise StructureChangedError(f"constraint '{now.name}' is active where '{then.name}' was compiled: {again}")
        if now.expr is not expression:
            raise StructureChangedError(f"constraint '{now.name}' has another expression than the compiled one: {again}")
    objective = active_objective(layout.model)
    if objective is not layout.objective or sense_of(objective) != layout.sense:
        raise StructureChangedError(f"another objective (or sense) is active than the compiled one: {again}")
    for named, inside in layout.named:
        if named.args[0] is not inside:
            raise StructureChangedError(f"expression '{named.name}' has another content than the compiled one: {again}")
    for variable in layout.variables:
        if variable.fixed:
            raise StructureChangedError(f"variable '{variable.name}' is fixed now: {again}")
    for source in layout.data:
        if source.__class__ is not EvaluatedExpression and source.is_variable_type() and not source.fixed:
            raise StructureChangedError(f"variable '{source.name}' was fixed and is free now: {again}")


def read_data(sources: tuple[Any, ...]) -> np.ndarray:
    """(number of data,) current numbers."""
    try:
        numbers = np.array([s.value for s in sources], dtype=float)
    except (TypeError, ValueError, ArithmeticError):
        numbers = np.array([_read_one(s) for s in sources], dtype=float)
    for k in np.flatnonzero(np.isnan(numbers)):
        raise MissingValueError(f"'{sources[k].name}' has no value (or not a number), and the model needs one")
    return numbers


def _read_one(source: Any) -> float:
    try:
        return float(source.value)
    except (TypeError, ValueError, ArithmeticError) as error:
        raise MissingValueError(f"'{source.name}' has no value, and the model needs one ({' '.join(str(error).split())})") from error


def read_bounds(variables: tuple[Any, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(lower (n,), upper (n,)), infinite where there is none."""
    pairs = [v.bounds for v in variables]
    lower = np.array([-np.inf if low is None else low for low, _ in pairs], dtype=float)
    upper = np.array([np.inf if high is None else high for _, high in pairs], dtype=float)
    return lower, upper


def read_constraint_bounds(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    known: dict[int, float] = {}
    sides = []
    for (numbers, later), unbounded in ((layout.lower, -np.inf), (layout.upper, np.inf)):
        side = numbers.copy()
        for row, expression in later:
            number = known.get(id(expression))
            if number is None:
                number = known[id(expression)] = _bound(expression, layout.constraints[row], unbounded)
            side[row] = number
        for row in np.flatnonzero(np.isnan(side) | (side == -unbounded)):
            raise MissingValueError(f"constraint '{layout.constraints[row].name}' has the bound {side[row]}")
        sides.append(side)
    return sides[0], sides[1]


def _bound(expression: Any, constraint: Any, unbounded: float) -> float:
    try:
        number = value(expression, exception=True)
    except (TypeError, ValueError, ArithmeticError) as error:
        raise MissingValueError(f"a bound of constraint '{constraint.name}' has no value ({' '.join(str(error).split())})") from error
    return unbounded if number is None else float(number)

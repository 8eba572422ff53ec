"""Pyomo model -> IpoptProblem: every active equation read once, terms of one shape gathered, sparsity settled."""

from __future__ import annotations

from typing import Any

import numpy as np
from pyomo.common.gc_manager import PauseGC
from pyomo.common.numeric_types import native_numeric_types

from formulations.ipopt.model import Layout, active_constraints, active_objective, refuse_unknown_components, sense_of, sides_of
from formulations.ipopt.problem import IpoptProblem
from formulations.ipopt.read import TermReader
from formulations.ipopt.shapes import TermGroup, shape_of


def compile_model(model: Any) -> IpoptProblem:
    """Translate a smooth Pyomo model; the model itself is not changed.

    Variables come in order of first appearance, constraints in order of declaration; constraints without any variable are checked by
    `IpoptProblem.trivial_violation`, not sent to Ipopt.

    Raises
    ------
    ModelRefusedError
        for what Ipopt cannot treat (integer variables, untransformed Complementarity, abs of a variable, ..)
    MissingValueError
        where a Param or a fixed variable has no value
    """
    with PauseGC():
        refuse_unknown_components(model)
        constraints = active_constraints(model)
        objective = active_objective(model)
        reader = TermReader()
        reader.constants = [0.0] * (len(constraints) + 1)
        lower: list[Any] = []
        upper: list[Any] = []
        expressions: list[Any] = []
        for row, constraint in enumerate(constraints):
            body, subtracted, low, high = sides_of(constraint)
            reader.read(row, body, 1.0, constraint)
            if subtracted is not None:
                reader.read(row, subtracted, -1.0, constraint)
            lower.append(low)
            upper.append(high)
            expressions.append(constraint.expr)
        sense = sense_of(objective)
        if objective is not None:
            reader.read(len(constraints), objective, float(sense), objective)
        groups = [TermGroup(shape_of(signature), bucket) for signature, bucket in reader.buckets.items()]
        layout = Layout(
            model=model,
            constraints=tuple(constraints),
            expressions=tuple(expressions),
            objective=objective,
            sense=sense,
            lower=_bounds(lower, -np.inf),
            upper=_bounds(upper, np.inf),
            variables=tuple(reader.variables),
            data=tuple(reader.data),
            named=tuple(reader.named.values()),
        )
        return IpoptProblem(
            layout,
            groups,
            constants=np.array(reader.constants, dtype=float),
            triplets=(np.array(reader.rows, dtype=np.intp), np.array(reader.columns, dtype=np.intp), np.array(reader.slopes, dtype=float)),
        )


def _bounds(given: list[Any], unbounded: float) -> tuple[np.ndarray, tuple[tuple[int, Any], ...]]:
    """(numbers, ((row, expression), ..)): what never changes, and what a refresh evaluates."""
    numbers = np.full(len(given), unbounded)
    later = []
    for row, bound in enumerate(given):
        if bound is None:
            continue
        if bound.__class__ in native_numeric_types:
            numbers[row] = bound
        else:
            later.append((row, bound))
    return numbers, tuple(later)

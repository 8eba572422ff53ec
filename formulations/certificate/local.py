"""A Pyomo model at its current values, to first order.

    local = read_local(model, 1e-6)
    local.rows.value, local.gradient, local.sides

Values come from `pyomo.value`, derivatives from `formulations.ipopt`. Each derivative is checked
against a difference of Pyomo's values in a random direction.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyomo.environ as pyo
import scipy.sparse as sparse
from pyomo.core.expr.calculus.derivatives import Modes, differentiate
from pyomo.core.expr.calculus.diff_with_pyomo import DifferentiationException
from pyomo.core.expr.numvalue import is_potentially_variable
from pyomo.core.expr.visitor import evaluate_fixed_subexpressions, identify_variables
from pyomo.mpec import Complementarity

from formulations.ipopt.model import (
    MissingValueError,
    ModelRefusedError,
    NotSmoothError,
    bounds_of,
    unbounded_if_huge,
)
from formulations.ipopt.problem import compile_model

# Step of the differences relative to max(1, |x|): about the square root of the machine precision.
_STEP = 1e-8
# Derivatives agree within this, relative to the largest possible in the direction.
_AGREE = 1e-6
# Relative rounding of a value.
_ROUNDING = 1e-14


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """lower <= value <= upper, each (rows,).

    sources: constraints, arguments of complementarities without a choice, variables
    arguments: number of the argument of `complements`, or None
    """

    sources: tuple[Any, ...]
    arguments: tuple[int | None, ...]
    value: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Return the larger finite |bound| of each row (rows,), at least 1 [row units].

        Raises nothing.
        """
        bounds = np.abs([self.lower, self.upper])
        return np.maximum(1.0, np.max(np.where(np.isfinite(bounds), bounds, 0.0), axis=0))

    def violation(self, value: np.ndarray) -> np.ndarray:
        """Return how far these values (rows,) exceed their bounds [row units]. Raises nothing."""
        with np.errstate(invalid="ignore"):
            return np.maximum(np.maximum(self.lower - value, value - self.upper), 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """Two complementary sides 0 <= first, 0 <= second.

    A flip is -1 if the side is the negative of the user's expression (upper bound).
    arguments: number of the argument of `complements` of each side
    """

    source: Any
    first: float
    second: float
    first_flip: float
    second_flip: float
    arguments: tuple[int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalModel:
    """The model to first order at a point.

    - goal: the objective's component, or None
    - objective: in the model's own sense
    - gradient: (n,) of the minimised objective
    - scale: largest derivative of the objective, at the point or nearby
    - rows: those with jacobian (m, n), then the variables within their bounds
    - first_jacobian, second_jacobian: (pairs, n), gradients of the pairs in the signs of `Pair`
    """

    variables: tuple[Any, ...]
    objective: float
    gradient: np.ndarray
    rows: Rows
    jacobian: sparse.csr_matrix
    pairs: tuple[Pair, ...]
    first_jacobian: sparse.csr_matrix
    second_jacobian: sparse.csr_matrix
    notes: tuple[str, ...] = ()
    scale: float = 1.0
    goal: Any = None

    @property
    def sides(self) -> np.ndarray:
        """Return the first and the second sides (2, pairs) [side units]. Raises nothing."""
        return np.array(
            [[pair.first for pair in self.pairs], [pair.second for pair in self.pairs]], dtype=float
        )

    @property
    def matrix(self) -> sparse.csr_matrix:
        """Return the gradients of all rows (m + n, n) [row per variable]."""
        return sparse.vstack(
            [self.jacobian, sparse.identity(len(self.variables), format="csr")], format="csr"
        )


@contextmanager
def values_set(variables: Iterable[Any], numbers: Iterable[float]) -> Iterator[None]:
    """Set variables within the context; then restore values and staleness."""
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
    """Return Pyomo's value of an expression, NaN without a value."""
    try:
        number = pyo.value(expression, exception=False)
    except (ArithmeticError, ValueError, OverflowError):
        return math.nan
    return math.nan if number is None or isinstance(number, complex) else float(number)


def _filled(source: Any, expression: Any, number: float) -> float:
    hole = _empty_expression(expression) if math.isnan(number) else None
    if hole is not None:
        raise MissingValueError(
            f"'{source.name}' needs the Expression '{hole}', which is empty: give it a value, or deactivate '{source.name}'"
        )
    return number


def _empty_expression(expression: Any) -> str | None:
    stack = [expression]
    while stack:
        node = stack.pop()
        if hasattr(node, "is_expression_type") and node.is_expression_type():
            if node.is_named_expression_type() and node.expr is None:
                return node.name
            stack.extend(node.args)
    return None


@dataclass(frozen=True, kw_only=True, eq=False)
class Derivatives:
    """First derivatives of expressions by the n variables.

    gradient: (n,) of the minimised objective
    scale: size of the gradient, at the point or nearby
    jacobian: (expressions, n)
    """

    variables: tuple[Any, ...]
    gradient: np.ndarray
    scale: float
    jacobian: sparse.csr_matrix
    notes: tuple[str, ...] = ()


def derivatives_of(
    valued: Sequence[tuple[Any, float]], objective: tuple[Any, float], sense: Any = pyo.minimize
) -> Derivatives:
    """Return the derivatives of Pyomo expressions and of an objective at the variables' values.

    They are NaN if they contradict Pyomo's values. `valued` and `objective` are expressions with
    their values. Raises ModelRefusedError or MissingValueError with the number of the expression.
    """
    bodies, goal = [body for body, _ in valued], objective[0]
    scratch = pyo.ConcreteModel()
    variable_rows = [k for k, body in enumerate(bodies) if is_potentially_variable(body)]
    scratch.expression = pyo.Constraint(variable_rows, rule=lambda _, k: (None, bodies[k], 0.0))
    scratch.goal = pyo.Objective(expr=goal, sense=sense)
    problem = compile_model(scratch)
    x = np.array([math.nan if v.value is None else v.value for v in problem.variables], dtype=float)
    gradient, entries = problem.derivatives(x)
    row, column = problem.jacobianstructure()
    number = np.array([equation.index() for equation in problem.equations], dtype=int)
    jacobian = sparse.csr_matrix(
        (entries, (number[row], column)), shape=(len(bodies), len(problem.variables))
    )
    both = sparse.vstack([jacobian, problem.sense * gradient], format="csr")
    wrong = _contradicted([*valued, objective], problem.variables, x, both)
    if wrong:
        note = f"Pyomo's values contradict the derivatives of {wrong} expressions: please report this model"
        return _unknown([*bodies, goal], note)
    scale = max(problem.slope_size_nearby(x), problem.slope_size(x))
    return Derivatives(
        variables=problem.variables, gradient=gradient, scale=scale, jacobian=jacobian
    )


def _unknown(expressions: Sequence[Any], note: str) -> Derivatives:
    variables = {
        id(variable): variable
        for expression in expressions
        if is_potentially_variable(expression)
        for variable in identify_variables(expression, include_fixed=False)
    }
    n = len(variables)
    return Derivatives(
        variables=tuple(variables.values()),
        gradient=np.full(n, math.nan),
        scale=1.0,
        jacobian=sparse.csr_matrix((len(expressions) - 1, n)),
        notes=(note,),
    )


def _contradicted(
    valued: Sequence[tuple[Any, float]],
    variables: Sequence[Any],
    x: np.ndarray,
    jacobian: sparse.csr_matrix,
) -> int:
    """Return how many expressions contradict Pyomo's values along a random direction.

    NaN contradicts nothing. If curvature or rounding spoil a difference, Pyomo's derivatives
    decide.
    """
    expressions, values = zip(*valued, strict=True)
    random = np.random.default_rng(0)
    direction = random.choice([-1.0, 1.0], len(x)) * random.uniform(0.5, 1.0, len(x))
    direction *= np.maximum(1.0, np.abs(x))
    with values_set(variables, (x + _STEP * direction).tolist()):
        ahead = np.array([number_of(expression) for expression in expressions])
    slope, size = jacobian @ direction, abs(jacobian) @ np.abs(direction)
    limit = _AGREE * (1.0 + size) + _ROUNDING * np.abs(ahead) / _STEP
    differs = np.flatnonzero(np.abs((ahead - np.array(values)) / _STEP - slope) > limit)
    return sum(not _is_pyomos(expressions[k], variables, jacobian[k]) for k in differs.tolist())


def _is_pyomos(expression: Any, variables: Sequence[Any], slopes: sparse.csr_matrix) -> bool:
    free = list(identify_variables(expression, include_fixed=False))
    try:
        # Pyomo would differentiate by a Param that is an exponent, too.
        numeric = evaluate_fixed_subexpressions(expression)
        derivatives = differentiate(numeric, wrt_list=free, mode=Modes.reverse_numeric)
    except (DifferentiationException, ArithmeticError, ValueError):
        return False
    slope_of = {
        id(variables[k]): slope for k, slope in zip(slopes.indices, slopes.data, strict=True)
    }
    pyomos = {id(variable): slope for variable, slope in zip(free, derivatives, strict=True)}
    limit = _AGREE * max(1.0, float(np.max(np.abs(slopes.data), initial=0.0)))
    return all(
        abs(slope_of.get(key, 0.0) - pyomos.get(key, 0.0)) <= limit
        for key in slope_of.keys() | pyomos.keys()
    )


def read_local(model: Any, near: float) -> LocalModel:
    """Read all active components at their current values.

    near: largest distance at which a box is a pair with its bound
    Raises MissingValueError for an empty Expression, NotSmoothError for abs, min or max of
    variables.
    """
    rows: list[tuple[Any, int | None, float, float, float]] = []
    bodies: list[Any] = []

    def add_row(
        source: Any, body: Any, lower: Any, upper: Any, argument: int | None = None
    ) -> None:
        low = -math.inf if lower is None else unbounded_if_huge(number_of(lower))
        high = math.inf if upper is None else unbounded_if_huge(number_of(upper))
        rows.append((source, argument, _filled(source, body, number_of(body)), low, high))
        bodies.append(body)

    for constraint in model.component_data_objects(
        pyo.Constraint, active=True, descend_into=pyo.Block
    ):
        lower, body, upper = constraint.to_bounded_expression(evaluate_bounds=True)
        add_row(constraint, body, lower, upper)
    pairs: list[Pair] = []
    sides: list[tuple[tuple[Any, float], tuple[Any, float]]] = []
    for condition in model.component_data_objects(
        Complementarity, active=True, descend_into=pyo.Block
    ):
        bounded = [_bounded(condition, argument) for argument in condition._args]
        local = _local_pair(condition, bounded, near)
        if (
            local is None
        ):  # an equality among its sides, or a box inside whose bounds the other side is 0
            for argument, (lower, body, upper) in _imposed(bounded):
                add_row(condition, body, lower, upper, argument)
            continue
        pair, valued = local
        for expression, number in valued:
            _filled(condition, expression, number)
        pairs.append(pair)
        sides.append(valued)
    goal, sense, objective, minimised = 0.0, pyo.minimize, 0.0, None
    for item in model.component_data_objects(pyo.Objective, active=True, descend_into=pyo.Block):
        goal, sense, minimised = item.expr, item.sense, item
        objective = _filled(item, goal, number_of(goal))
    m, k = len(rows), len(pairs)
    valued = [*zip(bodies, [value for _, _, value, _, _ in rows], strict=True)]
    valued += [first for first, _ in sides] + [second for _, second in sides]
    try:
        derivatives = derivatives_of(valued, (goal, objective), sense)
    except NotSmoothError:
        raise
    except (ModelRefusedError, MissingValueError) as error:
        sources = [*(source for source, *_ in rows), *(pair.source for pair in [*pairs, *pairs])]
        why = re.sub(
            r"expression\[(\d+)\]", lambda number: sources[int(number[1])].name, str(error)
        )
        derivatives = _unknown([*(body for body, _ in valued), goal], f"no derivatives: {why}")
    rows += [
        (variable, None, number_of(variable), *bounds_of(variable))
        for variable in derivatives.variables
    ]
    sources, arguments, values, lower, upper = tuple(zip(*rows, strict=True)) or ((),) * 5
    flips = [
        sparse.diags([getattr(pair, name) for pair in pairs], shape=(k, k))
        for name in ("first_flip", "second_flip")
    ]
    return LocalModel(
        variables=derivatives.variables,
        goal=minimised,
        objective=objective,
        gradient=derivatives.gradient,
        scale=derivatives.scale,
        rows=Rows(
            sources=sources,
            arguments=arguments,
            value=np.array(values),
            lower=np.array(lower),
            upper=np.array(upper),
        ),
        jacobian=derivatives.jacobian[:m],
        pairs=tuple(pairs),
        first_jacobian=(flips[0] @ derivatives.jacobian[m : m + k]).tocsr(),
        second_jacobian=(flips[1] @ derivatives.jacobian[m + k :]).tocsr(),
        notes=derivatives.notes,
    )


def _bounded(condition: Any, argument: Any) -> tuple[Any, Any, Any]:
    form = condition._canonical_expression(argument)
    lower, body, upper = (form[0], form[1], form[0]) if len(form) == 2 else form
    low, high = (
        None if bound is None else unbounded_if_huge(number_of(bound)) for bound in (lower, upper)
    )
    return (None if low == -math.inf else low), body, (None if high == math.inf else high)


def _local_pair(
    condition: Any, sides: list[tuple[Any, Any, Any]], near: float
) -> tuple[Pair, tuple[tuple[Any, float], tuple[Any, float]]] | None:
    """Return the condition at this point as a pair, its expressions and values.

    None without a pair.
    """
    counts = [(lower is not None) + (upper is not None) for lower, _, upper in sides]
    if counts == [1, 1]:
        (a, a_flip, a_value), (b, b_flip, b_value) = (_distance(*side) for side in sides)
        pair = Pair(
            source=condition,
            first=a,
            second=b,
            first_flip=a_flip,
            second_flip=b_flip,
            arguments=(0, 1),
        )
        return pair, ((sides[0][1], a_value), (sides[1][1], b_value))
    if sorted(counts) != [0, 2]:
        return None
    arguments = (0, 1) if counts == [2, 0] else (1, 0)
    (lower, body, upper), (_, free, _) = (sides[k] for k in arguments)
    # Equal bounds are an equality; crossing bounds are a row that nothing satisfies.
    if lower >= upper:
        return None
    value, other = number_of(body), number_of(free)
    to_low, to_high = value - lower, upper - value
    if min(to_low, to_high) > near and abs(other) <= near:
        return None
    low = to_low <= near or (to_high > near and other > 0)
    flip, distance = (1.0, to_low) if low else (-1.0, to_high)
    pair = Pair(
        source=condition,
        first=distance,
        second=flip * other,
        first_flip=flip,
        second_flip=flip,
        arguments=arguments,
    )
    return pair, ((body, value), (free, other))


def _distance(lower: Any, body: Any, upper: Any) -> tuple[float, float, float]:
    value = number_of(body)
    return (value - lower, 1.0, value) if upper is None else (upper - value, -1.0, value)


def _imposed(sides: list[tuple[Any, Any, Any]]) -> list[tuple[int, tuple[Any, Any, Any]]]:
    """Return (number of the argument, relation) of the relations without a choice.

    Inside a box the free side is 0.
    """
    counts = [(lower is not None) + (upper is not None) for lower, _, upper in sides]
    fixed = any(
        count == 2 and lower == upper
        for count, (lower, _, upper) in zip(counts, sides, strict=True)
    )
    if sorted(counts) == [0, 2] and not fixed:
        return [(k, side if counts[k] else (0.0, side[1], 0.0)) for k, side in enumerate(sides)]
    return [(k, side) for k, side in enumerate(sides) if counts[k]]

"""A model at its current values, to first order: values by `pyomo.value`.

Gradients of repeated shapes together, checked against Pyomo's own.

A scene's model has thousands of rows and a few dozen shapes. The terms are read by the compiler of
`formulations.ipopt`; what it does not know, what is rare and what is not finite here is
differentiated by Pyomo, expression by expression. Of each shape some expressions are differentiated
by Pyomo as well, and all values are compared with Pyomo's: if any of that disagrees, Pyomo's
derivatives are taken throughout.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyomo.environ as pyo
import scipy.sparse as sparse
from pyomo.core.expr.calculus.derivatives import Modes, differentiate
from pyomo.core.expr.calculus.diff_with_pyomo import DifferentiationException
from pyomo.core.expr.numeric_expr import UnaryFunctionExpression
from pyomo.core.expr.numvalue import is_potentially_variable, value
from pyomo.core.expr.visitor import evaluate_fixed_subexpressions, identify_variables
from pyomo.mpec import Complementarity
from pyomo.repn import generate_standard_repn

from formulations.ipopt.graph import UNARY
from formulations.ipopt.model import MissingValueError, bounds_of, read_number, unbounded_if_huge
from formulations.ipopt.read import TermReader
from formulations.ipopt.shapes import TermGroup, shape_of

# A shape met less often is not worth compiling.
_OFTEN = 8
# Relative to the terms of a value, or the largest derivative of a row: two ways to the same number
# differ by rounding only.
_ROUNDING = 1e-9
_DISAGREE = "the derivatives that were evaluated together disagree with Pyomo's own, which were taken instead: please report this model"
_UNKNOWN = "Pyomo has no derivatives to compare those with that were evaluated together; its own were taken throughout"
_REFUSED = (
    ValueError,
    ArithmeticError,
    TypeError,
)  # of an expression that the compiler does not treat
_NOWHERE = SimpleNamespace(name="an expression")


@dataclass(frozen=True, kw_only=True, eq=False)
class Gradients:
    """matrix (expressions, n): derivatives by the n variables, NaN where there is none.

    notes: what the reader of a certificate should know.
    """

    variables: tuple[Any, ...]
    matrix: sparse.csr_matrix
    notes: tuple[str, ...] = ()


def gradients_of(expressions: Sequence[Any], values: Sequence[float]) -> Gradients:
    """Derivatives of Pyomo expressions by their free variables, at the variables' current values.

    Parameters
    ----------
    expressions : Pyomo expressions
    values : of the expressions, by Pyomo
    """
    together = _Together(expressions)
    own = together.refused
    triplets = together.triplets()
    own |= ~np.isfinite(together.values)
    own[triplets[0][~np.isfinite(triplets[2])]] = True
    if not together.agrees_with(np.array(values, dtype=float), triplets, expressions, own):
        note = _DISAGREE if together.compared else _UNKNOWN
        return _assembled(_Columns(()), expressions, range(len(expressions)), _NO_TRIPLETS, (note,))
    kept = ~own[triplets[0]]
    rows, columns, slopes = (part[kept] for part in triplets)
    return _assembled(
        _Columns(together.variables),
        expressions,
        np.flatnonzero(own).tolist(),
        (rows, columns, slopes),
        (),
    )


def pyomo_gradient(expression: Any) -> list[tuple[Any, float]]:
    """(variable, derivative) of every free variable by Pyomo's own differentiation.

    NaN where it cannot evaluate one.
    """
    if not is_potentially_variable(expression):
        return []
    affine = generate_standard_repn(expression, compute_values=True, quadratic=False)
    if affine.is_linear():
        return [
            (variable, float(slope))
            for variable, slope in zip(affine.linear_vars, affine.linear_coefs, strict=True)
        ]
    variables = list(identify_variables(expression, include_fixed=False))
    try:
        # data as numbers: Pyomo would differentiate by a Param that is an exponent too, for which a
        # negative base has no logarithm
        numeric = evaluate_fixed_subexpressions(expression)
        slopes = differentiate(numeric, wrt_list=variables, mode=Modes.reverse_numeric)
    except DifferentiationException:
        slopes = _symbolic(expression, variables)
    except (ArithmeticError, ValueError):
        slopes = [math.nan] * len(variables)
    return [
        (variable, math.nan if isinstance(slope, complex) else float(slope))
        for variable, slope in zip(variables, slopes, strict=True)
    ]


def _symbolic(expression: Any, variables: Sequence[Any]) -> Sequence[float]:
    """By Pyomo's way over SymPy, which knows more functions.

    NaN where one of them is not smooth.
    """
    nothing = [math.nan] * len(variables)
    functions = {
        node.getname() for node in _nodes(expression) if isinstance(node, UnaryFunctionExpression)
    }
    if (
        not functions <= UNARY.keys()
    ):  # these have all derivatives wherever they have a value that is not at the end of their domain
        return nothing
    try:
        slopes = differentiate(expression, wrt_list=variables, mode=Modes.sympy)
        return [float(value(slope)) for slope in slopes]
    except Exception:  # noqa: BLE001 - what SymPy raises of what it does not know is its own; there is then no derivative to compare with
        return nothing


def _nodes(expression: Any) -> Iterator[Any]:
    """All nodes of an expression that are expressions themselves."""
    stack = [expression]
    while stack:
        node = stack.pop()
        if hasattr(node, "is_expression_type") and node.is_expression_type():
            yield node
            stack.extend(node.args)


def _empty_expression(expression: Any) -> str | None:
    """The name of an Expression without content that is part of an expression, None if there is none."""
    return next(
        (
            node.name
            for node in _nodes(expression)
            if node.is_named_expression_type() and node.expr is None
        ),
        None,
    )


_Triplets = tuple[np.ndarray, np.ndarray, np.ndarray]
_NO_TRIPLETS: _Triplets = (np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp), np.empty(0))


class _Columns:
    """Columns for variables; new ones go to the end."""

    def __init__(self, variables: Sequence[Any]) -> None:
        self.variables = list(variables)
        self._place = {id(variable): place for place, variable in enumerate(self.variables)}

    def of(self, variable: Any) -> int:
        known = self._place.get(id(variable))
        if known is None:
            known = self._place[id(variable)] = len(self.variables)
            self.variables.append(variable)
        return known


def _assembled(
    columns: _Columns,
    expressions: Sequence[Any],
    own: Sequence[int],
    triplets: _Triplets,
    notes: tuple[str, ...],
) -> Gradients:
    """The triplets, and Pyomo's derivatives of the expressions of these numbers."""
    found = [
        (row, columns.of(variable), slope)
        for row in own
        for variable, slope in pyomo_gradient(expressions[row])
    ]
    rows, places, slopes = (
        (np.array(part) for part in zip(*found, strict=True)) if found else _NO_TRIPLETS
    )
    n = len(columns.variables)
    matrix = sparse.coo_matrix(
        (
            np.append(triplets[2], slopes),
            (np.append(triplets[0], rows), np.append(triplets[1], places)),
        ),
        shape=(len(expressions), n),
    )
    return Gradients(variables=tuple(columns.variables), matrix=matrix.tocsr(), notes=notes)


class _Together:
    """Expressions read into terms by shape.

    refused: (expressions,) those that Pyomo must differentiate; values: of all the others;
        compared: whether Pyomo had derivatives of all that
    `agrees_with` asked for
    """

    def __init__(self, expressions: Sequence[Any]) -> None:
        reader = TermReader(len(expressions))
        self.refused = np.zeros(len(expressions), dtype=bool)
        for row, expression in enumerate(expressions):
            try:
                reader.read(row, expression, 1.0, _NOWHERE)
            except _REFUSED:
                self.refused[row] = True
        self.variables, self.compared = reader.variables, True
        self._x = np.array(
            [math.nan if variable.value is None else variable.value for variable in self.variables],
            dtype=float,
        )
        self._groups: list[TermGroup] = []
        data = np.array([read_number(source) for source in reader.data])
        with np.errstate(all="ignore"):
            for signature, bucket in reader.buckets.items():
                group = (
                    TermGroup(shape_of(signature), bucket) if len(bucket.rows) >= _OFTEN else None
                )
                if group is None:
                    self.refused[bucket.rows] = True
                else:
                    group.refresh(data)
                    self._groups.append(group)
        self._constants = np.array(reader.constants)
        rows, columns, slopes = (
            np.array(reader.rows, dtype=np.intp),
            np.array(reader.columns, dtype=np.intp),
            np.array(reader.slopes),
        )
        affine = [group.affine_entries for group in self._groups]
        rows, columns = (
            np.concatenate([first, *(entry[k] for entry in affine)])
            for k, first in enumerate((rows, columns))
        )
        slopes = np.concatenate([slopes, *(group.affine_values for group in self._groups)])
        self._affine = sparse.csr_matrix(
            (slopes, (rows, columns)), shape=(len(expressions), len(self.variables))
        )
        self.values, self._size = self._evaluated()

    def _evaluated(self) -> tuple[np.ndarray, np.ndarray]:
        """(expressions,) values, and sums of the sizes of their terms."""
        with np.errstate(all="ignore"):
            values = self._constants + self._affine @ self._x
            size = np.abs(self._constants) + abs(self._affine) @ np.abs(self._x)
            for group in self._groups:
                parts = group.constants + (group.values(self._x) if group.is_curved else 0.0)
                np.add.at(values, group.rows, parts)
                np.add.at(size, group.rows, np.abs(parts))
        return values, size

    def triplets(self) -> _Triplets:
        """(rows, columns, derivatives) of everything that was read.

        A variable whose linear terms cancel has none, as with Pyomo.
        """
        self._affine.eliminate_zeros()
        affine = self._affine.tocoo()
        parts = [(affine.row, affine.col, affine.data)]
        with np.errstate(all="ignore"):
            parts += [
                (*group.slope_entries, group.slopes(self._x))
                for group in self._groups
                if group.is_curved
            ]
        rows, columns, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
        return rows.astype(np.intp), columns.astype(np.intp), slopes

    def agrees_with(
        self, values: np.ndarray, triplets: _Triplets, expressions: Sequence[Any], own: np.ndarray
    ) -> bool:
        """Whether all values are Pyomo's, and the derivatives of some expressions of each shape, of some linear ones and of the last.

        Raises nothing: what Pyomo cannot differentiate is told by `compared`.

        Parameters
        ----------
        values : (expressions,) by Pyomo [units of the expressions]
        triplets : rows, columns, derivatives (entries,) [expression per variable]
        expressions : Pyomo expressions
        own : (expressions,) mask of those that are not compared [-]
        """
        with np.errstate(invalid="ignore"):
            differs = ~(
                np.abs(self.values - values) <= _ROUNDING * (1.0 + np.abs(values) + self._size)
            )
        if np.any(differs & ~own):
            return False
        linear = ~own
        sample = {len(expressions) - 1} if expressions else set()
        for group in self._groups:
            linear[group.rows] = False
        for rows in (
            *(group.rows[~own[group.rows]] for group in self._groups),
            np.flatnonzero(linear),
        ):
            sample |= {int(rows[place]) for place in (0, len(rows) // 2, -1) if len(rows)}
        matrix = sparse.csr_matrix(
            (triplets[2], triplets[:2]), shape=(len(expressions), len(self.variables))
        )
        columns = _Columns(self.variables)
        return all(
            self._same(pyomo_gradient(expressions[row]), matrix[row], columns)
            for row in sorted(sample)
            if not own[row]
        )

    def _same(
        self, theirs: list[tuple[Any, float]], ours: sparse.csr_matrix, columns: _Columns
    ) -> bool:
        difference = dict(zip(ours.indices.tolist(), ours.data.tolist(), strict=True))
        limit = _ROUNDING * max(1.0, float(np.max(np.abs(ours.data), initial=0.0)))
        self.compared = self.compared and all(math.isfinite(slope) for _, slope in theirs)
        for variable, slope in theirs:
            column = columns.of(variable)
            difference[column] = difference.get(column, 0.0) - slope
        return all(abs(rest) <= limit for rest in difference.values())


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """lower <= value <= upper, each (rows,), of the components `sources`: constraints, arguments of complementarities that must hold, and variables.

    arguments: which argument of `complements` a row is; None for the others
    """

    sources: tuple[Any, ...]
    arguments: tuple[int | None, ...]
    value: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """The larger of its finite bounds, at least 1 (rows,) [units of the rows]."""
        bounds = np.abs([self.lower, self.upper])
        return np.maximum(1.0, np.max(np.where(np.isfinite(bounds), bounds, 0.0), axis=0))

    def violation(self, value: np.ndarray) -> np.ndarray:
        """By how much these values (rows,) are beyond their bounds (rows,) [units of the rows].

        Raises nothing: NaN where one is NaN.
        """
        with np.errstate(invalid="ignore"):
            return np.maximum(np.maximum(self.lower - value, value - self.upper), 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """Two sides 0 <= first, 0 <= second, complementary.

    A flip is -1 where a side is the negative of what the user wrote (upper bound); arguments: which
    argument of `complements` each side is
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

    objective: in the model's own sense; gradient (n,): of what is minimised; rows: those with
        jacobian (m, n), then the variables within their bounds;
    pairs with gradients first_jacobian, second_jacobian (pairs, n), in the signs of `Pair`;
        slope_nearby: size of the objective's derivatives around the
    point, 1 at most
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
    slope_nearby: float = 1.0

    @property
    def sides(self) -> np.ndarray:
        """The first and the second sides (2, pairs) of the pairs [units of the sides]."""
        return np.array(
            [[pair.first for pair in self.pairs], [pair.second for pair in self.pairs]], dtype=float
        )

    @property
    def matrix(self) -> sparse.csr_matrix:
        """Gradients of all rows (m + n, n) [row per variable]."""
        return sparse.vstack(
            [self.jacobian, sparse.identity(len(self.variables), format="csr")], format="csr"
        )


@contextmanager
def values_set(variables: Iterable[Any], numbers: Iterable[float]) -> Iterator[None]:
    """Variables at these numbers for the time being.

    Their values and staleness come back whatever happens.
    """
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
    """The number.

    Raises MissingValueError where there is none because the expression holds one without content.
    """
    name = _empty_expression(expression) if math.isnan(number) else None
    if name is not None:
        raise MissingValueError(
            f"'{source.name}' needs the Expression '{name}', which is empty: give it a value, or deactivate '{source.name}'"
        )
    return number


def _slope_nearby(goal: Any, variables: Sequence[Any], gradient: np.ndarray) -> float:
    """Largest derivative of the objective a step of max(1, |x|) away, on either side.

    1 at most, and where there is none.

    At a point without constraints the derivatives vanish: what little is left of them is measured
    by those around, so that a cost in another unit is stationary at the same points.
    """
    found = float(np.max(np.abs(gradient), initial=0.0))
    if found >= 1.0:
        return 1.0
    x = np.array(
        [math.nan if variable.value is None else variable.value for variable in variables],
        dtype=float,
    )
    step = np.maximum(1.0, np.abs(x)) * np.where(np.arange(len(x)) % 2, -1.0, 1.0)
    for point in (x + step, x - step):
        with values_set(variables, point.tolist()):
            slopes = gradients_of([goal], [number_of(goal)]).matrix.data
        largest = float(np.max(np.abs(slopes), initial=0.0))
        found = max(found, largest) if math.isfinite(largest) else found
    return min(1.0, found) if found > 0.0 else 1.0


def read_local(model: Any, near: float) -> LocalModel:
    """All active components at their current values.

    Parameters
    ----------
    model : a Pyomo model
    near : a box within this of a bound is a pair with that bound

    Raises
    ------
    MissingValueError
        where a component needs an Expression that is empty
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
    sides: list[tuple[Any, Any]] = []
    side_values: list[tuple[float, float]] = []
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
    (first, second), (first_values, second_values) = (
        tuple(zip(*items, strict=True)) or ((), ()) for items in (sides, side_values)
    )
    found = gradients_of(
        [*bodies, *first, *second, goal],
        [*(value for _, _, value, _, _ in rows), *first_values, *second_values, objective],
    )
    m, k = len(rows), len(pairs)
    rows += [
        (variable, None, number_of(variable), *bounds_of(variable)) for variable in found.variables
    ]
    sources, arguments, values, lower, upper = tuple(zip(*rows, strict=True)) or ((),) * 5
    flips = [
        sparse.diags([getattr(pair, name) for pair in pairs], shape=(k, k))
        for name in ("first_flip", "second_flip")
    ]
    return LocalModel(
        variables=found.variables,
        objective=objective,
        gradient=sense * found.matrix[m + 2 * k].toarray().ravel(),
        rows=Rows(
            sources=sources,
            arguments=arguments,
            value=np.array(values),
            lower=np.array(lower),
            upper=np.array(upper),
        ),
        jacobian=found.matrix[:m],
        pairs=tuple(pairs),
        first_jacobian=(flips[0] @ found.matrix[m : m + k]).tocsr(),
        second_jacobian=(flips[1] @ found.matrix[m + k : m + 2 * k]).tocsr(),
        notes=found.notes,
        slope_nearby=_slope_nearby(goal, found.variables, found.matrix[m + 2 * k].data),
    )


def _bounded(condition: Any, argument: Any) -> tuple[Any, Any, Any]:
    """(lower, body, upper) of an argument, by Pyomo's own reading of it."""
    form = condition._canonical_expression(argument)
    lower, body, upper = (form[0], form[1], form[0]) if len(form) == 2 else form
    low, high = (
        None if bound is None else unbounded_if_huge(number_of(bound)) for bound in (lower, upper)
    )
    return (None if low == -math.inf else low), body, (None if high == math.inf else high)


def _local_pair(
    condition: Any, sides: list[tuple[Any, Any, Any]], near: float
) -> tuple[Pair, tuple[Any, Any], tuple[float, float]] | None:
    """The condition near this point as a pair, its two expressions and their values.

    None where nothing is complementary.
    """
    counts = [(lower is not None) + (upper is not None) for lower, _, upper in sides]
    if counts == [1, 1]:
        (a, a_flip, a_body, a_value), (b, b_flip, b_body, b_value) = (
            _distance(*side) for side in sides
        )
        pair = Pair(
            source=condition,
            first=a,
            second=b,
            first_flip=a_flip,
            second_flip=b_flip,
            arguments=(0, 1),
        )
        return pair, (a_body, b_body), (a_value, b_value)
    if sorted(counts) != [0, 2]:
        return None
    arguments = (0, 1) if counts == [2, 0] else (1, 0)
    (lower, body, upper), (_, free, _) = (sides[k] for k in arguments)
    if (
        lower >= upper
    ):  # equal: an equality; above: a range that holds no number, which is a row nothing can meet
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
    return pair, (body, free), (value, other)


def _distance(lower: Any, body: Any, upper: Any) -> tuple[float, float, Any, float]:
    value = number_of(body)
    return (
        (value - lower, 1.0, body, value) if upper is None else (upper - value, -1.0, body, value)
    )


def _imposed(sides: list[tuple[Any, Any, Any]]) -> list[tuple[int, tuple[Any, Any, Any]]]:
    """(number of the argument, relation) for what must hold where there is no choice.

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

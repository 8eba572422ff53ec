"""Derivatives of many expressions at the current point: all terms of one shape together, and Pyomo's own differentiation to vouch for them.

A scene's model has thousands of rows and a few dozen shapes. The terms are read by the compiler of `formulations.ipopt`; what it does not know,
what is rare and what is not finite here is differentiated by Pyomo, expression by expression. Of each shape some expressions are differentiated
by Pyomo as well, and all values are compared with Pyomo's: if any of that disagrees, Pyomo's derivatives are taken throughout.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sparse
from pyomo.core.expr.calculus.derivatives import Modes, differentiate
from pyomo.core.expr.calculus.diff_with_pyomo import DifferentiationException
from pyomo.core.expr.numeric_expr import UnaryFunctionExpression
from pyomo.core.expr.numvalue import value
from pyomo.core.expr.visitor import evaluate_fixed_subexpressions, identify_variables
from pyomo.repn import generate_standard_repn

from formulations.ipopt.shapes import shape_of
from formulations.ipopt.term_group import TermGroup
from formulations.ipopt.terms import TermReader

# A shape met less often is not worth compiling.
_OFTEN = 8
# Relative to the terms of a value, or the largest derivative of a row: two ways to the same number differ by rounding only.
_ROUNDING = 1e-9
_DISAGREE = "the derivatives that were evaluated together disagree with Pyomo's own, which were taken instead: please report this model"
_UNKNOWN = "Pyomo has no derivatives to compare those with that were evaluated together; its own were taken throughout"
# Functions of one argument that have all derivatives wherever they have a value that is not at the end of their domain.
_SMOOTH = frozenset(
    ["exp", "log", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "sqrt"]
)
_REFUSED = (ValueError, ArithmeticError, TypeError)  # of an expression that the compiler does not treat
_NOWHERE = SimpleNamespace(name="an expression")


@dataclass(frozen=True, kw_only=True, eq=False)
class Gradients:
    """matrix (expressions, n): derivatives by the n variables, NaN where there is none; notes: what the reader of a certificate should know."""

    variables: tuple[Any, ...]
    matrix: sparse.csr_matrix
    notes: tuple[str, ...] = ()


def gradients_of(expressions: Sequence[Any], values: Sequence[float]) -> Gradients:
    """Derivatives of Pyomo expressions by their free variables, at the variables' current values. values: of the expressions, by Pyomo."""
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
    return _assembled(_Columns(together.variables), expressions, np.flatnonzero(own).tolist(), (rows, columns, slopes), ())


def pyomo_gradient(expression: Any) -> list[tuple[Any, float]]:
    """(variable, derivative) of every free variable by Pyomo's own differentiation; NaN where it cannot evaluate one."""
    if not hasattr(expression, "is_potentially_variable") or not expression.is_potentially_variable():
        return []
    affine = generate_standard_repn(expression, compute_values=True, quadratic=False)
    if affine.is_linear():
        return [(variable, float(slope)) for variable, slope in zip(affine.linear_vars, affine.linear_coefs, strict=True)]
    variables = list(identify_variables(expression, include_fixed=False))
    try:
        # data as numbers: Pyomo would differentiate by a Param that is an exponent too, for which a negative base has no logarithm
        numeric = evaluate_fixed_subexpressions(expression)
        slopes = differentiate(numeric, wrt_list=variables, mode=Modes.reverse_numeric)
    except DifferentiationException:
        slopes = _symbolic(expression, variables)
    except (ArithmeticError, ValueError):
        slopes = [math.nan] * len(variables)
    return [(variable, math.nan if isinstance(slope, complex) else float(slope)) for variable, slope in zip(variables, slopes, strict=True)]


def _symbolic(expression: Any, variables: Sequence[Any]) -> Sequence[float]:
    """By Pyomo's way over SymPy, which knows more functions; NaN where one of them is not smooth."""
    nothing = [math.nan] * len(variables)
    functions = {node.getname() for node in _nodes(expression) if isinstance(node, UnaryFunctionExpression)}
    if not functions <= _SMOOTH:
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


def empty_expression(expression: Any) -> str | None:
    """The name of an Expression without content that is part of an expression, None if there is none."""
    return next((node.name for node in _nodes(expression) if node.is_named_expression_type() and node.expr is None), None)


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


def _assembled(columns: _Columns, expressions: Sequence[Any], own: Sequence[int], triplets: _Triplets, notes: tuple[str, ...]) -> Gradients:
    """The triplets, and Pyomo's derivatives of the expressions of these numbers."""
    found = [(row, columns.of(variable), slope) for row in own for variable, slope in pyomo_gradient(expressions[row])]
    rows, places, slopes = (np.array(part) for part in zip(*found, strict=True)) if found else _NO_TRIPLETS
    n = len(columns.variables)
    matrix = sparse.coo_matrix(
        (np.append(triplets[2], slopes), (np.append(triplets[0], rows), np.append(triplets[1], places))), shape=(len(expressions), n)
    )
    return Gradients(variables=tuple(columns.variables), matrix=matrix.tocsr(), notes=notes)


class _Together:
    """Expressions read into terms by shape. refused: (expressions,) those that Pyomo must differentiate; values: of all the others; compared:
    whether Pyomo had derivatives of all that `agrees_with` asked for."""

    def __init__(self, expressions: Sequence[Any]) -> None:
        reader = TermReader()
        reader.constants = [0.0] * len(expressions)
        self.refused = np.zeros(len(expressions), dtype=bool)
        for row, expression in enumerate(expressions):
            try:
                reader.read(row, expression, 1.0, _NOWHERE)
            except _REFUSED:
                self.refused[row] = True
        self.variables, self.compared = reader.variables, True
        self._x = np.array([math.nan if variable.value is None else variable.value for variable in self.variables], dtype=float)
        self._groups: list[TermGroup] = []
        data = np.array([_number(source) for source in reader.data])
        with np.errstate(all="ignore"):
            for signature, bucket in reader.buckets.items():
                group = TermGroup(shape_of(signature), bucket) if len(bucket.rows) >= _OFTEN else None
                if group is None:
                    self.refused[bucket.rows] = True
                else:
                    group.refresh(data)
                    self._groups.append(group)
        self._constants = np.array(reader.constants)
        rows, columns, slopes = np.array(reader.rows, dtype=np.intp), np.array(reader.columns, dtype=np.intp), np.array(reader.slopes)
        affine = [group.affine_entries for group in self._groups]
        rows, columns = (np.concatenate([first, *(entry[k] for entry in affine)]) for k, first in enumerate((rows, columns)))
        slopes = np.concatenate([slopes, *(group.affine_values for group in self._groups)])
        self._affine = sparse.csr_matrix((slopes, (rows, columns)), shape=(len(expressions), len(self.variables)))
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
        """(rows, columns, derivatives) of everything that was read; a variable whose linear terms cancel has none, as with Pyomo."""
        self._affine.eliminate_zeros()
        affine = self._affine.tocoo()
        parts = [(affine.row, affine.col, affine.data)]
        with np.errstate(all="ignore"):
            parts += [(*group.slope_entries, group.slopes(self._x)) for group in self._groups if group.is_curved]
        rows, columns, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
        return rows.astype(np.intp), columns.astype(np.intp), slopes

    def agrees_with(self, values: np.ndarray, triplets: _Triplets, expressions: Sequence[Any], own: np.ndarray) -> bool:
        """Whether all values are Pyomo's, and the derivatives of some expressions of each shape, of some linear ones and of the last."""
        with np.errstate(invalid="ignore"):
            differs = ~(np.abs(self.values - values) <= _ROUNDING * (1.0 + np.abs(values) + self._size))
        if np.any(differs & ~own):
            return False
        linear = ~own
        sample = {len(expressions) - 1} if expressions else set()
        for group in self._groups:
            linear[group.rows] = False
        for rows in (*(group.rows[~own[group.rows]] for group in self._groups), np.flatnonzero(linear)):
            sample |= {int(rows[place]) for place in (0, len(rows) // 2, -1) if len(rows)}
        matrix = sparse.csr_matrix((triplets[2], triplets[:2]), shape=(len(expressions), len(self.variables)))
        columns = _Columns(self.variables)
        return all(self._same(pyomo_gradient(expressions[row]), matrix[row], columns) for row in sorted(sample) if not own[row])

    def _same(self, theirs: list[tuple[Any, float]], ours: sparse.csr_matrix, columns: _Columns) -> bool:
        difference = dict(zip(ours.indices.tolist(), ours.data.tolist(), strict=True))
        limit = _ROUNDING * max(1.0, float(np.max(np.abs(ours.data), initial=0.0)))
        self.compared = self.compared and all(math.isfinite(slope) for _, slope in theirs)
        for variable, slope in theirs:
            column = columns.of(variable)
            difference[column] = difference.get(column, 0.0) - slope
        return all(abs(rest) <= limit for rest in difference.values())


def _number(source: Any) -> float:
    """The value of a Param or a fixed variable; NaN where it has none."""
    try:
        return float(source.value)
    except _REFUSED:
        return math.nan

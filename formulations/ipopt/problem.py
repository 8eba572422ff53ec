"""Compile a Pyomo model into an IpoptProblem: read the equations once, settle the sparsity.

    minimise f(x)   subject to   constraint_lower <= g(x) <= constraint_upper,   lower <= x <= upper

A maximised objective becomes -f (`sense` is -1). Evaluations return NaN or inf if the model does;
Ipopt then shortens its step.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from cyipopt import CyIpoptEvaluationError
from pyomo.common.gc_manager import PauseGC
from pyomo.common.numeric_types import native_numeric_types

from formulations.ipopt.model import (
    EvaluatedExpression,
    MissingValueError,
    StructureChangedError,
    active_constraints,
    active_objective,
    read_bound,
    read_bounds,
    read_data,
    refuse_unknown_components,
    sense_of,
    sides_of,
)
from formulations.ipopt.read import TermReader
from formulations.ipopt.shapes import TermGroup, shape_of


def _keeping(function: Callable[..., Any]) -> Callable[..., Any]:
    """Store a callback's first exception and stop the solve; cyipopt drops those of the Hessian."""

    @wraps(function)
    def call(self: Evaluations, *arguments: Any) -> Any:
        if self.error is None:
            try:
                return function(self, *arguments)
            except CyIpoptEvaluationError:
                raise
            except BaseException as error:  # noqa: BLE001 - raised after the solve
                self.error = error
        raise CyIpoptEvaluationError("the solve is being stopped")

    return call


def _finite(values: Any, what: str) -> Any:
    if not np.all(np.isfinite(values)):
        raise CyIpoptEvaluationError(f"{what} is not a finite number at this point")
    return values


class Evaluations:
    """The functions as cyipopt calls them: cached by point, timed, counted.

    `after` is called after each iteration and returns whether to continue.
    """

    def __init__(self, problem: IpoptProblem, after: Callable[..., bool]) -> None:
        self._problem = problem
        self._after = after
        self._last: dict[str, tuple[np.ndarray, Any]] = dict.fromkeys(
            ("values", "derivatives"), (np.full(problem.n, np.nan), None)
        )
        self.error: BaseException | None = None
        self.seconds = 0.0
        self.calls = {"values": 0, "derivatives": 0, "hessians": 0}
        self.jacobianstructure = problem.jacobianstructure
        self.hessianstructure = problem.hessianstructure

    def _counted(self, what: str, function: Callable[..., Any], *arguments: Any) -> Any:
        begin = time.perf_counter()
        result = function(*arguments)
        self.calls[what] += 1
        self.seconds += time.perf_counter() - begin
        return result

    def _at(self, x: np.ndarray, what: str) -> tuple[Any, np.ndarray]:
        if not np.array_equal(x, self._last[what][0]):
            self._last[what] = x.copy(), self._counted(what, getattr(self._problem, what), x)
        return self._last[what][1]

    @_keeping
    def objective(self, x: np.ndarray) -> float:
        """Return the objective at x (n,); raises CyIpoptEvaluationError if not finite."""
        return _finite(self._at(x, "values")[0], "the objective")

    @_keeping
    def constraints(self, x: np.ndarray) -> np.ndarray:
        """Return constraints (m,) [-] at x (n,); raises CyIpoptEvaluationError if not finite."""
        return _finite(self._at(x, "values")[1], "a constraint")

    @_keeping
    def gradient(self, x: np.ndarray) -> np.ndarray:
        """Return the gradient (n,) [-] at x (n,); raises CyIpoptEvaluationError if not finite."""
        return _finite(self._at(x, "derivatives")[0], "the gradient")

    @_keeping
    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the entries (nonzeros,) [-] at x (n,).

        Raises CyIpoptEvaluationError if not finite.
        """
        return _finite(self._at(x, "derivatives")[1], "the Jacobian")

    @_keeping
    def hessian(self, x: np.ndarray, lagrange: np.ndarray, factor: float) -> np.ndarray:
        """Return entries (nonzeros,) [-]; raises CyIpoptEvaluationError if not finite."""
        return _finite(
            self._counted("hessians", self._problem.hessian, x, lagrange, factor), "the Hessian"
        )

    def intermediate(self, *numbers: Any) -> bool:
        """Return whether Ipopt continues after this iteration."""
        if self.error is None:
            try:
                return self._after(*numbers)
            except BaseException as error:  # noqa: BLE001 - as above
                self.error = error
        return False


class IpoptProblem:
    """A compiled model of n variables and m constraints, with the numbers of the last `refresh()`.

    - objective_data: the active objective, of which sense * value is minimised, or None
    - variables, equations: Pyomo variables by column, constraints by row
    - trivial: constraints without a variable
    - lower, upper: (n,)
    - constraint_lower, constraint_upper: (m,)
    """

    def __init__(self, model: Any) -> None:
        refuse_unknown_components(model)
        self.model = model
        self._constraints, self.objective_data = active_constraints(model), active_objective(model)
        self._expressions = [constraint.expr for constraint in self._constraints]
        self.sense = sense_of(self.objective_data)
        self._rows = len(self._constraints) + 1  # the last row is the objective
        read = TermReader(self._rows)
        sides = [
            _read_constraint(read, row, constraint)
            for row, constraint in enumerate(self._constraints)
        ]
        if self.objective_data is not None:
            read.read(self._rows - 1, self.objective_data, float(self.sense), self.objective_data)
        self._row_bounds = (
            _bounds([low for low, _ in sides], -np.inf),
            _bounds([high for _, high in sides], np.inf),
        )
        self.variables, self._data, self._named = (
            tuple(read.variables),
            tuple(read.data),
            tuple(read.named.values()),
        )
        self.n = len(self.variables)
        self._groups = [
            TermGroup(shape_of(signature), bucket) for signature, bucket in read.buckets.items()
        ]
        self._curved = [g for g in self._groups if g.is_curved]
        self._fixed_constants = np.array(read.constants, dtype=float)
        self._numeric_slopes = np.array(read.slopes, dtype=float)
        self._settle_pattern(
            np.array(read.rows, dtype=np.intp), np.array(read.columns, dtype=np.intp)
        )
        self._settle_hessian()
        self.refresh(check=False)

    # -- structure

    def _settle_pattern(self, rows: np.ndarray, columns: np.ndarray) -> None:
        """Settle the sorted (row, column) positions, and the position of each contribution."""
        affine = [(rows, columns), *(g.affine_entries for g in self._groups)]
        slopes = [g.slope_entries for g in self._curved]
        keys = [r * self.n + c for r, c in (*affine, *slopes)]
        unique, place = np.unique(np.concatenate(keys), return_inverse=True)
        affine_count = sum(len(r) for r, _ in affine)
        self._affine_place = place[:affine_count]
        self._entry_row, self._entry_column = np.divmod(unique, max(self.n, 1))
        objective_row = self._rows - 1
        self._objective_start = int(np.searchsorted(self._entry_row, objective_row))
        used = np.zeros(self._rows - 1, dtype=bool)
        used[self._entry_row[: self._objective_start]] = True
        self._sent, self._unsent = np.flatnonzero(used), np.flatnonzero(~used)
        self.m = len(self._sent)
        self.equations = tuple(self._constraints[r] for r in self._sent)
        self.trivial = tuple(self._constraints[r] for r in self._unsent)
        renumbered = np.cumsum(used) - 1
        self._jacobian_rows = renumbered[self._entry_row[: self._objective_start]].astype(np.int32)
        self._jacobian_columns = self._entry_column[: self._objective_start].astype(np.int32)
        self._value_places = [g.rows.astype(np.int32) for g in self._curved]
        self._slope_places = _split(place[affine_count:], slopes)

    def _settle_hessian(self) -> None:
        entries = [g.curvature_entries for g in self._curved]
        keys = [r * self.n + c for r, c in entries] or [np.empty(0, dtype=np.intp)]
        unique, place = np.unique(np.concatenate(keys), return_inverse=True)
        self._curvature_places = [
            group.curvature_places(places)
            for group, places in zip(self._curved, _split(place, entries), strict=True)
        ]
        rows, columns = np.divmod(unique, max(self.n, 1))
        self._hessian_rows, self._hessian_columns = rows.astype(np.int32), columns.astype(np.int32)

    # -- values

    def refresh(self, *, check: bool = True) -> None:
        """Read Params, fixed values and bounds again.

        Raises
        ------
        StructureChangedError
            if variables were fixed or unfixed, or constraints, objective or expressions changed
        MissingValueError
            if a Param, a fixed variable or a bound has no value
        """
        if check:
            self._require_same_structure()
        self.lower, self.upper = read_bounds(self.variables)
        low, high = self._read_row_bounds()
        self.constraint_lower, self.constraint_upper = low[self._sent], high[self._sent]
        data = read_data(self._data)
        with np.errstate(all="ignore"):
            for group in self._groups:
                group.refresh(data)
            constants = self._fixed_constants.copy()
            for group in self._groups:
                np.add.at(constants, group.rows, group.constants)
            slopes = np.concatenate(
                [self._numeric_slopes, *(g.affine_values for g in self._groups)]
            )
            self._affine = np.bincount(
                self._affine_place, weights=slopes, minlength=len(self._entry_row)
            )
        self._constants = constants
        self._require_finite()
        self._trivial_bounds = low[self._unsent], high[self._unsent]

    def _require_same_structure(self) -> None:
        again = "compile the model again"
        constraints = active_constraints(self.model)
        if len(constraints) != len(self._constraints):
            raise StructureChangedError(
                f"{len(constraints)} constraints are active, {len(self._constraints)} were compiled: {again}"
            )
        for now, then, expression in zip(
            constraints, self._constraints, self._expressions, strict=True
        ):
            if now is not then:
                raise StructureChangedError(
                    f"constraint '{now.name}' is active where '{then.name}' was compiled: {again}"
                )
            if now.expr is not expression:
                raise StructureChangedError(
                    f"constraint '{now.name}' has another expression than the compiled one: {again}"
                )
        objective = active_objective(self.model)
        if objective is not self.objective_data or sense_of(objective) != self.sense:
            raise StructureChangedError(
                f"another objective (or sense) is active than the compiled one: {again}"
            )
        for named, inside in self._named:
            if named.args[0] is not inside:
                raise StructureChangedError(
                    f"expression '{named.name}' has another content than the compiled one: {again}"
                )
        for variable in self.variables:
            if variable.fixed:
                raise StructureChangedError(f"variable '{variable.name}' is fixed now: {again}")
        for source in self._data:
            if (
                source.__class__ is not EvaluatedExpression
                and source.is_variable_type()
                and not source.fixed
            ):
                raise StructureChangedError(
                    f"variable '{source.name}' was fixed and is free now: {again}"
                )

    def _read_row_bounds(self) -> list[np.ndarray]:
        known: dict[int, float] = {}
        sides = []
        for (numbers, later), unbounded in zip(self._row_bounds, (-np.inf, np.inf), strict=True):
            side = numbers.copy()
            for row, expression in later:
                if id(expression) not in known:
                    known[id(expression)] = read_bound(
                        expression, "constraint", self._constraints[row], unbounded
                    )
                side[row] = known[id(expression)]
            for row in np.flatnonzero(np.isnan(side) | (side == -unbounded)):
                raise MissingValueError(
                    f"constraint '{self._constraints[row].name}' has the bound {side[row]}"
                )
            sides.append(side)
        return sides

    def _require_finite(self) -> None:
        bad = [
            *np.flatnonzero(~np.isfinite(self._constants)),
            *self._entry_row[~np.isfinite(self._affine)],
        ]
        if bad:
            row = int(bad[0])
            where: Any = self.objective_data if row == self._rows - 1 else self._constraints[row]
            raise MissingValueError(
                f"'{where.name}' has a coefficient that is not a finite number: check its Params and fixed variables"
            )

    def start(self) -> tuple[np.ndarray, int]:
        """Return the current values x (n,) [variable units], and how many variables had none.

        These start at the point nearest 0 within their bounds. Raises nothing, even for crossing
        bounds.
        """
        values = [v.value for v in self.variables]
        missing = [k for k, v in enumerate(values) if v is None]
        for k in missing:
            values[k] = min(max(0.0, self.lower[k]), self.upper[k])
        return np.array(values, dtype=float), len(missing)

    def violation(self, x: np.ndarray) -> float:
        """Return the largest violation of a constraint or bound at x (n,) [constraint units].

        NaN counts as no violation. Raises nothing.
        """
        g = self.constraints(x)
        sides = (
            self.lower - x,
            x - self.upper,
            self.constraint_lower - g,
            g - self.constraint_upper,
        )
        return max((float(np.max(side)) for side in sides if side.size), default=0.0)

    def trivial_violation(self) -> tuple[float, str]:
        """Return the largest violation of a trivial constraint and its name, or (0.0, "")."""
        if not self.trivial:
            return 0.0, ""
        value, (low, high) = self._constants[self._unsent], self._trivial_bounds
        violation = np.maximum(np.maximum(low - value, value - high), 0.0)
        worst = int(np.argmax(violation))
        return float(violation[worst]), self.trivial[worst].name if violation[worst] > 0 else ""

    def _point(self, x: np.ndarray) -> np.ndarray:
        point = np.ascontiguousarray(x, dtype=float)
        if point.shape != (self.n,):
            raise ValueError(f"the point has shape {point.shape}, the problem needs ({self.n},)")
        return point

    # -- functions, under cyipopt's names

    def values(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the objective and the constraints (m,) at x (n,) [model units]. Raises nothing."""
        x, curved = self._point(x), np.zeros(self._rows)
        for group, places in zip(self._curved, self._value_places, strict=True):
            group.add_values(x, places, curved)
        with np.errstate(all="ignore"):
            affine = np.bincount(self._entry_row, self._affine * x[self._entry_column], self._rows)
            total = self._constants + affine + curved
        return float(total[-1]), total[self._sent]

    def derivatives(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient (n,) and Jacobian entries (nonzeros,) at x (n,) [row per variable].

        Raises nothing.
        """
        x, entries = self._point(x), np.zeros(len(self._affine))
        for group, places in zip(self._curved, self._slope_places, strict=True):
            group.add_slopes(x, places, entries)
        entries += self._affine
        gradient = np.zeros(self.n)
        gradient[self._entry_column[self._objective_start :]] = entries[self._objective_start :]
        return gradient, entries[: self._objective_start]

    def objective(self, x: np.ndarray) -> float:
        """Return the objective at x (n,) [objective units]. Raises nothing."""
        return self.values(x)[0]

    def constraints(self, x: np.ndarray) -> np.ndarray:
        """Return the constraints (m,) at x (n,) [constraint units]. Raises nothing."""
        return self.values(x)[1]

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """Return the gradient (n,) at x (n,) [objective per variable]. Raises nothing."""
        return self.derivatives(x)[0]

    def slope_size(self, x: np.ndarray) -> float:
        """Return the largest |gradient| at x (n,) [objective per variable]. Raises nothing."""
        return float(np.max(np.abs(self.gradient(x)), initial=0.0))

    def slope_size_nearby(self, x: np.ndarray) -> float:
        """Return the largest |gradient| at x (n,) and at a step to either side, at most 1.

        At a solution the gradient can vanish; the neighbours keep the measure independent of the
        cost's unit [objective per variable]. 1 without a slope. Raises nothing.
        """
        step = np.maximum(1.0, np.abs(x)) * np.where(np.arange(len(x)) % 2, -1.0, 1.0)
        sizes = [self.slope_size(point) for point in (x, x + step, x - step)]
        largest = max((size for size in sizes if np.isfinite(size)), default=0.0)
        return min(1.0, largest) if largest > 0.0 else 1.0

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the Jacobian's entries (nonzeros,) at x (n,) [row per variable].

        Raises nothing.
        """
        return self.derivatives(x)[1]

    def lagrangian_gradient(self, x: np.ndarray, lagrange: np.ndarray) -> np.ndarray:
        """Return the gradient (n,) of f + lagrange' g; at a solution it equals zl - zu.

        Raises nothing.

        x is (n,), lagrange (m,) in Ipopt's signs [objective per constraint].
        """
        gradient, jacobian = self.derivatives(x)
        with np.errstate(all="ignore"):
            products = jacobian * lagrange[self._jacobian_rows]
            return gradient + np.bincount(self._jacobian_columns, products, self.n)

    def jacobianstructure(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns (nonzeros,) of the Jacobian's entries [-]. Raises nothing."""
        return self._jacobian_rows, self._jacobian_columns

    def hessian(self, x: np.ndarray, lagrange: np.ndarray, factor: float) -> np.ndarray:
        """Return the entries (nonzeros,) of factor * f'' + sum lagrange_i * g_i'', lower triangle.

        x is (n,), lagrange (m,) in Ipopt's signs [objective per constraint]. Raises nothing.
        """
        multipliers = np.zeros(self._rows)
        multipliers[self._sent] = lagrange
        multipliers[-1] = factor
        x, entries = self._point(x), np.zeros(len(self._hessian_rows))
        for group, places in zip(self._curved, self._curvature_places, strict=True):
            group.add_curvatures(x, multipliers, places, entries)
        return entries

    def hessianstructure(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns (nonzeros,) of the Hessian's entries, rows >= columns [-].

        Raises nothing.
        """
        return self._hessian_rows, self._hessian_columns

    @property
    def nonzeros(self) -> int:
        """Return the number of entries of the Jacobian and the lower Hessian, at least 1."""
        return max(1, len(self._jacobian_rows) + len(self._hessian_rows))


def compile_model(model: Any) -> IpoptProblem:
    """Compile a smooth Pyomo model; the model is not changed.

    Variables are numbered by first appearance, constraints by declaration. Constraints without a
    variable are not sent to Ipopt; `IpoptProblem.trivial_violation` checks these.

    Raises
    ------
    ModelRefusedError
        for a component that Ipopt cannot treat, such as an integer variable or a Complementarity
    MissingValueError
        if a Param or a fixed variable has no value
    """
    with PauseGC():
        return IpoptProblem(model)


def _split(places: np.ndarray, entries: list[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    ends = np.cumsum([len(rows) for rows, _ in entries], dtype=np.intp)
    return [part.astype(np.int32) for part in np.split(places, ends)[:-1]]


def _read_constraint(read: TermReader, row: int, constraint: Any) -> tuple[Any, Any]:
    body, subtracted, low, high = sides_of(constraint)
    read.read(row, body, 1.0, constraint)
    if subtracted is not None:
        read.read(row, subtracted, -1.0, constraint)
    return low, high


def _bounds(bounds: list[Any], unbounded: float) -> tuple[np.ndarray, tuple[tuple[int, Any], ...]]:
    """Return constant bounds, and (row, expression) of those that a refresh evaluates."""
    numbers = np.full(len(bounds), unbounded)
    later = []
    for row, bound in enumerate(bounds):
        if bound is None:
            continue
        if bound.__class__ in native_numeric_types:
            numbers[row] = bound
        else:
            later.append((row, bound))
    return numbers, tuple(later)

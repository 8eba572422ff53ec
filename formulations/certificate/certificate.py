"""Certify the point in a Pyomo model's variables, independently of its solver.

    certificate = certify(model)
    certificate.holds  # feasible, complementary, and no descent direction to first order
    print(certificate.sentence)

A point may satisfy all residuals only because complementarity is inexact:

    x y >= 1,   0 <= x complementary to y >= 0        at   x = 5e-13, y = 2e12

`forced` is the largest violation of the constraints after a step to exact pairs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sparse
from pyomo.common.collections import ComponentMap
from pyomo.common.gc_manager import PauseGC
from scipy.optimize import linprog
from scipy.sparse.linalg import lsqr

from formulations.certificate.kinks import smooth_copy
from formulations.certificate.local import LocalModel, Pair, Rows, read_local
from formulations.certificate.stationarity import (
    PROGRAM,
    Stationarity,
    Verdict,
    active_set,
    at_bounds,
    judge,
)
from formulations.ipopt.model import NotSmoothError, refuse_no_model
from formulations.ipopt.slopes import in_words

# Largest step of a variable to exact pairs, relative to max(1, |x|): far above tolerances, far
# below the distance of another solution.
_SMALL_STEP = 1e-2
# A side below the rounding of its own terms needs no step.
_ROUNDING = 4.0 * float(np.finfo(float).eps)
# Share of a side that the step may leave.
_EXACT = 1e-3
# The same, of the largest side.
_SOLVED = 1e-12


def _forced_violation(local: LocalModel) -> float:
    """Return the largest first-order violation after a small step to exact pairs.

    The step is the shortest one, or if that violates a constraint, the least violating one.
    Violations are relative to max(1, |bound|); inf without a small step.
    """
    rows = local.rows
    x = rows.value[local.jacobian.shape[0] :]
    sides, matrix = _closed_sides(local)
    rounding = _ROUNDING * (abs(matrix) @ np.abs(x) + np.abs(sides - matrix @ x))
    if not np.any(np.abs(sides) > rounding):
        return _largest(rows.violation(rows.value) / rows.size)
    radius = sparse.diags(_SMALL_STEP * np.maximum(1.0, np.abs(x)))
    scaled = matrix @ radius
    length = np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel())
    length = np.where(length > 0.0, length, 1.0)
    scaled, wanted = sparse.diags(1.0 / length) @ scaled, -sides / length
    step = lsqr(scaled, wanted, atol=1e-15, btol=1e-15)[0]
    exact = 4.0 * rounding / length + _EXACT * np.abs(wanted) + _SOLVED * np.max(np.abs(wanted))
    if np.any(np.abs(scaled @ step - wanted) > exact):
        return math.inf
    change = (local.matrix @ radius).tocsr()
    violation = _largest(rows.violation(rows.value + change @ step) / rows.size)
    if violation <= FEASIBILITY and np.all(np.abs(step) <= 1.0):
        return violation
    return _least_violation(rows, change, scaled, step)


def _least_violation(
    rows: Rows, change: sparse.csr_matrix, scaled: sparse.csr_matrix, step: np.ndarray
) -> float:
    """Return the least violation after a step of at most 1 that moves the sides as `step` does.

    The linear program is scaled by the step, so that its tolerance is small. inf without a step.
    """
    unit = float(np.max(np.abs(step)))
    low, high = rows.lower - rows.value, rows.upper - rows.value
    reach = np.asarray(abs(change).sum(axis=1)).ravel()
    below, above = low > -reach, high < reach  # the other rows hold after every step
    matrix = sparse.vstack([-change[below], change[above]])
    size = np.concatenate([rows.size[below], rows.size[above]])
    answer = linprog(
        np.append(np.zeros(len(step)), 1.0),
        A_ub=sparse.hstack([matrix, sparse.csr_matrix(-size[:, None])], format="csc"),
        b_ub=np.concatenate([-low[below], high[above]]) / unit,
        A_eq=sparse.hstack([scaled, sparse.csr_matrix((scaled.shape[0], 1))], format="csc"),
        b_eq=scaled @ step / unit,
        bounds=[*[(-1.0 / unit, 1.0 / unit)] * len(step), (0.0, None)],
        method="highs",
        options=PROGRAM,
    )
    return unit * float(answer.fun) if answer.status == 0 else math.inf


def _closed_sides(local: LocalModel) -> tuple[np.ndarray, sparse.csr_matrix]:
    """Return values and gradients of the smaller sides, and of free sides inside boxes."""
    rows, (first, second) = local.rows, local.sides
    held = np.flatnonzero(
        np.array([argument is not None for argument in rows.arguments], dtype=bool)
        & (rows.lower == rows.upper)
    )
    both = sparse.vstack([local.first_jacobian, local.second_jacobian], format="csr")
    smaller = both[np.arange(len(first)) + len(first) * (second < first)]
    values = np.append(np.minimum(first, second), (rows.value - rows.lower)[held])
    return values, sparse.vstack([smaller, local.jacobian[held]], format="csr")


# Violation of a feasible point, relative to max(1, |bound|). Points polished here have 1e-12 in
# this and the next residual; solvers without polish have 1e-8.
FEASIBILITY = 1e-6
# min(G, H) of a pair, in the user's units.
COMPLEMENTARITY = 1e-6
# Dual residual, relative to the objective's largest derivative (nearby), at most 1.
STATIONARITY = 1e-5
# A row, bound or side this close to zero is active.
_ACTIVE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Largest violations of a feasible point.

    feasibility: of rows, bounds and sides, relative to max(1, |bound|)
    complementarity: of min(G, H) of a pair
    """

    feasibility: float = FEASIBILITY
    complementarity: float = COMPLEMENTARITY


@dataclass(frozen=True, kw_only=True, eq=False)
class Multipliers:
    """Multipliers by component; missing multipliers are 0.

    gradient (sense * f) = sum rows[c] gradient c + sum bounds[x] + sum of pairs
    - rows, bounds: positive at a lower bound
    - pairs: (multiplier of the body of the first argument, of the second) of `complements`
    """

    rows: Mapping[Any, float] = field(default_factory=ComponentMap)
    bounds: Mapping[Any, float] = field(default_factory=ComponentMap)
    pairs: Mapping[Any, tuple[float, float]] = field(default_factory=ComponentMap)

    def __post_init__(self) -> None:
        for name in ("rows", "bounds", "pairs"):  # Pyomo's components are not hashable
            object.__setattr__(self, name, ComponentMap(getattr(self, name).items()))


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Residuals and stationarity of a point.

    - primal: largest violation of a row, a bound or a side of a pair [user's units]
    - complementarity: largest min(G, H)
    - forced: relative violation of the constraints with exact pairs, to first order
    - dual: relative residual of the multipliers
    - given_dual: residual of the caller's multipliers, including wrong signs, NaN without
    - biactive: pairs with both sides zero
    - obstacle: clause on what prevents strong stationarity
    - descent: slope of a descent direction (0: B-stationary; NaN: not known)
    - worst: component with the largest violation
    - objective: in the model's own sense
    - endless: clause on an infinite or undefined derivative, or empty
    """

    primal: float
    primal_relative: float
    complementarity: float
    forced: float
    dual: float
    given_dual: float
    pairs: int
    biactive: int
    stationarity: Stationarity
    obstacle: str
    descent: float
    worst: str
    objective: float
    tolerances: Tolerances = Tolerances()
    notes: tuple[str, ...] = field(default=())
    endless: str = ""

    @property
    def feasible(self) -> bool:
        """Return whether the point is within tolerances, and stays so with exact pairs."""
        return self._within and self.forced <= FEASIBILITY

    @property
    def lives_on_tolerance(self) -> bool:
        """Return whether the point is within tolerances, but exact pairs violate them."""
        return self._within and not self.forced <= FEASIBILITY and not self.endless

    @property
    def _within(self) -> bool:
        return (
            self.primal_relative <= self.tolerances.feasibility
            and self.complementarity <= self.tolerances.complementarity
        )

    @property
    def strong(self) -> bool:
        """Return whether the point is strongly stationary (S-stationary), hence B-stationary."""
        return self.stationarity is Stationarity.STRONG

    @property
    def b_stationary(self) -> bool | None:
        """Return whether there is no descent direction to first order; None if not known."""
        if self.strong:
            return True
        return None if math.isnan(self.descent) else self.descent >= -STATIONARITY

    @property
    def holds(self) -> bool:
        """Return whether the point is feasible and B-stationary, and given multipliers fit."""
        return (
            self.feasible and self.b_stationary is True and not self.given_dual > STATIONARITY * 10
        )

    @property
    def sentence(self) -> str:
        """Return residuals and stationarity as text."""
        measured = f"primal {self.primal:.1e}, complementarity {self.complementarity:.1e}, in the model's units"
        if not (self.endless and math.isnan(self.dual)):
            measured += f", dual {self.dual:.1e} of the gradient"
        if not self._within:
            where = (
                f", most in {self.worst}"
                if self.worst and not self.primal_relative <= self.tolerances.feasibility
                else ""
            )
            return f"{measured}; not feasible{where}, so it is not stationary"
        if self.endless and not (self.forced <= FEASIBILITY and self.b_stationary is not None):
            return f"{measured}; {self.endless}, so it is not known whether the point is stationary"
        if not self.forced <= FEASIBILITY:
            violated = f"violated by {self.forced:.1e}" if self.forced < math.inf else "unknown"
            return f"{measured}; feasible only because complementarity is not exact (constraints {violated} if the pairs held exactly)"
        return f"{measured}; {self.stationary_as}, {self.biactive} of {self.pairs} pairs biactive"

    @property
    def stationary_as(self) -> str:
        """Return the stationarity as text, with the obstacle."""
        if self.strong:
            return "S-stationary"
        consequence = {
            True: "but B-stationary: no direction goes down",
            False: f"and not B-stationary: a direction goes down (slope {self.descent:.1e} of the gradient)",
            None: "B-stationarity unknown",
        }[self.b_stationary]
        return f"not S-stationary ({self.obstacle}), {consequence}"


def certify(
    model: Any, multipliers: Multipliers | None = None, *, tolerances: Tolerances = Tolerances()
) -> Certificate:
    """Certify the current values of a model's variables; the model is only read.

    Absolute values, minima and maxima are treated as pairs (`formulations.certificate.kinks`).

    Parameters
    ----------
    model : a Pyomo model
    multipliers : checked too, if the model has no such kinks
    tolerances : largest violations of a feasible point

    Raises
    ------
    ModelRefusedError
        if this is not a Pyomo model
    MissingValueError
        if a component needs an Expression that is empty
    """
    refuse_no_model(model)
    try:
        with PauseGC():
            local = read_local(model, _ACTIVE)
    except NotSmoothError:
        smooth = certify(smooth_copy(model).model, tolerances=tolerances)
        return replace(
            smooth, notes=(*smooth.notes, "absolute values, minima and maxima are written as pairs")
        )
    first, second = local.sides
    negative = np.fmax(0.0, -np.fmin(first, second))
    violations = np.append(local.rows.violation(local.rows.value), negative)
    relative = np.append(violations[: len(local.rows.value)] / local.rows.size, negative)
    sources = [*local.rows.sources, *(pair.source for pair in local.pairs)]
    worst = _largest(violations)
    active = active_set(local, _ACTIVE)
    given_dual, forced, notes, endless = math.nan, math.nan, local.notes, ""
    if _is_finite(local):
        verdict, forced = judge(local, active, STATIONARITY), _forced_violation(local)
        given_dual = math.nan if multipliers is None else _given_residual(local, multipliers)
    else:
        endless = _endless_slope(local)
        notes = notes or (
            endless or "a function or derivative is not a finite number at this point",
        )
        verdict = Verdict(kind=Stationarity.NONE, residual=math.nan, obstacle=notes[0])
        if endless and not len(_closed_sides(local)[0]):  # no pair needs a step
            forced = _forced_violation(local)
        blocked = _without_endless_slopes(local) if endless else None
        if blocked is not None:
            forced = _forced_violation(blocked)
            judged = judge(blocked, active_set(blocked, _ACTIVE), STATIONARITY)
            verdict = replace(
                verdict,
                residual=judged.residual,
                descent=0.0 if judged.kind is Stationarity.STRONG else judged.descent,
            )
    return Certificate(
        primal=worst,
        primal_relative=_largest(relative),
        complementarity=_largest(np.maximum(0.0, np.minimum(first, second))),
        forced=forced,
        dual=verdict.residual,
        given_dual=given_dual,
        pairs=len(local.pairs),
        biactive=len(active.both),
        stationarity=verdict.kind,
        obstacle=verdict.obstacle,
        descent=verdict.descent,
        tolerances=tolerances,
        worst=""
        if worst == 0.0
        else str(sources[int(np.argmax(np.nan_to_num(violations, nan=np.inf)))].name),
        objective=local.objective,
        notes=notes,
        endless=endless,
    )


def _endless_slope(local: LocalModel) -> str:
    if not (np.all(np.isfinite(local.rows.value)) and np.all(np.isfinite(local.sides))):
        return ""
    if not math.isfinite(local.objective):
        return ""
    x = local.rows.value[local.jacobian.shape[0] :]
    for wrong in np.flatnonzero(~np.isfinite(local.gradient)).tolist():
        if local.goal is not None:
            return in_words(local.goal, local.variables[wrong], x[wrong], local.gradient[wrong])
    sides = [pair.source for pair in local.pairs]
    for sources, matrix in (
        (local.rows.sources, local.jacobian),
        (sides, local.first_jacobian),
        (sides, local.second_jacobian),
    ):
        entries = matrix.tocoo()
        for wrong in np.flatnonzero(~np.isfinite(entries.data)).tolist():
            row, column = entries.row[wrong], entries.col[wrong]
            return in_words(sources[row], local.variables[column], x[column], entries.data[wrong])
    return ""


def _without_endless_slopes(local: LocalModel) -> LocalModel | None:
    """Return the model with variables fixed that can leave their bounds only at an infinite cost.

    Such a direction is no descent. None if another derivative is not finite.
    """
    m = local.jacobian.shape[0]
    low, high = at_bounds(local.rows, _ACTIVE)
    endless = ~np.isfinite(local.gradient)
    held = ((local.gradient == np.inf) & low[m:]) | ((local.gradient == -np.inf) & high[m:])
    gradient = np.where(endless, 0.0, local.gradient)
    fixed = replace(local, gradient=gradient, scale=max(1.0, _largest(np.abs(gradient))))
    if not np.array_equal(endless, held) or not _is_finite(fixed):
        return None
    rows, places = local.rows, m + np.flatnonzero(held)
    lower, upper = rows.lower.copy(), rows.upper.copy()
    lower[places] = upper[places] = rows.value[places]
    return replace(fixed, rows=replace(rows, lower=lower, upper=upper))


def _given_residual(local: LocalModel, multipliers: Multipliers) -> float:
    rows, m = local.rows, local.jacobian.shape[0]
    y = np.array(
        [
            _row_multiplier(source, argument, multipliers)
            for source, argument in zip(rows.sources, rows.arguments, strict=True)
        ]
    )
    pairs = [_pair_multipliers(pair, multipliers) for pair in local.pairs]
    nu, mu = np.array([first for first, _ in pairs]), np.array([second for _, second in pairs])
    rest = local.gradient - y[m:]
    for matrix, vector in (
        (local.jacobian, y[:m]),
        (local.first_jacobian, nu),
        (local.second_jacobian, mu),
    ):
        rest = rest - matrix.T @ vector
    distance = np.abs(rows.value - np.where(y > 0.0, rows.lower, rows.upper))
    first, second = local.sides
    y = np.where(rows.lower == rows.upper, 0.0, y)
    wrong = (
        np.abs(rest),
        _wrong(y, distance, rows.size),
        _wrong(nu, first, 1.0),
        _wrong(mu, second, 1.0),
    )
    return _largest(np.concatenate(wrong)) / local.scale


def _wrong(multiplier: np.ndarray, distance: np.ndarray, size: np.ndarray | float) -> np.ndarray:
    """Return the error of each multiplier (rows,), of active rows times their distance."""
    return np.abs(multiplier) * np.where(distance <= _ACTIVE * size, np.maximum(0.0, distance), 1.0)


def _row_multiplier(source: Any, argument: int | None, multipliers: Multipliers) -> float:
    if argument is not None:
        return multipliers.pairs.get(source, (0.0, 0.0))[argument]
    return multipliers.rows.get(source, multipliers.bounds.get(source, 0.0))


def _pair_multipliers(pair: Pair, multipliers: Multipliers) -> tuple[float, float]:
    both = multipliers.pairs.get(pair.source, (0.0, 0.0))
    return pair.first_flip * both[pair.arguments[0]], pair.second_flip * both[pair.arguments[1]]


def _largest(values: np.ndarray) -> float:
    return float(np.max(values)) + 0.0 if values.size else 0.0


def _is_finite(local: LocalModel) -> bool:
    arrays = (
        local.gradient,
        local.jacobian.data,
        local.first_jacobian.data,
        local.second_jacobian.data,
        local.rows.value,
        local.sides,
    )
    return all(np.all(np.isfinite(array)) for array in arrays) and math.isfinite(local.objective)

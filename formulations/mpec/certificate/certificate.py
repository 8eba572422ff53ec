"""Judge the point that a Pyomo model's variables hold, whoever computed it.

certificate = certify(model)
certificate.holds  # feasible, complementary, and no direction goes down to first order
print(certificate.sentence)

A point may satisfy every residual only because complementarity is not exact:

    x y >= 1,   0 <= x complementary to y >= 0        at   x = 5e-13, y = 2e12

`forced` is the largest violation of the constraints after the step that makes every pair exact.
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

from formulations.ipopt.model import NotSmoothError, refuse_no_model
from formulations.ipopt.slopes import in_words
from formulations.mpec.certificate.local import LocalModel, Pair, Rows, read_local
from formulations.mpec.certificate.stationarity import (
    PROGRAM,
    Stationarity,
    Verdict,
    active_set,
    at_bounds,
    judge,
)
from formulations.mpec.kinks import smooth_copy

# Largest step of a variable that makes pairs exact, relative to max(1, |x|): far more than
# tolerances need, far less than another solution.
_SMALL_STEP = 1e-2
# Sides that are 0 but for rounding of their own terms need no step.
_ROUNDING = 4.0 * float(np.finfo(float).eps)
# Share of a side that may be left by the step, and of the largest side.
_EXACT = 1e-3
_SOLVED = 1e-12


def _forced_violation(local: LocalModel) -> float:
    """Return the largest violation, to first order, after a small step that makes every pair exact.

    The shortest step, or if that violates a constraint, the step that violates the constraints
    least. Relative to max(1, |bound|); inf if no small step makes the pairs exact.
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
    """Return the least violation after a step of at most 1 that moves the sides as this step does.

    The unit of the linear program is the size of the step, so that the program's tolerance is a
    small share of the step. inf if there is no such step.
    """
    unit = float(np.max(np.abs(step)))
    low, high = rows.lower - rows.value, rows.upper - rows.value
    reach = np.asarray(abs(change).sum(axis=1)).ravel()
    below, above = low > -reach, high < reach  # the others hold after every step
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
    """Return values and gradients of the sides that pairs hold at 0.

    They are the smaller side of each pair, and the free side of a box between its bounds.
    """
    rows, (first, second) = local.rows, local.sides
    held = np.flatnonzero(
        np.array([argument is not None for argument in rows.arguments], dtype=bool)
        & (rows.lower == rows.upper)
    )
    both = sparse.vstack([local.first_jacobian, local.second_jacobian], format="csr")
    smaller = both[np.arange(len(first)) + len(first) * (second < first)]
    values = np.append(np.minimum(first, second), (rows.value - rows.lower)[held])
    return values, sparse.vstack([smaller, local.jacobian[held]], format="csr")


# Feasibility relative to max(1, |bound|); complementarity as min(G, H) of a pair, in the user's
# units; dual residual relative to the largest derivative of the objective, at the point or around
# it, if that is less than 1. A point polished by this package has 1e-12 in the first two; a solver
# without polish about 1e-8.
FEASIBILITY = 1e-6
COMPLEMENTARITY = 1e-6
STATIONARITY = 1e-5
# A row, bound or side this near zero is active.
_ACTIVE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Largest violations of a feasible point.

    feasibility: of rows, bounds and sides, relative to max(1, |bound|); complementarity: of
        min(G, H) of a pair
    """

    feasibility: float = FEASIBILITY
    complementarity: float = COMPLEMENTARITY


@dataclass(frozen=True, kw_only=True, eq=False)
class Multipliers:
    """Multipliers by component; missing multipliers are 0.

    gradient (sense * f) = sum rows[c] gradient c + sum bounds[x] + sum of pairs
    rows, bounds: positive pushes away from a lower bound. pairs: (multiplier of the body of the
        first argument, of the second) of `complements`.
    """

    rows: Mapping[Any, float] = field(default_factory=ComponentMap)
    bounds: Mapping[Any, float] = field(default_factory=ComponentMap)
    pairs: Mapping[Any, tuple[float, float]] = field(default_factory=ComponentMap)

    def __post_init__(self) -> None:
        for name in ("rows", "bounds", "pairs"):  # Pyomo's components are not hashable in general
            object.__setattr__(self, name, ComponentMap(getattr(self, name).items()))


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Residuals and stationarity of a point.

    primal: largest violation of a row, a bound or a side of a pair [user's units]; complementarity:
        largest min(G, H)
    forced: violation of the constraints (relative) if the pairs held exactly, to first order
    dual: residual of the multipliers (relative); given_dual: residual and wrong signs of the
        multipliers given by the caller, NaN if none were given
    biactive: pairs with both sides zero; obstacle: what prevents strong stationarity, in words
    descent: slope of a direction that goes down (0: B-stationary; NaN: not known)
    worst: the name of the component with the largest violation; objective: in the model's own sense
    endless: a clause on a derivative that is infinite or undefined at the point; empty without one
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
        """Within tolerances, and not thanks to them: no constraint needs a pair to be violated."""
        return self._within and self.forced <= FEASIBILITY

    @property
    def lives_on_tolerance(self) -> bool:
        """Whether the point is within tolerances, but no point with exact pairs is near."""
        return self._within and not self.forced <= FEASIBILITY and not self.endless

    @property
    def _within(self) -> bool:
        return (
            self.primal_relative <= self.tolerances.feasibility
            and self.complementarity <= self.tolerances.complementarity
        )

    @property
    def strong(self) -> bool:
        """Whether the point is strongly stationary (S-stationary), which implies B-stationary."""
        return self.stationarity is Stationarity.STRONG

    @property
    def b_stationary(self) -> bool | None:
        """Whether no direction goes down to first order; None if that is not known."""
        if self.strong:
            return True
        return None if math.isnan(self.descent) else self.descent >= -STATIONARITY

    @property
    def holds(self) -> bool:
        """Feasible, complementary and B-stationary; and multipliers that were given are right."""
        return (
            self.feasible and self.b_stationary is True and not self.given_dual > STATIONARITY * 10
        )

    @property
    def sentence(self) -> str:
        """Residuals and stationarity in words."""
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
        """Stationarity in words, and what prevents it."""
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
    """Judge the current values of a model's variables. The model is only read.

    Absolute values, minima and maxima of variables are judged as the pairs that they are
    (`formulations.mpec.kinks`).

    Parameters
    ----------
    model : a Pyomo model
    multipliers : if given they are checked too, where the model has no such kinks
    tolerances : up to which violation the point counts as feasible

    Raises
    ------
    ModelRefusedError
        for what is no Pyomo model
    MissingValueError
        where a component needs an Expression that is empty
    """
    refuse_no_model(model)
    try:
        with PauseGC():
            local = read_local(model, _ACTIVE)
    except NotSmoothError:
        found = certify(smooth_copy(model).model, tolerances=tolerances)
        return replace(
            found, notes=(*found.notes, "absolute values, minima and maxima are written as pairs")
        )
    first, second = local.sides
    negative = np.fmax(0.0, -np.fmin(first, second))
    violations = np.append(local.rows.violation(local.rows.value), negative)
    relative = np.append(violations[: len(local.rows.value)] / local.rows.size, negative)
    sources = [*local.rows.sources, *(pair.source for pair in local.pairs)]
    worst = _largest(violations)
    active = active_set(local, _ACTIVE)
    given, forced, notes, endless = math.nan, math.nan, local.notes, ""
    if _is_finite(local):
        found, forced = judge(local, active, STATIONARITY), _forced_violation(local)
        given = math.nan if multipliers is None else _given_residual(local, multipliers)
    else:
        endless = _endless_slope(local)
        notes = notes or (
            endless or "a function or derivative is not a finite number at this point",
        )
        found = Verdict(kind=Stationarity.NONE, residual=math.nan, obstacle=notes[0])
        if endless and not len(_closed_sides(local)[0]):  # no pair that a step would make exact
            forced = _forced_violation(local)
        blocked = _without_endless_slopes(local) if endless else None
        if blocked is not None:
            forced = _forced_violation(blocked)
            judged = judge(blocked, active_set(blocked, _ACTIVE), STATIONARITY)
            found = replace(
                found,
                residual=judged.residual,
                descent=0.0 if judged.kind is Stationarity.STRONG else judged.descent,
            )
    return Certificate(
        primal=worst,
        primal_relative=_largest(relative),
        complementarity=_largest(np.maximum(0.0, np.minimum(first, second))),
        forced=forced,
        dual=found.residual,
        given_dual=given,
        pairs=len(local.pairs),
        biactive=len(active.both),
        stationarity=found.kind,
        obstacle=found.obstacle,
        descent=found.descent,
        tolerances=tolerances,
        worst=""
        if worst == 0.0
        else str(sources[int(np.argmax(np.nan_to_num(violations, nan=np.inf)))].name),
        objective=local.objective,
        notes=notes,
        endless=endless,
    )


def _endless_slope(local: LocalModel) -> str:
    """Name a function whose value is a number, but whose derivative is not; empty if a value is not."""
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
    """Return the model with variables fixed that leave their bounds only at an infinite cost.

    A direction along such a variable does not go down, so that the others decide. None if a slope
    that is not finite is of another kind.
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
    """Return the largest residual of the given multipliers, relative to the scale.

    Residuals are the rest of the gradient, and multipliers with a wrong sign or of inactive rows.
    """
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
    """Return by how much each multiplier (rows,) is wrong.

    An inactive row counts with its whole multiplier, an active row times its distance.
    """
    return np.abs(multiplier) * np.where(distance <= _ACTIVE * size, np.maximum(0.0, distance), 1.0)


def _row_multiplier(source: Any, argument: int | None, multipliers: Multipliers) -> float:
    if argument is not None:
        return multipliers.pairs.get(source, (0.0, 0.0))[argument]
    return multipliers.rows.get(source, multipliers.bounds.get(source, 0.0))


def _pair_multipliers(pair: Pair, multipliers: Multipliers) -> tuple[float, float]:
    """Return the multipliers (nu, mu) of the two sides, in the signs of the pair."""
    given = multipliers.pairs.get(pair.source, (0.0, 0.0))
    return pair.first_flip * given[pair.arguments[0]], pair.second_flip * given[pair.arguments[1]]


def _largest(values: np.ndarray) -> float:
    """Return the largest value: 0.0 for no value, NaN if a value is NaN, never -0.0."""
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

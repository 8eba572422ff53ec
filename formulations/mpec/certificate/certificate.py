"""What can be said of the point that a Pyomo model's variables hold, whoever computed it.

certificate = certify(model)
certificate.holds                     # feasible, complementary, and no direction goes down to first order
certificate.stationarity.letter       # S, M, C, A, W or -
print(certificate.sentence)

Beside residuals and class it says whether the constraints would still hold if the complementarity held exactly:

    x y >= 1,   0 <= x complementary to y >= 0        at   x = 5e-13, y = 2e12

satisfies every residual to 1e-12, and there is no solution: the row lives on the 5e-13. Here the smaller side of each pair is moved to 0, and
the other constraints are asked how much of their violation no small step of the variables can mend.
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
from scipy.linalg import null_space
from scipy.optimize import linprog
from scipy.sparse.linalg import lsqr

from formulations.mpec.certificate.derivatives import ConstraintRow, LocalModel, Pair, read_local
from formulations.mpec.certificate.stationarity import (
    ActiveSet,
    Stationarity,
    StationarityVerdict,
    active_set,
    class_of,
    classify,
    steepest_piece,
)
from formulations.mpec.kinks import has_kinks, smooth_copy

# The step may change a variable by this, relative to max(1, |x|): far more than tolerances ask for, far less than another solution.
_SMALL_STEP = 1e-2
# Sides that are 0 but for rounding of their own terms need no step.
_ROUNDING = 4.0 * float(np.finfo(float).eps)
# A side is made exact where this much of it is left at most.
_EXACT = 1e-3
# What linear algebra leaves of the largest side in every other.
_SOLVED = 1e-12
# Up to this many variables other steps than the shortest are sought (by a dense null space) where that one breaks a row, and found directly.
_DENSE = 600


def _forced_violation(local: LocalModel, tolerance: float) -> float:
    """Largest violation of a row or bound (relative to max(1, |bound|)), to first order, after the step that makes every pair exact.

    The shortest step is taken where it keeps the violation within the tolerance, else the best; inf if no small one makes the pairs exact.
    """
    x = np.array([row.value for row in local.bounds])
    sides, matrix = _closed_sides(local)
    rows = (*local.rows, *local.bounds)
    value, low, high = (np.array([getattr(row, name) for row in rows]) for name in ("value", "lower", "upper"))
    scale = np.maximum(1.0, np.maximum(_finite(low), _finite(high)))

    def violation(now: np.ndarray) -> float:
        """Largest relative violation where rows and bounds have the values now (rows,) [units of the rows]. Raises nothing."""
        return float(np.max(np.maximum(np.maximum(low - now, now - high), 0.0) / scale, initial=0.0))

    rounding = _ROUNDING * (abs(matrix) @ np.abs(x) + np.abs(sides - matrix @ x))  # of its terms and its constant
    if np.all(np.abs(sides) <= rounding):
        return violation(value)
    radius = sparse.diags(_SMALL_STEP * np.maximum(1.0, np.abs(x)))
    scaled = matrix @ radius
    norm = np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel())
    norm = np.where(norm > 0, norm, 1.0)
    scaled, wanted = sparse.diags(1.0 / norm) @ scaled, -sides / norm
    if len(x) <= _DENSE:
        shortest = np.linalg.lstsq(scaled.toarray(), wanted, rcond=1e-13)[0]
    else:
        shortest = lsqr(scaled, wanted, atol=1e-15, btol=1e-15)[0]
    missed = np.abs(scaled @ shortest - wanted)
    if np.any(missed > 4.0 * rounding / norm + _EXACT * np.abs(wanted) + _SOLVED * np.max(np.abs(wanted))):
        return float("inf")
    everything = sparse.vstack([local.jacobian, sparse.identity(len(x), format="csr")], format="csr") @ radius
    moved = value + everything @ shortest
    simple = violation(moved) if np.all(np.abs(shortest) <= 1.0) else float("inf")
    return simple if simple <= tolerance or len(x) > _DENSE else min(simple, _mended(scaled, everything, shortest, moved, low, high, scale))


def _mended(
    scaled: sparse.csr_matrix,
    everything: sparse.csr_matrix,
    shortest: np.ndarray,
    moved: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    scale: np.ndarray,
) -> float:
    """Least t: low - t scale <= moved + everything N z <= high + t scale, |shortest + N z| <= 1.

    N spans the steps that leave the sides where they are: as equations of the program they would hold within its tolerance only, which is what is in
    question.
    """
    basis = null_space(scaled.toarray(), rcond=1e-12)
    free = everything @ basis
    below, above = np.isfinite(low), np.isfinite(high)
    none = np.zeros((len(shortest), 1))
    answer = linprog(
        np.append(np.zeros(basis.shape[1]), 1.0),
        A_ub=np.vstack([
            np.hstack([-free[below], -scale[below][:, None]]), np.hstack([free[above], -scale[above][:, None]]),
            np.hstack([basis, none]), np.hstack([-basis, none]),
        ]),
        b_ub=np.concatenate([(moved - low)[below], (high - moved)[above], 1.0 - shortest, 1.0 + shortest]),
        bounds=[*[(None, None)] * basis.shape[1], (0.0, None)],
        method="highs",
    )  # fmt: skip
    return float(answer.fun) if answer.status == 0 else float("inf")


def _closed_sides(local: LocalModel) -> tuple[np.ndarray, sparse.csr_matrix]:
    """(values, gradients) of what the pairs say is 0: the smaller side of each, and the free side of a box between its bounds."""
    second = np.array([pair.second < pair.first for pair in local.pairs], dtype=bool)
    held = np.array([row.argument is not None and row.lower == row.upper for row in local.rows], dtype=bool)
    values = [min(pair.first, pair.second) for pair in local.pairs]
    values += [row.value - row.lower for row, is_held in zip(local.rows, held, strict=True) if is_held]
    both = sparse.vstack([local.first_jacobian, local.second_jacobian], format="csr")
    smaller = both[np.arange(len(second)) + len(second) * second]
    return np.array(values, dtype=float), sparse.vstack([smaller, local.jacobian[np.flatnonzero(held)]], format="csr")


def _finite(bound: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(bound), np.abs(bound), 0.0)


# Feasibility relative to max(1, |bound|); complementarity as min(G, H) of a pair, in the user's units; dual residual relative to the largest
# derivative of the objective, at the point or around it, where that is less than 1 (`slope_nearby`). A point polished by this package has 1e-12 in the first two; a solver without polish about 1e-8.
FEASIBILITY, COMPLEMENTARITY, STATIONARITY = 1e-6, 1e-6, 1e-5
# A row, bound or side this near zero is active.
_ACTIVE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Up to which violation a point counts as feasible: of rows, bounds and sides relative to max(1, |bound|); and of min(G, H) of a pair."""

    feasibility: float = FEASIBILITY
    complementarity: float = COMPLEMENTARITY


@dataclass(frozen=True, kw_only=True, eq=False)
class Multipliers:
    """gradient (sense * f) = sum rows[c] gradient c + sum bounds[x] + sum of pairs: by component, missing ones are 0.

    rows, bounds: positive pushes away from a lower bound. pairs: (multiplier of the body of the first argument, of the second) of `complements`.
    """

    rows: Mapping[Any, float] = field(default_factory=ComponentMap)
    bounds: Mapping[Any, float] = field(default_factory=ComponentMap)
    pairs: Mapping[Any, tuple[float, float]] = field(default_factory=ComponentMap)

    def __post_init__(self) -> None:
        for name in ("rows", "bounds", "pairs"):  # Pyomo's components are not hashable in general
            object.__setattr__(self, name, ComponentMap(getattr(self, name).items()))


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """What can be said of a point.

    primal: largest violation of a row, a bound or a side of a pair [user's units]; complementarity: largest min(G, H); product: largest |G H|
    forced: what the constraints would be violated by (relative) if the pairs held exactly, to first order
    dual: residual of the multipliers of the class (relative); given_dual: residual and wrong signs of the multipliers that came with the point, NaN if
    none did
    biactive: pairs with both sides zero; descent: steepest slope of a piece (0: B-stationary; NaN: not all pieces were looked at)
    least: smallest multiplier of a biactive pair (NaN where others exist or none were found); unique: whether the multipliers are the only ones (LICQ)
    worst: the name of the component with the largest violation; objective: in the model's own sense
    """

    primal: float
    primal_relative: float
    complementarity: float
    product: float
    forced: float
    dual: float
    given_dual: float
    pairs: int
    biactive: int
    stationarity: Stationarity
    descent: float
    worst: str
    objective: float
    tolerances: Tolerances = Tolerances()
    least: float = math.nan
    unique: bool = False
    notes: tuple[str, ...] = field(default=())

    @property
    def feasible(self) -> bool:
        """Within tolerances, and not thanks to them: no constraint needs a pair to be violated."""
        return self._within and self.forced <= FEASIBILITY

    @property
    def lives_on_tolerance(self) -> bool:
        """Whether everything holds within the tolerances, but some constraint would not if the pairs held exactly."""
        return self._within and not self.forced <= FEASIBILITY

    @property
    def _within(self) -> bool:
        return self.primal_relative <= self.tolerances.feasibility and self.complementarity <= self.tolerances.complementarity

    @property
    def b_stationary(self) -> bool | None:
        """None where there are too many biactive pairs to know. By linearisation: strong stationarity implies it."""
        if self.stationarity is Stationarity.STRONG:
            return True
        return None if math.isnan(self.descent) else self.descent >= -STATIONARITY

    @property
    def holds(self) -> bool:
        """Feasible, complementary and B-stationary; and multipliers that came along are right."""
        return self.feasible and self.b_stationary is True and not self.given_dual > STATIONARITY * 10

    @property
    def sentence(self) -> str:
        """Residuals, class and B-stationarity in words."""
        b = {True: "B-stationary", False: f"not B-stationary (slope {self.descent:.1e} of the gradient)", None: "B-stationarity unknown"}[
            self.b_stationary
        ]
        measured = f"primal {self.primal:.1e}, complementarity {self.complementarity:.1e}, in the model's units, dual {self.dual:.1e} of the gradient"
        if not self._within:
            where = f", most in {self.worst}" if self.worst and not self.primal_relative <= self.tolerances.feasibility else ""
            return f"{measured}; not feasible{where}, so it is stationary in no class"
        if not self.forced <= FEASIBILITY:
            violated = f"violated by {self.forced:.1e}" if self.forced < math.inf else "unknown"
            return f"{measured}; feasible only because complementarity is not exact (constraints {violated} if the pairs held exactly)"
        return f"{measured}; class {self.stationarity.letter}, {b}, {self.biactive} of {self.pairs} pairs biactive{self._signs}"

    @property
    def _signs(self) -> str:
        if not self.biactive or math.isnan(self.least):
            return ""
        return f" with {'unique ' if self.unique else ''}multipliers of at least {self.least:.3g}"


def certify(model: Any, multipliers: Multipliers | None = None, *, tolerances: Tolerances = Tolerances()) -> Certificate:
    """Judge the current values of a model's variables. The model is only read.

    With more than ten biactive pairs B-stationarity is known only where it follows from class S. Absolute values, minima and maxima of variables are
    judged as the pairs that they are (`formulations.mpec.kinks`).

    Parameters
    ----------
    model : a Pyomo model
    multipliers : if given they are checked too, where the model has no such kinks
    tolerances : up to which violation the point counts as feasible

    Raises
    ------
    MissingValueError
        where a component needs an Expression that is empty
    """
    if has_kinks(model):
        found = certify(smooth_copy(model).model, tolerances=tolerances)
        return replace(found, notes=(*found.notes, "absolute values, minima and maxima are written as pairs"))
    with PauseGC():
        local = read_local(model, _ACTIVE)
    rows = (*local.rows, *local.bounds)
    violations = [_violation(row) for row in rows]
    sides = [max(0.0, -min(pair.first, pair.second)) for pair in local.pairs]
    worst_row = _largest([*violations, *sides])
    complementarity = _largest(
        [max(0.0, min(p.first, p.second)) if p.first == p.first and p.second == p.second else math.nan for p in local.pairs]
    )
    relative = _largest([*(v / _size(row) for v, row in zip(violations, rows, strict=True)), *sides])
    names = [*rows, *local.pairs]
    active = active_set(local, _ACTIVE)
    found, given, computable = StationarityVerdict(kind=Stationarity.NONE, residual=math.nan), math.nan, _is_finite(local)
    if computable:
        given = math.nan if multipliers is None else _given_residual(local, active, multipliers)
        shown = Stationarity.NONE if multipliers is None or not given <= STATIONARITY else _given_class(local, active, multipliers)
        found = StationarityVerdict(kind=shown, residual=given) if shown is Stationarity.STRONG else classify(active, STATIONARITY, shown)
        if found.kind is Stationarity.STRONG:
            found = replace(found, descent=0.0)
        elif not found.descent < -STATIONARITY:  # one wrong multiplier may show too gentle a slope where several together show a steep one
            found = replace(found, descent=steepest_piece(active, STATIONARITY)[0])
    return Certificate(
        primal=worst_row,
        primal_relative=relative,
        complementarity=complementarity,
        product=_largest([abs(pair.first * pair.second) for pair in local.pairs]),
        forced=_forced_violation(local, FEASIBILITY) if computable else math.nan,
        dual=found.residual,
        given_dual=given,
        pairs=len(local.pairs),
        biactive=len(active.both),
        stationarity=found.kind,
        descent=found.descent,
        tolerances=tolerances,
        least=found.least,
        unique=found.unique,
        worst="" if worst_row == 0.0 else str(names[int(np.argmax(np.nan_to_num([*violations, *sides], nan=np.inf)))].source.name),
        objective=local.objective,
        notes=local.notes if computable else (*local.notes, "a function or derivative is not a finite number at this point"),
    )


def _given_residual(local: LocalModel, active: ActiveSet, multipliers: Multipliers) -> float:
    """Largest of: what the multipliers leave of the gradient; wrong signs; multipliers of what is not active. Relative to the scale."""
    none = (0.0, 0.0)
    y = np.array([
        multipliers.rows.get(row.source, 0.0) if row.argument is None else multipliers.pairs.get(row.source, none)[row.argument]
        for row in local.rows
    ])  # fmt: skip
    z = np.array([multipliers.bounds.get(row.source, 0.0) for row in local.bounds])
    pairs = [_pair_multipliers(pair, multipliers) for pair in local.pairs]
    nu, mu = np.array([first for first, _ in pairs]), np.array([second for _, second in pairs])
    rest = local.gradient - z
    for matrix, vector in ((local.jacobian, y), (local.first_jacobian, nu), (local.second_jacobian, mu)):
        rest = rest - matrix.T @ vector
    wrong = [float(np.max(np.abs(rest), initial=0.0))]
    for row, multiplier in zip((*local.rows, *local.bounds), (*y, *z), strict=True):
        limit = row.lower if multiplier > 0 else row.upper
        if multiplier != 0.0 and row.lower != row.upper:
            wrong.append(_wrong(multiplier, abs(row.value - limit), _size(row)))
    wrong += [_wrong(m, p.first, 1.0) for m, p in zip(nu, local.pairs, strict=True)]
    wrong += [_wrong(m, p.second, 1.0) for m, p in zip(mu, local.pairs, strict=True)]
    return _largest(wrong) / active.scale


def _wrong(multiplier: float, distance: float, size: float) -> float:
    """A multiplier of what is not active counts whole, as for who looks for multipliers without knowing these; of what is active, times the distance."""
    return abs(multiplier) * (max(0.0, distance) if distance <= _ACTIVE * size else 1.0)


def _pair_multipliers(pair: Pair, multipliers: Multipliers) -> tuple[float, float]:
    """(nu, mu) of the two sides, in the signs of the pair."""
    given = multipliers.pairs.get(pair.source, (0.0, 0.0))
    return pair.first_flip * given[pair.arguments[0]], pair.second_flip * given[pair.arguments[1]]


def _given_class(local: LocalModel, active: ActiveSet, multipliers: Multipliers) -> Stationarity:
    return class_of([_pair_multipliers(local.pairs[k], multipliers) for k in active.both], STATIONARITY * active.scale)


def _violation(row: ConstraintRow) -> float:
    if math.isnan(row.value) or math.isnan(row.lower) or math.isnan(row.upper):
        return math.nan
    return max(0.0, row.lower - row.value, row.value - row.upper)


def _size(row: ConstraintRow) -> float:
    return max(1.0, *(abs(bound) for bound in (row.lower, row.upper) if math.isfinite(bound)), 1.0)


def _largest(values: list[float]) -> float:
    """Largest value, 0 for none; NaN stays NaN."""
    return float(np.max(values)) if values else 0.0


def _is_finite(local: LocalModel) -> bool:
    arrays = (local.gradient, local.jacobian.data, local.first_jacobian.data, local.second_jacobian.data)
    values = [row.value for row in (*local.rows, *local.bounds)] + [v for pair in local.pairs for v in (pair.first, pair.second)]
    return all(np.all(np.isfinite(array)) for array in arrays) and bool(np.all(np.isfinite(values))) and math.isfinite(local.objective)

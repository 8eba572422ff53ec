"""What can be said of the point that a Pyomo model's variables hold, whoever computed it.

certificate = certify(model)
certificate.holds  # feasible, complementary, and no direction goes down to first order
certificate.stationarity.letter       # S, M, C, A, W or -
print(certificate.sentence)

Beside residuals and class it says whether the constraints would still hold if the complementarity
held exactly:

    x y >= 1,   0 <= x complementary to y >= 0        at   x = 5e-13, y = 2e12

satisfies every residual to 1e-12, and there is no solution: the row lives on the 5e-13. Here the
smaller side of each pair is moved to 0, and the other constraints are asked how much of their
violation no small step of the variables can mend.
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

from formulations.ipopt.model import refuse_no_model
from formulations.mpec.certificate.derivatives import LocalModel, Pair, Rows, read_local
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

# The step may change a variable by this, relative to max(1, |x|): far more than tolerances ask for,
# far less than another solution.
_SMALL_STEP = 1e-2
# Sides that are 0 but for rounding of their own terms need no step.
_ROUNDING = 4.0 * float(np.finfo(float).eps)
# A side is made exact where this much of it is left at most.
_EXACT = 1e-3
# What linear algebra leaves of the largest side in every other.
_SOLVED = 1e-12
# Up to this many variables other steps than the shortest are sought (by a dense null space) where
# that one breaks a row, and found directly.
_DENSE = 600


def _forced_violation(local: LocalModel, tolerance: float) -> float:
    """Largest violation of a row or bound (relative to max(1, |bound|)), to first order, after the step that makes every pair exact.

    The shortest step is taken where it keeps the violation within the tolerance, else the best; inf
    if no small one makes the pairs exact.
    """
    rows, scale = local.rows, local.rows.size
    x = rows.value[local.jacobian.shape[0] :]
    sides, matrix = _closed_sides(local)

    def violation(now: np.ndarray) -> float:
        """Largest relative violation where rows and bounds have the values now (rows,) [units of the rows]. Raises nothing."""
        return float(np.max(rows.violation(now) / scale, initial=0.0))

    rounding = _ROUNDING * (
        abs(matrix) @ np.abs(x) + np.abs(sides - matrix @ x)
    )  # of its terms and its constant
    if np.all(np.abs(sides) <= rounding):
        return violation(rows.value)
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
    if np.any(
        missed > 4.0 * rounding / norm + _EXACT * np.abs(wanted) + _SOLVED * np.max(np.abs(wanted))
    ):
        return float("inf")
    everything = local.matrix @ radius
    moved = rows.value + everything @ shortest
    simple = violation(moved) if np.all(np.abs(shortest) <= 1.0) else float("inf")
    return (
        simple
        if simple <= tolerance or len(x) > _DENSE
        else min(simple, _mended(rows, scaled, everything, shortest, moved))
    )


def _mended(
    rows: Rows,
    scaled: sparse.csr_matrix,
    everything: sparse.csr_matrix,
    shortest: np.ndarray,
    moved: np.ndarray,
) -> float:
    """Least t: low - t scale <= moved + everything N z <= high + t scale, |shortest + N z| <= 1.

    N spans the steps that leave the sides where they are: as equations of the program they would
    hold within its tolerance only, which is what is in question.
    """
    basis = null_space(scaled.toarray(), rcond=1e-12)
    free = everything @ basis
    low, high, scale = rows.lower, rows.upper, rows.size
    below, above = np.isfinite(low), np.isfinite(high)
    none = np.zeros((len(shortest), 1))
    answer = linprog(
        np.append(np.zeros(basis.shape[1]), 1.0),
        A_ub=np.vstack([
            np.hstack([-free[below], -scale[below][:, None]]),
            np.hstack([free[above], -scale[above][:, None]]),
            np.hstack([basis, none]), np.hstack([-basis, none]),
        ]),
        b_ub=np.concatenate([(moved - low)[below], (high - moved)[above], 1.0 - shortest,
                             1.0 + shortest]),
        bounds=[*[(None, None)] * basis.shape[1], (0.0, None)],
        method="highs",
    )  # fmt: skip
    return float(answer.fun) if answer.status == 0 else float("inf")


def _closed_sides(local: LocalModel) -> tuple[np.ndarray, sparse.csr_matrix]:
    """(values, gradients) of what the pairs say is 0: the smaller side of each, and the free side of a box between its bounds."""
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
# it, where that is less than 1 (`slope_nearby`). A point polished by this package has 1e-12 in the
# first two; a solver without polish about 1e-8.
FEASIBILITY = 1e-6
COMPLEMENTARITY = 1e-6
STATIONARITY = 1e-5
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
    """What can be said of a point.

    primal: largest violation of a row, a bound or a side of a pair [user's units]; complementarity:
        largest min(G, H); product: largest |G H|
    forced: what the constraints would be violated by (relative) if the pairs held exactly, to first
        order
    dual: residual of the multipliers of the class (relative); given_dual: residual and wrong signs
        of the multipliers that came with the point, NaN if
    none did
    biactive: pairs with both sides zero; descent: steepest slope of a piece (0: B-stationary; NaN:
        not all pieces were looked at)
    least: smallest multiplier of a biactive pair (NaN where others exist or none were found);
        unique: whether the multipliers are the only ones (LICQ)
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
        return (
            self.primal_relative <= self.tolerances.feasibility
            and self.complementarity <= self.tolerances.complementarity
        )

    @property
    def b_stationary(self) -> bool | None:
        """None where there are too many biactive pairs to know.

        By linearisation: strong stationarity implies it.
        """
        if self.stationarity is Stationarity.STRONG:
            return True
        return None if math.isnan(self.descent) else self.descent >= -STATIONARITY

    @property
    def holds(self) -> bool:
        """Feasible, complementary and B-stationary; and multipliers that came along are right."""
        return (
            self.feasible and self.b_stationary is True and not self.given_dual > STATIONARITY * 10
        )

    @property
    def sentence(self) -> str:
        """Residuals, class and B-stationarity in words."""
        b = {
            True: "B-stationary",
            False: f"not B-stationary (slope {self.descent:.1e} of the gradient)",
            None: "B-stationarity unknown",
        }[self.b_stationary]
        measured = f"primal {self.primal:.1e}, complementarity {self.complementarity:.1e}, in the model's units, dual {self.dual:.1e} of the gradient"
        if not self._within:
            where = (
                f", most in {self.worst}"
                if self.worst and not self.primal_relative <= self.tolerances.feasibility
                else ""
            )
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


def certify(
    model: Any, multipliers: Multipliers | None = None, *, tolerances: Tolerances = Tolerances()
) -> Certificate:
    """Judge the current values of a model's variables. The model is only read.

    With more than ten biactive pairs B-stationarity is known only where it follows from class S.
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
    if has_kinks(model):
        found = certify(smooth_copy(model).model, tolerances=tolerances)
        return replace(
            found, notes=(*found.notes, "absolute values, minima and maxima are written as pairs")
        )
    with PauseGC():
        local = read_local(model, _ACTIVE)
    first, second = local.sides
    negative = np.fmax(0.0, -np.fmin(first, second))
    violations = np.append(local.rows.violation(local.rows.value), negative)
    relative = np.append(violations[: len(local.rows.value)] / local.rows.size, negative)
    sources = [*local.rows.sources, *(pair.source for pair in local.pairs)]
    worst = _largest(violations)
    active = active_set(local, _ACTIVE)
    found, given, computable = (
        StationarityVerdict(kind=Stationarity.NONE, residual=math.nan),
        math.nan,
        _is_finite(local),
    )
    if computable:
        given = math.nan if multipliers is None else _given_residual(local, active, multipliers)
        shown = (
            Stationarity.NONE
            if multipliers is None or not given <= STATIONARITY
            else _given_class(local, active, multipliers)
        )
        found = (
            StationarityVerdict(kind=shown, residual=given)
            if shown is Stationarity.STRONG
            else classify(active, STATIONARITY, shown)
        )
        if found.kind is Stationarity.STRONG:
            found = replace(found, descent=0.0)
        elif (
            not found.descent < -STATIONARITY
        ):  # one wrong multiplier may show too gentle a slope where several together show a steep one
            found = replace(found, descent=steepest_piece(active, STATIONARITY)[0])
    return Certificate(
        primal=worst,
        primal_relative=_largest(relative),
        complementarity=_largest(np.maximum(0.0, np.minimum(first, second))),
        product=_largest(np.abs(first * second)),
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
        worst=""
        if worst == 0.0
        else str(sources[int(np.argmax(np.nan_to_num(violations, nan=np.inf)))].name),
        objective=local.objective,
        notes=local.notes
        if computable
        else (*local.notes, "a function or derivative is not a finite number at this point"),
    )


def _given_residual(local: LocalModel, active: ActiveSet, multipliers: Multipliers) -> float:
    """Largest of: what the multipliers leave of the gradient; wrong signs.

    Multipliers of what is not active. Relative to the scale.
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
    return _largest(np.concatenate(wrong)) / active.scale


def _wrong(multiplier: np.ndarray, distance: np.ndarray, size: np.ndarray | float) -> np.ndarray:
    """A multiplier of what is not active counts whole, as for who looks for multipliers without knowing these; of what is active, times the distance.

    All (rows,), or (pairs,). Raises nothing.
    """
    return np.abs(multiplier) * np.where(distance <= _ACTIVE * size, np.maximum(0.0, distance), 1.0)


def _row_multiplier(source: Any, argument: int | None, multipliers: Multipliers) -> float:
    if argument is not None:
        return multipliers.pairs.get(source, (0.0, 0.0))[argument]
    return multipliers.rows.get(source, multipliers.bounds.get(source, 0.0))


def _pair_multipliers(pair: Pair, multipliers: Multipliers) -> tuple[float, float]:
    """(nu, mu) of the two sides, in the signs of the pair."""
    given = multipliers.pairs.get(pair.source, (0.0, 0.0))
    return pair.first_flip * given[pair.arguments[0]], pair.second_flip * given[pair.arguments[1]]


def _given_class(local: LocalModel, active: ActiveSet, multipliers: Multipliers) -> Stationarity:
    return class_of(
        [_pair_multipliers(local.pairs[k], multipliers) for k in active.both],
        STATIONARITY * active.scale,
    )


def _largest(values: np.ndarray) -> float:
    """Largest value, 0 for none; NaN stays NaN, and -0.0 does not."""
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

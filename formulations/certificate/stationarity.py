"""Classify a point by its multipliers, from one linear program.

    gradient f = sum y gradient g,   y >= 0 for inequalities and for both sides of a biactive pair

    verdict = judge(local, active_set(local, 1e-6), 1e-5)
    verdict.kind is Stationarity.STRONG  # else verdict.obstacle explains

If a point is not strongly stationary, a mixed-integer program searches for a descent direction
that keeps one side of each biactive pair at 0. Without one the point is B-stationary.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import Bounds, LinearConstraint, linprog, milp

from formulations.certificate.local import LocalModel, Rows

# Tightest tolerance of HiGHS. An equally tight dual tolerance makes its simplex method fail.
PROGRAM = {"primal_feasibility_tolerance": 1e-10}
# SciPy's status for numerical difficulties.
_NUMERICAL = 4
# Share of the tolerance given to a program, because HiGHS holds bounds only within its own.
_SHARE = 0.999

_NONE = np.empty(0, dtype=np.intp)
# Any descent direction suffices, hence the wide gap. The search gives up after these nodes; the
# largest plan of the bank, with 169 biactive pairs, needs 1.
_PIECES = {"mip_rel_gap": 0.9, "node_limit": 1000}


class Stationarity(Enum):
    """Stationarity by multipliers; the value is the meaning."""

    STRONG = "multipliers exist, none of a pair with both sides zero is negative"
    WEAK = "multipliers exist, but one of a pair with both sides zero is negative"
    NONE = "no multipliers exist within the tolerance"


@dataclass(frozen=True, kw_only=True, eq=False)
class ActiveSet:
    """Conditions that hold with equality within a tolerance.

    - normals: (k, n) gradients, each divided by its absolute sum; HiGHS reads entries < 1e-9 as 0
    - sizes: (k,) these sums
    - lowest, highest: (k,) limits of the multipliers, each 0 or infinite
    - both: (b,) numbers of the biactive pairs
    - first, second: (b,) rows of their sides in `normals`
    """

    normals: sparse.csr_matrix
    sizes: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    both: np.ndarray
    first: np.ndarray
    second: np.ndarray


def active_set(local: LocalModel, tolerance: float) -> ActiveSet:
    """Return the rows, bounds and sides of pairs within the tolerance of their limits."""
    low, high = at_bounds(local.rows, tolerance)
    chosen = low | high
    first, second = local.sides <= tolerance
    both = first & second
    normals = sparse.vstack(
        [local.matrix[chosen], local.first_jacobian[first], local.second_jacobian[second]],
        format="csr",
    )
    sizes = np.asarray(abs(normals).sum(axis=1)).ravel()
    sizes[sizes == 0.0] = 1.0
    sides = np.concatenate([both[first], both[second]])
    place = np.count_nonzero(chosen) + np.flatnonzero(sides)
    return ActiveSet(
        normals=(sparse.diags(1.0 / sizes) @ normals).tocsr(),
        sizes=sizes,
        lowest=np.concatenate(
            [np.where(high, -np.inf, 0.0)[chosen], np.where(sides, 0.0, -np.inf)]
        ),
        highest=np.append(np.where(low, np.inf, 0.0)[chosen], np.full(len(sides), np.inf)),
        both=np.flatnonzero(both),
        first=place[: len(place) // 2],
        second=place[len(place) // 2 :],
    )


def at_bounds(rows: Rows, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return masks (rows,) of rows at their lower, and at their upper bound [-]. Raises nothing."""
    with np.errstate(invalid="ignore"):
        low = np.isfinite(rows.lower) & (
            rows.value - rows.lower <= tolerance * np.maximum(1.0, np.abs(rows.lower))
        )
        high = np.isfinite(rows.upper) & (
            rows.upper - rows.value <= tolerance * np.maximum(1.0, np.abs(rows.upper))
        )
    return low, high


@dataclass(frozen=True, kw_only=True, eq=False)
class Balance:
    """Multipliers y (k,), and the rest (n,) of the gradient; NaN if the program failed."""

    y: np.ndarray
    rest: np.ndarray

    @property
    def largest(self) -> float:
        """Return the largest |component| of the rest."""
        return float(np.max(np.abs(self.rest), initial=0.0))

    @property
    def slope(self) -> float:
        """Return the steepest allowed slope of the objective for |d| <= 1, by duality."""
        return -float(np.sum(np.abs(self.rest)))


def balance(
    active: ActiveSet, gradient: np.ndarray, tolerance: float, free: np.ndarray = _NONE
) -> Balance:
    """Return multipliers that minimise the absolute sum of a gradient's rest (n,) [-].

    If a component exceeds the tolerance, multipliers without such a component are preferred.
    free: numbers of conditions whose multipliers may have any sign. Raises nothing.
    """
    least = _least_sum(active, gradient, free, np.inf)
    if least.largest > tolerance and -least.slope <= len(gradient) * tolerance:
        within = _least_sum(active, gradient, free, _SHARE * tolerance)
        return within if within.largest <= tolerance else least
    return least


def _least_sum(active: ActiveSet, gradient: np.ndarray, free: np.ndarray, most: float) -> Balance:
    k, n = active.normals.shape
    if not n:
        return Balance(y=np.zeros(k), rest=gradient)
    lowest = active.lowest.copy()
    lowest[free] = -np.inf
    identity = sparse.identity(n)
    program = {
        "c": np.append(np.zeros(k), np.ones(2 * n)),
        "A_eq": sparse.hstack([active.normals.T, identity, -identity], format="csc"),
        "b_eq": gradient,
        "bounds": np.column_stack([
            np.append(lowest, np.zeros(2 * n)),
            np.append(active.highest, np.full(2 * n, most)),
        ]),
        "options": PROGRAM,
    }  # fmt: skip
    answer = linprog(**program, method="highs-ds")
    if answer.status == _NUMERICAL:
        answer = linprog(**program, method="highs-ipm")
    if answer.status:
        return Balance(y=np.full(k, math.nan), rest=np.full(n, math.nan))
    y = np.clip(answer.x[:k], lowest, active.highest)
    return Balance(y=y, rest=gradient - active.normals.T @ y)


def falling_piece(active: ActiveSet, gradient: np.ndarray, tolerance: float) -> np.ndarray | None:
    """Return the sides (b,) to fix at 0 so that the objective falls, True for the first [-].

    The binary of a pair is 1 if its first side may rise, 0 if its second may. Each component of
    the direction costs half the tolerance, so that small gradients do not add up.
    Empty: no piece falls by more than the tolerance. None: not known. Raises nothing.
    """
    half = 0.5 * tolerance
    n, pairs = active.normals.shape[1], len(active.both)
    first, second = active.normals[active.first], active.normals[active.second]
    one = sparse.identity(pairs)  # no side rises by more than 1 along |d| <= 1
    rows = sparse.bmat(
        [[active.normals, -active.normals, None], [first, -first, -one], [second, -second, one]],
        format="csc",
    )
    none = np.full(2 * pairs, -np.inf)
    answer = milp(
        np.concatenate([gradient + half, half - gradient, np.zeros(pairs)]),
        constraints=LinearConstraint(
            rows,
            np.append(np.where(active.highest > 0.0, 0.0, -np.inf), none),
            np.concatenate([
                np.where(active.lowest < 0.0, 0.0, np.inf), np.zeros(pairs), np.ones(pairs),
            ]),
        ),
        bounds=Bounds(0.0, 1.0),
        integrality=np.append(np.zeros(2 * n), np.ones(pairs)),
        options=_PIECES,
    )  # fmt: skip
    if answer.mip_dual_bound is not None and answer.mip_dual_bound >= -half:
        return np.zeros(0, dtype=bool)
    return None if answer.x is None else answer.x[2 * n :] < 0.5


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Stationarity of a point.

    residual: largest relative component of the gradient without multipliers
    obstacle: clause on what prevents strong stationarity, or ""
    descent: relative slope of a descent direction (0: none; NaN: not known)
    """

    kind: Stationarity
    residual: float
    obstacle: str = ""
    descent: float = math.nan


def judge(local: LocalModel, active: ActiveSet, tolerance: float) -> Verdict:
    """Return the stationarity of a point; residuals up to the tolerance count as zero."""
    gradient = local.gradient / local.scale
    strong = balance(active, gradient, tolerance)
    if strong.largest <= tolerance:
        return Verdict(kind=Stationarity.STRONG, residual=strong.largest, descent=0.0)
    sides = np.append(active.first, active.second)
    weak = balance(active, gradient, tolerance, sides) if len(sides) else strong
    if math.isnan(strong.largest + weak.largest):
        return Verdict(
            kind=Stationarity.NONE, residual=math.nan, obstacle="the linear program failed"
        )
    if weak.largest > tolerance:
        left = local.variables[int(np.argmax(np.abs(weak.rest)))].name
        return Verdict(
            kind=Stationarity.NONE,
            residual=weak.largest,
            obstacle=f"multipliers leave {weak.largest:.1e} of the gradient in '{left}'",
            descent=weak.slope,
        )
    worst = int(np.argmin(weak.y[sides]))
    pair = local.pairs[active.both[worst % len(active.both)]]
    side = pair.arguments[worst // len(active.both)]
    obstacle = (
        f"the {'second' if side else 'first'} side of '{pair.source.name}' has the multiplier "
        f"{weak.y[sides[worst]] / active.sizes[sides[worst]] * local.scale:.3g}"
    )
    return Verdict(
        kind=Stationarity.WEAK,
        residual=weak.largest,
        obstacle=obstacle,
        descent=_descent(active, gradient, tolerance),
    )


def _descent(active: ActiveSet, gradient: np.ndarray, tolerance: float) -> float:
    """Return the slope of a falling piece, checked by its multipliers.

    0.0 if none, NaN if unknown.
    """
    held = falling_piece(active, gradient, tolerance)
    if held is None:
        return math.nan
    if not len(held):
        return 0.0
    piece = balance(active, gradient, tolerance, np.where(held, active.first, active.second))
    return piece.slope if piece.largest > tolerance else math.nan

"""Multipliers of a point of an MPEC, and the test for a direction that goes down.

By least squares where the active gradients are independent (one candidate, large models too), else sought class by class with linear programs (HiGHS).

    gradient f = sum y gradient g + z + sum nu gradient G + sum mu gradient H,    nu = 0 where G > 0, mu = 0 where H > 0

On biactive pairs (G = 0 = H):  S: nu, mu >= 0;  M: nu, mu > 0 or nu mu = 0;  C: nu mu >= 0;  A: nu >= 0 or mu >= 0;  W: any.
B-stationary: no piece of the linearised problem - every biactive pair decided - has a direction with gradient f' d < 0.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import linprog

from formulations.mpec.certificate.evaluation import LocalModel, Row
from formulations.mpec.certificate.multipliers import least_squares


class Stationarity(Enum):
    """Class of a point by the multipliers it has; the value is its meaning."""

    STRONG = "S: multipliers of all biactive pairs are non-negative"
    MORDUKHOVICH = "M: of each biactive pair both multipliers are positive or one is zero"
    CLARKE = "C: of each biactive pair the multipliers do not have opposite signs"
    ALTERNATIVE = "A: of each biactive pair one multiplier is non-negative"
    WEAK = "W: multipliers exist, but their signs say that the point can be left downhill, or too many pairs are biactive to tell"
    NONE = "no multipliers exist within the tolerance"

    @property
    def letter(self) -> str:
        return "-" if self is Stationarity.NONE else self.value[0]


# Sign choices of one biactive pair: limits of nu and of mu, each ">" (>= 0), "<" (<= 0), "0" or "*" (any).
_CHOICES = {
    Stationarity.STRONG: ((">", ">"),),
    Stationarity.MORDUKHOVICH: ((">", ">"), ("0", "*"), ("*", "0")),
    Stationarity.CLARKE: ((">", ">"), ("<", "<")),
    Stationarity.ALTERNATIVE: ((">", "*"), ("*", ">")),
    Stationarity.WEAK: (("*", "*"),),
}
# Linear programs for one question at most: 2^10 pieces or 3^6 sign patterns of class M where programs are small, fewer where they are large
# (about a second in all).
_MOST_PROGRAMS, _PROGRAMS_TIMES_VARIABLES = 1024, 200_000
# Two sides with the same gradient whose values differ by less are one and the same.
_SAME_SIDE = 1e-12
_LIMITS = {">": (0.0, None), "<": (None, 0.0), "0": (0.0, 0.0), "*": (None, None)}


@dataclass(frozen=True, kw_only=True, eq=False)
class ActiveSet:
    """What is active within a tolerance: gradients of rows and bounds as columns (n, k) with the limits of their multipliers; the pairs
    by which side is zero; scale: largest derivative of the objective, at least 1."""

    gradient: np.ndarray
    normals: sparse.csc_matrix
    limits: tuple[tuple[float | None, float | None], ...]
    first_only: np.ndarray
    second_only: np.ndarray
    both: np.ndarray
    first_normals: sparse.csc_matrix
    second_normals: sparse.csc_matrix
    scale: float


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """kind: the strongest class whose multipliers exist; residual: what they leave of the gradient, or their largest wrong sign (relative);
    least: the smallest multiplier of a biactive pair (0 without pairs, NaN unless it is the only one possible); unique: whether there are
    no other multipliers; descent: slope of a direction that goes down, relative (0: there is none; NaN: not known)."""

    kind: Stationarity
    residual: float
    least: float = math.nan
    unique: bool = False
    descent: float = math.nan


def active_set(local: LocalModel, tolerance: float) -> ActiveSet:
    n = len(local.variables)
    covered = _covered_bounds(local)
    everything = sparse.vstack([local.jacobian, sparse.identity(n, format="csr")], format="csr") if n else local.jacobian
    chosen, limits = [], []
    for number, row in enumerate((*local.rows, *local.bounds)):
        limit = _multiplier_limits(row, tolerance)
        if limit is not None and not (limit == (0.0, None) and number - len(local.rows) in covered):
            chosen.append(number)
            limits.append(limit)
    first = np.array([pair.first <= tolerance for pair in local.pairs], dtype=bool)
    second = np.array([pair.second <= tolerance for pair in local.pairs], dtype=bool)
    return ActiveSet(
        gradient=local.gradient,
        normals=everything[chosen].T.tocsc(),
        limits=tuple(limits),
        first_only=np.flatnonzero(first & ~second),
        second_only=np.flatnonzero(second & ~first),
        both=np.flatnonzero(first & second),
        first_normals=local.first_jacobian.T.tocsc(),
        second_normals=local.second_jacobian.T.tocsc(),
        scale=max(1.0, float(np.max(np.abs(local.gradient), initial=0.0))),
    )


def _covered_bounds(local: LocalModel) -> set[int]:
    """Variables whose lower bound is a side of a pair once more (0 <= x complements ..): counted twice, its multiplier would hide a sign."""
    covered = set()
    for jacobian, name in ((local.first_jacobian, "first"), (local.second_jacobian, "second")):
        alone = np.flatnonzero(np.diff(jacobian.indptr) == 1)
        for k in alone.tolist():
            column, slope = int(jacobian.indices[jacobian.indptr[k]]), float(jacobian.data[jacobian.indptr[k]])
            bound = local.bounds[column]
            if slope > 0.0 and abs((bound.value - bound.lower) * slope - getattr(local.pairs[k], name)) <= _SAME_SIDE:
                covered.add(column)
    return covered


def _multiplier_limits(row: Row, tolerance: float) -> tuple[float | None, float | None] | None:
    """Limits of the multiplier of an active row; None for one that is not active."""
    low = row.value - row.lower <= tolerance * max(1.0, abs(row.lower)) if np.isfinite(row.lower) else False
    high = row.upper - row.value <= tolerance * max(1.0, abs(row.upper)) if np.isfinite(row.upper) else False
    if low and high:
        return None, None
    return (0.0, None) if low else (None, 0.0) if high else None


def multiplier_residual(active: ActiveSet, choice: tuple[tuple[str, str], ...]) -> float:
    """Smallest max-norm of what is left of the gradient with these signs on the biactive pairs, relative to the scale."""
    matrix = sparse.hstack([active.normals, *(normals[:, chosen] for normals, chosen in _columns(active))], format="csr")
    free = [(None, None)] * (len(active.first_only) + len(active.second_only))
    limits = [*active.limits, *free, *(_LIMITS[a] for a, _ in choice), *(_LIMITS[b] for _, b in choice)]
    n, count = matrix.shape
    if n == 0:
        return 0.0
    if count == 0:
        return float(np.max(np.abs(active.gradient))) / active.scale
    # min t with -t <= gradient - matrix y <= t, everything divided by the scale
    ones = sparse.csr_matrix(np.ones((n, 1)))
    system = sparse.vstack([sparse.hstack([matrix, -ones]), sparse.hstack([-matrix, -ones])], format="csr")
    right = np.concatenate([active.gradient, -active.gradient]) / active.scale
    cost = np.zeros(count + 1)
    cost[-1] = 1.0
    answer = linprog(cost, A_ub=system, b_ub=right, bounds=[*limits, (0.0, None)], method="highs")
    return float(answer.fun) if answer.status == 0 else float("inf")


def classify(active: ActiveSet, tolerance: float, given: Stationarity = Stationarity.NONE) -> Verdict:
    """The strongest class whose multipliers exist. given: a class whose multipliers are known to exist.

    Where there is only one candidate it decides; elsewhere classes with too many sign patterns to try are told only where `given` tells them.
    """
    return _only_candidate(active, tolerance) or _by_programs(active, tolerance, given)


def _only_candidate(active: ActiveSet, tolerance: float) -> Verdict | None:
    """What the least-squares multipliers say; None where others may exist."""
    matrix = sparse.hstack([active.normals, *(normals[:, chosen] for normals, chosen in _columns(active))], format="csc")
    found = least_squares(matrix, active.gradient)
    if found is None:
        return None
    residual = float(np.max(np.abs(found.rest), initial=0.0)) / active.scale
    if not residual <= tolerance:
        # no multipliers leave less in the 2-norm; in the largest component others may
        length = float(np.linalg.norm(found.rest)) / active.scale
        if not length > tolerance * math.sqrt(len(found.rest)):
            return None
        # against what is left everything active stays as it is, and the objective falls
        return Verdict(kind=Stationarity.NONE, residual=residual, descent=-(length**2) / residual)
    count, limits = len(active.both), active.limits
    signs = [*limits, *[(None, None)] * (len(found.y) - len(limits) - 2 * count), *[_LIMITS[">"]] * (2 * count)]
    wrong = np.array(
        [max(0.0 if low is None else low - y, 0.0 if high is None else y - high) for y, (low, high) in zip(found.y, signs, strict=True)]
    )
    own = float(np.max(wrong[: len(limits)], initial=0.0)) / active.scale
    nu, mu = np.split(found.y[len(found.y) - 2 * count :], 2)
    kind = class_of(list(zip(nu.tolist(), mu.tolist(), strict=True)), tolerance * active.scale) if own <= tolerance else Stationarity.NONE
    descent = 0.0
    if kind is not Stationarity.STRONG:
        steepest = int(np.argmax(wrong))
        descent = -float(wrong[steepest] / np.max(np.abs(found.leaving(steepest)))) / active.scale
    least = float(np.min([nu, mu])) if count else 0.0
    return Verdict(kind=kind, residual=max(residual, own), least=least, unique=True, descent=descent)


def _columns(active: ActiveSet) -> tuple[tuple[sparse.csc_matrix, np.ndarray], ...]:
    """Gradients of the sides that are zero, in the order of `multiplier_residual`: those of biactive pairs last."""
    first, second = active.first_normals, active.second_normals
    return (first, active.first_only), (second, active.second_only), (first, active.both), (second, active.both)


def _by_programs(active: ActiveSet, tolerance: float, given: Stationarity) -> Verdict:
    count = len(active.both)
    none = 0.0 if not count else math.nan
    weak = multiplier_residual(active, _CHOICES[Stationarity.WEAK] * count)
    if not weak <= tolerance:
        return Verdict(kind=Stationarity.NONE, residual=weak)
    for kind, choices in _CHOICES.items():
        if kind is given:
            return Verdict(kind=kind, residual=weak, least=none)
        if len(choices) ** count > _programs(active):
            continue
        for choice in itertools.product(choices, repeat=count):
            residual = multiplier_residual(active, choice)
            if residual <= tolerance:
                return Verdict(kind=kind, residual=residual, least=none)
    return Verdict(kind=Stationarity.WEAK, residual=weak, least=none)


def class_of(signs: list[tuple[float, float]], limit: float) -> Stationarity:
    """The class of multipliers (nu, mu) of the biactive pairs; what is below the limit counts as zero."""
    met = [kind for kind, choices in _CHOICES.items() if all(any(_fits(pair, choice, limit) for choice in choices) for pair in signs)]
    return met[0]


def _fits(pair: tuple[float, float], choice: tuple[str, str], limit: float) -> bool:
    return all(
        (low is None or number >= low - limit) and (high is None or number <= high + limit)
        for number, sign in zip(pair, choice, strict=True)
        for low, high in (_LIMITS[sign],)
    )


def steepest_piece(active: ActiveSet) -> tuple[float, np.ndarray | None]:
    """(smallest gradient' d over |d| <= 1 and all pieces, relative to the scale; d): B-stationary where it is 0. NaN if there are too many
    pieces to look at all of them and those looked at have no descent."""
    best, direction = 0.0, None
    decisions = [((True,) if same else (True, False)) for same in _same_sides(active)]
    complete = math.prod(len(options) for options in decisions) <= _programs(active)
    count = len(decisions)
    for piece in itertools.product(*decisions) if complete else ((True,) * count, (False,) * count):
        slope, d = _descent(active, np.array(piece, dtype=bool))
        if slope < best:
            best, direction = slope, d
    return (float("nan"), None) if direction is None and not complete else (best, direction)


def _programs(active: ActiveSet) -> int:
    return min(_MOST_PROGRAMS, max(8, _PROGRAMS_TIMES_VARIABLES // max(1, len(active.gradient))))


def _same_sides(active: ActiveSet) -> list[bool]:
    """For each biactive pair, whether both sides have the same gradient (0 <= y complements y >= 0): then its two pieces are one."""
    difference = (active.first_normals - active.second_normals).tocsc()[:, active.both]
    return [float(np.max(np.abs(difference[:, k].data), initial=0.0)) <= 1e-12 for k in range(len(active.both))]


def _descent(active: ActiveSet, first_held: np.ndarray) -> tuple[float, np.ndarray | None]:
    """min gradient' d: held sides stay 0, the other sides of biactive pairs do not go below 0."""
    n = len(active.gradient)
    if n == 0:
        return 0.0, None
    held_first = np.concatenate([active.first_only, active.both[first_held]])
    held_second = np.concatenate([active.second_only, active.both[~first_held]])
    equal = [active.first_normals[:, held_first].T, active.second_normals[:, held_second].T]
    rising = [active.first_normals[:, active.both[~first_held]].T, active.second_normals[:, active.both[first_held]].T]
    kinds = np.array([0 if a is None and b is None else 1 if b is None else -1 for a, b in active.limits], dtype=int)
    rows = active.normals.T.tocsr()
    equal.append(rows[kinds == 0])
    rising += [rows[kinds == 1], -rows[kinds == -1]]
    a_eq, a_ub = sparse.vstack(equal, format="csr"), -sparse.vstack(rising, format="csr")
    answer = linprog(
        active.gradient / active.scale,
        A_ub=a_ub if a_ub.shape[0] else None,
        b_ub=np.zeros(a_ub.shape[0]) if a_ub.shape[0] else None,
        A_eq=a_eq if a_eq.shape[0] else None,
        b_eq=np.zeros(a_eq.shape[0]) if a_eq.shape[0] else None,
        bounds=(-1.0, 1.0),
        method="highs",
    )
    return (float(answer.fun), answer.x) if answer.status == 0 else (0.0, None)

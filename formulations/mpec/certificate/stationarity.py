"""Multipliers of a point of an MPEC, and the test for a direction that goes down.

By least squares where the active gradients are independent (one candidate) or the signs come out right; else class by class with linear programs (HiGHS).

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
from scipy.optimize import Bounds, LinearConstraint, linprog, milp

from formulations.mpec.certificate.active import ActiveSet
from formulations.mpec.certificate.multipliers import least_squares, signed_least_squares


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
# Of a direction that leaves everything active as it is: products with unit-size gradients that count as 0, as with HiGHS.
_ACROSS = 1e-7
# Sum of multipliers (of the gradient divided by its scale) up to which least squares must exclude them before they say that there are none.
_LARGEST = 1e9
# Share of the tolerance that a linear program may use: HiGHS holds a row to 1e-7 only.
_SHARE = 0.98
_LIMITS = {">": (0.0, None), "<": (None, 0.0), "0": (0.0, 0.0), "*": (None, None)}


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


def multiplier_residual(active: ActiveSet, choice: tuple[tuple[str, str], ...]) -> float:
    """Smallest max-norm of what is left of the gradient with these signs on the biactive pairs, relative to the scale."""
    matrix, limits = active.matrix, _signed(active, choice)
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


def _signed(active: ActiveSet, choice: tuple[tuple[str, str], ...]) -> list[tuple[float | None, float | None]]:
    """Limits of the multipliers of these columns, with these signs on the biactive pairs."""
    free = [(None, None)] * (len(active.first_only) + len(active.second_only))
    return [*active.limits, *free, *(_LIMITS[a] for a, _ in choice), *(_LIMITS[b] for _, b in choice)]


def _numbers(limits: list[tuple[float | None, float | None]]) -> tuple[np.ndarray, np.ndarray]:
    low, high = zip(*limits, strict=True) if limits else ((), ())
    return np.array([-np.inf if x is None else x for x in low]), np.array([np.inf if x is None else x for x in high])


def residual_within(active: ActiveSet, choice: tuple[tuple[str, str], ...], tolerance: float) -> float | None:
    """What some multipliers with these signs leave of the gradient (largest component, relative to the scale), if at most the tolerance.

    Tolerances on both sides of each row are a far easier program than the smallest residual (`multiplier_residual`), whose variable is in all rows.
    """
    matrix, (low, high), gradient = active.matrix, _numbers(_signed(active, choice)), active.gradient / active.scale
    if not all(matrix.shape):
        residual = float(np.max(np.abs(gradient), initial=0.0))
        return residual if residual <= tolerance else None
    rows = LinearConstraint(matrix, gradient - _SHARE * tolerance, gradient + _SHARE * tolerance)
    answer = milp(np.zeros(matrix.shape[1]), constraints=rows, bounds=Bounds(low, high))
    if answer.x is None:
        return None
    y = np.clip(answer.x, low, high)
    used = np.flatnonzero(y)
    residual = float(np.max(np.abs(gradient - matrix @ y)))
    better = signed_least_squares(matrix[:, used], gradient, low[used], high[used], 0.0)  # a program stops at the tolerance
    residual = residual if better is None else min(residual, float(np.max(np.abs(better.rest))))
    return residual if residual <= tolerance else None


def classify(active: ActiveSet, tolerance: float, given: Stationarity = Stationarity.NONE) -> Verdict:
    """The strongest class whose multipliers exist. given: a class whose multipliers are known to exist.

    Where there is only one candidate it decides; elsewhere classes with too many sign patterns to try are told only where `given` tells them.
    """
    return _only_candidate(active, tolerance) or _one_of_many(active, tolerance) or _by_programs(active, tolerance, given)


def _only_candidate(active: ActiveSet, tolerance: float) -> Verdict | None:
    """What the least-squares multipliers say; None where others may exist."""
    found = least_squares(active.matrix, active.gradient)
    if found is None:
        return None
    residual = float(np.max(np.abs(found.rest), initial=0.0)) / active.scale
    if not residual <= tolerance:
        return _none_leave_less(found.rest / active.scale, tolerance)
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


def _one_of_many(active: ActiveSet, tolerance: float) -> Verdict | None:
    """Class S, or that there are no multipliers, where least squares with dependent gradients show it; else None."""
    count = len(active.both)
    low, high = _numbers(_signed(active, _CHOICES[Stationarity.STRONG] * count))
    found = signed_least_squares(active.matrix, active.gradient / active.scale, low, high, tolerance)
    if found is None:
        return None
    residual = float(np.max(np.abs(found.rest), initial=0.0))
    if residual <= tolerance:
        return Verdict(kind=Stationarity.STRONG, residual=residual, least=math.nan if count else 0.0)
    most = float(np.max(np.abs(found.least), initial=0.0))
    return _none_leave_less(found.least, tolerance, found.across) if found.across <= _ACROSS * most else None


def _none_leave_less(rest: np.ndarray, tolerance: float, across: float = 0.0) -> Verdict | None:
    """That there are no multipliers, by what the best of any sign leave in the 2-norm; None where it does not show that.

    It is orthogonal to all active gradients A up to |A' rest|_max = across, so that
    |rest|^2 <= rest' (gradient - A y) + across |y - best|_1 <= |rest|_1 |gradient - A y|_max + across |y - best|_1 for every y.
    """
    square = float(rest @ rest)
    if not square > tolerance * float(np.sum(np.abs(rest))) + _LARGEST * across:
        return None
    most = float(np.max(np.abs(rest)))
    # against what is left everything active stays as it is, and the objective falls
    return Verdict(kind=Stationarity.NONE, residual=most, descent=-square / most)


def _by_programs(active: ActiveSet, tolerance: float, given: Stationarity) -> Verdict:
    count = len(active.both)
    none = 0.0 if not count else math.nan
    strong = residual_within(active, _CHOICES[Stationarity.STRONG] * count, tolerance)
    if strong is not None:
        return Verdict(kind=Stationarity.STRONG, residual=strong, least=none)
    any_signs = _CHOICES[Stationarity.WEAK] * count
    weak = residual_within(active, any_signs, tolerance) if count else None
    weak = multiplier_residual(active, any_signs) if weak is None else weak
    if not weak <= tolerance:
        return Verdict(kind=Stationarity.NONE, residual=weak)
    if not count:
        return Verdict(kind=Stationarity.STRONG, residual=weak, least=none)
    for kind, choices in itertools.islice(_CHOICES.items(), 1, None):  # strong ones were asked for
        if kind is given:
            return Verdict(kind=kind, residual=weak, least=none)
        if len(choices) ** count > _programs(active):
            continue
        for choice in itertools.product(choices, repeat=count):
            residual = residual_within(active, choice, tolerance)
            if residual is not None:
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
    pieces to look at all of them, or a program failed, and those looked at have no descent."""
    best, direction = 0.0, None
    decisions = [((True,) if same else (True, False)) for same in _same_sides(active)]
    complete = math.prod(len(options) for options in decisions) <= _programs(active)
    count = len(decisions)
    for piece in itertools.product(*decisions) if complete else ((True,) * count, (False,) * count):
        slope, d = _descent(active, np.array(piece, dtype=bool))
        complete = complete and not math.isnan(slope)
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
    """min gradient' d: held sides stay 0, the other sides of biactive pairs do not go below 0. NaN if the program, which has d = 0, fails."""
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
    return (float(answer.fun), answer.x) if answer.status == 0 else (math.nan, None)

"""What is active at a point, within a tolerance.

The strongest class of stationarity that its multipliers show, and whether a direction goes down.

    gradient f = sum y gradient g + z + sum nu gradient G + sum mu gradient H,
        nu = 0 where G > 0, mu = 0 where H > 0

On biactive pairs (G = 0 = H): S: nu, mu >= 0; M: nu, mu > 0 or nu mu = 0; C: nu mu >= 0; A: nu >= 0
or mu >= 0; W: any.

Multipliers are found by least squares where the active gradients are independent (one candidate) or
the signs come out right; else by projection onto the cone of the active gradients, sign pattern by
sign pattern, and by linear programs for what that leaves open.

B-stationary: no piece of the linearised problem - every biactive pair decided - has a direction
with gradient f' d < 0. Where programs are small all pieces are looked at, for the steepest slope.
Where they are large a tree of decisions is searched: a pair that is not decided yet asks only that
neither side goes below 0, which holds in both its pieces. If no direction goes down there, none
does in any piece below; if one does and happens to leave one side of each pair at 0, it lies in a
piece; else the pair that both sides of leave is decided.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import linprog

from formulations.mpec.certificate.derivatives import LocalModel, Rows
from formulations.mpec.certificate.multipliers import (
    MultiplierDecision,
    column_lengths,
    decide,
    excludes,
    least_residual,
    least_squares,
    multipliers_within,
    signed_least_squares,
)


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
        """S, M, C, A, W, or - for none."""
        return "-" if self is Stationarity.NONE else self.value[0]


# Limits of nu and of mu of one pair: ">" (>= 0), "<" (<= 0), "0" or "*" (any).
Signs = tuple[str, str]
ANY: Signs = ("*", "*")
CHOICES: dict[Stationarity, tuple[Signs, ...]] = {
    Stationarity.STRONG: ((">", ">"),),
    Stationarity.MORDUKHOVICH: ((">", ">"), ("0", "*"), ("*", "0")),
    Stationarity.CLARKE: ((">", ">"), ("<", "<")),
    Stationarity.ALTERNATIVE: ((">", "*"), ("*", ">")),
    Stationarity.WEAK: (ANY,),
}
_LIMITS = {">": (0.0, np.inf), "<": (-np.inf, 0.0), "0": (0.0, 0.0), "*": (-np.inf, np.inf)}


def class_of(pairs: Sequence[tuple[float, float]], limit: float) -> Stationarity:
    """The class of multipliers (nu, mu) of the biactive pairs.

    What is below the limit counts as zero.
    """
    return next(
        kind
        for kind, choices in CHOICES.items()
        if all(wrong_by(pair, choices) <= limit for pair in pairs)
    )


def wrong_by(pair: tuple[float, float], choices: tuple[Signs, ...]) -> float:
    """By how much the multipliers of a pair miss the nearest of these signs."""
    return min(
        max(_beyond(number, *_LIMITS[sign]) for number, sign in zip(pair, signs, strict=True))
        for signs in choices
    )


def limits(active: ActiveSet, signs: Sequence[Signs]) -> tuple[np.ndarray, np.ndarray]:
    """Limits of the multipliers of the columns of `active.matrix`, with these signs on the biactive pairs.

    Raises nothing.

    Returns
    -------
    lowest, highest (columns,), each 0 or infinite [objective per row]
    """
    sides = [_LIMITS["*"]] * (len(active.first_only) + len(active.second_only))
    sides += [_LIMITS[first] for first, _ in signs] + [_LIMITS[second] for _, second in signs]
    low, high = np.array(sides, dtype=float).reshape(-1, 2).T
    return np.append(active.lowest, low), np.append(active.highest, high)


def pairs_of(active: ActiveSet, y: np.ndarray) -> list[tuple[float, float]]:
    """Multipliers nu, mu of the biactive pairs among those of all columns of `active.matrix`.

    Raises nothing.

    Parameters
    ----------
    active : what is active
    y : (columns,) multipliers [objective per row]
    """
    nu, mu = np.split(y[len(y) - 2 * len(active.both) :], 2)
    return list(zip(nu.tolist(), mu.tolist(), strict=True))


def _beyond(number: float, low: float, high: float) -> float:
    return max(0.0, low - number, number - high)


# Two sides with the same gradient whose values differ by less are one and the same.
_SAME_SIDE = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class ActiveSet:
    """What is active within a tolerance.

    gradient (n,): of the minimised objective; normals (n, k): gradients of rows and bounds as
        columns; lowest, highest (k,): limits of their
    multipliers, each 0 or infinite
    first_only, second_only, both: pairs by which side is zero; first_normals, second_normals (n,
        pairs): gradients of the sides
    scale: largest derivative of the objective, at least its size nearby
    """

    gradient: np.ndarray
    normals: sparse.csc_matrix
    lowest: np.ndarray
    highest: np.ndarray
    first_only: np.ndarray
    second_only: np.ndarray
    both: np.ndarray
    first_normals: sparse.csc_matrix
    second_normals: sparse.csc_matrix
    scale: float

    @property
    def matrix(self) -> sparse.csc_matrix:
        """Active gradients as columns: of rows and bounds, of sides that are zero alone, of the first and of the second sides of biactive pairs."""
        first, second = self.first_normals, self.second_normals
        sides = (
            first[:, self.first_only],
            second[:, self.second_only],
            first[:, self.both],
            second[:, self.both],
        )
        return sparse.hstack([self.normals, *sides], format="csc")


def active_set(local: LocalModel, tolerance: float) -> ActiveSet:
    """The rows, bounds and sides of pairs within the tolerance of their limits."""
    low, high = at_bounds(local.rows, tolerance)
    covered = _covered_bounds(local)
    low[covered] &= high[covered]
    chosen = low | high
    first, second = local.sides <= tolerance
    return ActiveSet(
        gradient=local.gradient,
        normals=local.matrix[np.flatnonzero(chosen)].T.tocsc(),
        lowest=np.where(high, -np.inf, 0.0)[chosen],
        highest=np.where(low, np.inf, 0.0)[chosen],
        first_only=np.flatnonzero(first & ~second),
        second_only=np.flatnonzero(second & ~first),
        both=np.flatnonzero(first & second),
        first_normals=local.first_jacobian.T.tocsc(),
        second_normals=local.second_jacobian.T.tocsc(),
        scale=max(local.slope_nearby, float(np.max(np.abs(local.gradient), initial=0.0))),
    )


def _covered_bounds(local: LocalModel) -> list[int]:
    """Rows of variables whose lower bound is a side of a pair once more (0 <= x complements ..): counted twice, its multiplier would hide a sign."""
    covered, begin = [], local.jacobian.shape[0]
    distance = local.rows.value - local.rows.lower
    for jacobian, side in zip(
        (local.first_jacobian, local.second_jacobian), local.sides, strict=True
    ):
        alone = np.flatnonzero(np.diff(jacobian.indptr) == 1)
        for k in alone.tolist():
            row, slope = (
                begin + int(jacobian.indices[jacobian.indptr[k]]),
                float(jacobian.data[jacobian.indptr[k]]),
            )
            if slope > 0.0 and abs(distance[row] * slope - side[k]) <= _SAME_SIDE:
                covered.append(row)
    return covered


def at_bounds(rows: Rows, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Masks (rows,) of those within the tolerance of their lower, and of their upper bound [-].

    Raises nothing.
    """
    with np.errstate(invalid="ignore"):
        low = np.isfinite(rows.lower) & (
            rows.value - rows.lower <= tolerance * np.maximum(1.0, np.abs(rows.lower))
        )
        high = np.isfinite(rows.upper) & (
            rows.upper - rows.value <= tolerance * np.maximum(1.0, np.abs(rows.upper))
        )
    return low, high


# Linear programs for one question at most: 2^10 pieces where programs are small, fewer where they
# are large.
_MOST = 1024
_TIMES_VARIABLES = 200_000
# Up to this many variables all pieces are looked at; nodes of a tree that is too large to be
# searched to its end.
_SMALL = 400
_FEW = 12
# A side that rises by less along a direction of largest component 1 stays where it is (HiGHS holds
# a row to 1e-7).
_STAYS = 1e-7
_UNDECIDED = 0
_FIRST = 1
_SECOND = 2
_SIGNS = {_UNDECIDED: (">", ">"), _FIRST: ("*", ">"), _SECOND: (">", "*")}


def affordable(active: ActiveSet, choices: int) -> int:
    """How many nodes of a tree with so many choices for each biactive pair may be looked at: all where that costs little."""
    leaves = choices ** len(active.both)
    most = min(_MOST, max(8, _TIMES_VARIABLES // max(1, len(active.gradient))))
    return 2 * leaves if leaves <= most else _FEW


def steepest_piece(active: ActiveSet, tolerance: float) -> tuple[float, np.ndarray | None]:
    """The steepest slope over all pieces: B-stationary where it is 0.

    Raises nothing: NaN where a program fails.

    Parameters
    ----------
    active : what is active
    tolerance : slopes of less do not count

    Returns
    -------
    smallest gradient' d found over |d| <= 1, relative to the scale, and d (n,) [units of the
        variables]; NaN if there are too many pieces to look at all of
    them, or a program failed, and those looked at have no descent beyond the tolerance
    """
    if len(active.gradient) <= _SMALL and 2 ** len(active.both) <= _MOST:
        return _every_piece(active)
    stack, complete = [np.full(len(active.both), _UNDECIDED)], True
    for _ in range(affordable(active, 2)):
        if not stack:
            break
        node = stack.pop()
        slope, direction = _down(active, node, tolerance)
        if direction is None:
            complete = complete and not math.isnan(slope)
            continue
        sides = (side[:, active.both] for side in (active.first_normals, active.second_normals))
        first, second = (side.T @ direction / column_lengths(side) for side in sides)
        both_rise = np.where(node == _UNDECIDED, np.minimum(first, second), 0.0)
        pair = int(np.argmax(both_rise)) if len(node) else 0
        if not len(node) or both_rise[pair] <= _STAYS:
            return slope, direction
        for decision in (
            (_FIRST, _SECOND) if first[pair] > second[pair] else (_SECOND, _FIRST)
        ):  # the side that rises less is held first
            child = node.copy()
            child[pair] = decision
            stack.append(child)
    return (0.0, None) if complete and not stack else (math.nan, None)


def _down(active: ActiveSet, node: np.ndarray, tolerance: float) -> tuple[float, np.ndarray | None]:
    """(slope, a direction that goes down by more than the tolerance, or None): below this node.

    NaN and None where it is not known.
    """
    found = decide(
        active.matrix,
        active.gradient / active.scale,
        *limits(active, [_SIGNS[int(k)] for k in node]),
        tolerance,
    )
    if found.polar is not None:
        return found.slope, -found.polar / np.max(np.abs(found.polar))
    # no direction falls by more than what multipliers leave in all
    if found.exists and found.total <= tolerance:
        return 0.0, None
    slope, direction = steepest_direction(active, node == _FIRST, node == _SECOND)
    return (slope, direction if slope < -tolerance else None)


def steepest_direction(
    active: ActiveSet, first_held: np.ndarray, second_held: np.ndarray
) -> tuple[float, np.ndarray | None]:
    """Least gradient' d over |d| <= 1, relative to the scale.

    Raises ValueError for numbers that are not finite; NaN where the program fails.

    Parameters
    ----------
    active : what is active
    first_held, second_held : (biactive pairs,) masks of sides that stay 0; the other sides do not
        go below 0 [-]

    Returns
    -------
    slope, and d (n,); NaN and None if the program, which has d = 0, fails
    """
    n = len(active.gradient)
    if n == 0:
        return 0.0, None
    held_first = np.concatenate([active.first_only, active.both[first_held]])
    held_second = np.concatenate([active.second_only, active.both[second_held]])
    equal = [active.first_normals[:, held_first].T, active.second_normals[:, held_second].T]
    rising = [
        active.first_normals[:, active.both[~first_held]].T,
        active.second_normals[:, active.both[~second_held]].T,
    ]
    rows, is_low, is_high = active.normals.T.tocsr(), active.highest > 0.0, active.lowest < 0.0
    equal.append(rows[is_low & is_high])
    rising += [rows[is_low & ~is_high], -rows[is_high & ~is_low]]
    a_eq, a_ub = sparse.vstack(equal, format="csr"), -sparse.vstack(rising, format="csr")
    answer = linprog(
        active.gradient / active.scale,
        A_ub=a_ub,
        b_ub=np.zeros(a_ub.shape[0]),
        A_eq=a_eq,
        b_eq=np.zeros(a_eq.shape[0]),
        bounds=(-1.0, 1.0),
        method="highs",
    )
    return (float(answer.fun), answer.x) if answer.status == 0 else (np.nan, None)


def _every_piece(active: ActiveSet) -> tuple[float, np.ndarray | None]:
    best, direction, complete = 0.0, None, True
    for piece in itertools.product(
        *((True,) if same else (True, False) for same in _same_sides(active))
    ):
        held = np.array(piece, dtype=bool)
        slope, d = steepest_direction(active, held, ~held)
        complete = complete and not math.isnan(slope)
        if slope < best:
            best, direction = slope, d
    return (math.nan, None) if direction is None and not complete else (best, direction)


def _same_sides(active: ActiveSet) -> list[bool]:
    """For each biactive pair, whether both sides have the same gradient (0 <= y complements y >= 0): then its two pieces are one."""
    difference = (active.first_normals - active.second_normals).tocsc()[:, active.both]
    return [
        float(np.max(np.abs(difference[:, k].data), initial=0.0)) <= 1e-12
        for k in range(len(active.both))
    ]


@dataclass(frozen=True, kw_only=True)
class StationarityVerdict:
    """What the multipliers of a point say.

    kind: the strongest class whose multipliers exist; residual: what they leave of the gradient, or
        their largest wrong sign (relative)
    least: the smallest multiplier of a biactive pair (0 without pairs, NaN unless it is the only
        one possible); unique: whether there are no other
    multipliers; descent: slope of a direction that goes down, relative (0: there is none; NaN: not
        known)
    """

    kind: Stationarity
    residual: float
    least: float = math.nan
    unique: bool = False
    descent: float = math.nan


def classify(
    active: ActiveSet, tolerance: float, given: Stationarity = Stationarity.NONE
) -> StationarityVerdict:
    """The strongest class whose multipliers exist.

    Where there is only one candidate it decides; elsewhere classes with too many sign patterns to
    try are known only where `given` or the multipliers found show them.

    Parameters
    ----------
    active : what is active
    tolerance : largest component that multipliers may leave
    given : a class whose multipliers are known to exist
    """
    return (
        _only_candidate(active, tolerance)
        or _one_of_many(active, tolerance)
        or _by_signs(active, tolerance, given)
    )


def _only_candidate(active: ActiveSet, tolerance: float) -> StationarityVerdict | None:
    """What the least-squares multipliers say; None where others may exist."""
    found = least_squares(active.matrix, active.gradient)
    if found is None:
        return None
    residual = float(np.max(np.abs(found.rest), initial=0.0)) / active.scale
    if not residual <= tolerance:
        return _none_leave_less(active, found.rest / active.scale, 0.0, tolerance)
    count = len(active.both)
    low, high = limits(active, CHOICES[Stationarity.STRONG] * count)
    wrong = np.maximum(0.0, np.maximum(low - found.y, found.y - high))
    own = float(np.max(wrong[: len(active.lowest)], initial=0.0)) / active.scale
    pairs = pairs_of(active, found.y)
    kind = class_of(pairs, tolerance * active.scale) if own <= tolerance else Stationarity.NONE
    descent = 0.0
    if kind is not Stationarity.STRONG:
        steepest = int(np.argmax(wrong))
        descent = -float(wrong[steepest] / np.max(np.abs(found.leaving(steepest)))) / active.scale
    least = float(np.min(pairs)) if count else 0.0
    return StationarityVerdict(
        kind=kind, residual=max(residual, own), least=least, unique=True, descent=descent
    )


def _one_of_many(active: ActiveSet, tolerance: float) -> StationarityVerdict | None:
    """Class S, or that there are no multipliers, where least squares with dependent gradients show it; else None."""
    count = len(active.both)
    low, high = limits(active, CHOICES[Stationarity.STRONG] * count)
    found = signed_least_squares(
        active.matrix, active.gradient / active.scale, low, high, tolerance
    )
    if found is None:
        return None
    residual = float(np.max(np.abs(found.rest), initial=0.0))
    if residual <= tolerance:
        return StationarityVerdict(
            kind=Stationarity.STRONG, residual=residual, least=math.nan if count else 0.0
        )
    return _none_leave_less(active, found.least, found.across, tolerance)


def _none_leave_less(
    active: ActiveSet, rest: np.ndarray, across: float, tolerance: float
) -> StationarityVerdict | None:
    """That there are no multipliers, by what the best of any sign leave in the 2-norm.

    None where it does not show that.
    """
    if not excludes(active.gradient / active.scale, rest, across, tolerance):
        return None
    most = float(np.max(np.abs(rest)))
    # against what is left everything active stays as it is, and the objective falls
    return StationarityVerdict(
        kind=Stationarity.NONE, residual=most, descent=-float(rest @ rest) / most
    )


def _by_signs(active: ActiveSet, tolerance: float, given: Stationarity) -> StationarityVerdict:
    count = len(active.both)
    none = 0.0 if not count else math.nan
    any_signs, question = [ANY] * count, (active.matrix, active.gradient / active.scale)
    weak = decide(*question, *limits(active, any_signs), tolerance)
    if weak.exists is None:
        strong = _with(active, CHOICES[Stationarity.STRONG] * count, tolerance)
        if strong.exists:
            return StationarityVerdict(
                kind=Stationarity.STRONG, residual=strong.residual, least=none
            )
        weak = (
            multipliers_within(*question, *limits(active, any_signs), tolerance)
            if count
            else strong
        )
        weak = (
            weak
            if weak.exists
            else least_residual(*question, *limits(active, any_signs), tolerance)
        )
    if not weak.exists:
        return StationarityVerdict(
            kind=Stationarity.NONE,
            residual=weak.residual,
            descent=math.nan if weak.polar is None else weak.slope,
        )
    known = {tuple(any_signs): weak}
    pairs = pairs_of(active, weak.y)
    own = class_of(pairs, tolerance)
    for kind, choices in CHOICES.items():
        if kind is own:
            return StationarityVerdict(
                kind=kind,
                residual=max(weak.residual, *(wrong_by(pair, choices) for pair in pairs), 0.0),
                least=none,
            )
        if kind is given:
            return StationarityVerdict(kind=kind, residual=weak.residual, least=none)
        residual = _pattern(active, kind, tolerance, known)
        if residual is not None:
            return StationarityVerdict(kind=kind, residual=residual, least=none)
    raise AssertionError("every point with multipliers is weakly stationary")


def _pattern(
    active: ActiveSet,
    kind: Stationarity,
    tolerance: float,
    known: dict[tuple[Signs, ...], MultiplierDecision],
) -> float | None:
    """Residual of multipliers with the signs of a class, if there are some: pair after pair is decided, the one that is most wrong first.

    known: what was decided for other classes
    """
    choices = CHOICES[kind]
    stack: list[tuple[Signs, ...]] = [
        (choices[0] if len(choices) == 1 else ANY,) * len(active.both)
    ]
    for _ in range(affordable(active, len(choices))):
        if not stack:
            break
        signs = stack.pop()
        found = known[signs] = known.get(signs) or _with(active, signs, tolerance)
        if not found.exists:
            continue
        wrong = [wrong_by(pair, choices) for pair in pairs_of(active, found.y)]
        pair = int(np.argmax(wrong))
        if wrong[pair] <= tolerance or signs[pair] is not ANY:
            return max(found.residual, wrong[pair])
        stack += [(*signs[:pair], choice, *signs[pair + 1 :]) for choice in reversed(choices)]
    return None


def _with(active: ActiveSet, signs: Sequence[Signs], tolerance: float) -> MultiplierDecision:
    """Whether there are multipliers with these signs on the biactive pairs."""
    question = (active.matrix, active.gradient / active.scale, *limits(active, signs), tolerance)
    found = decide(*question)
    return multipliers_within(*question) if found.exists is None else found

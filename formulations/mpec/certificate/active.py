"""What is active at a point, within a tolerance, and which signs its multipliers may have in each class of stationarity.

On biactive pairs (G = 0 = H):  S: nu, mu >= 0;  M: nu, mu > 0 or nu mu = 0;  C: nu mu >= 0;  A: nu >= 0 or mu >= 0;  W: any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import scipy.sparse as sparse

from formulations.mpec.certificate.derivatives import ConstraintRow, LocalModel


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
    """The class of multipliers (nu, mu) of the biactive pairs; what is below the limit counts as zero."""
    return next(kind for kind, choices in CHOICES.items() if all(wrong_by(pair, choices) <= limit for pair in pairs))


def wrong_by(pair: tuple[float, float], choices: tuple[Signs, ...]) -> float:
    """By how much the multipliers of a pair miss the nearest of these signs."""
    return min(max(_beyond(number, *_LIMITS[sign]) for number, sign in zip(pair, signs, strict=True)) for signs in choices)


def limits(active: ActiveSet, signs: Sequence[Signs]) -> tuple[np.ndarray, np.ndarray]:
    """Limits of the multipliers of the columns of `active.matrix`, with these signs on the biactive pairs.

    Raises nothing.

    Returns
    -------
    lowest, highest (columns,), each 0 or infinite [objective per row]
    """
    own = [(-np.inf if low is None else low, np.inf if high is None else high) for low, high in active.limits]
    own += [_LIMITS["*"]] * (len(active.first_only) + len(active.second_only))
    own += [_LIMITS[first] for first, _ in signs] + [_LIMITS[second] for _, second in signs]
    low, high = zip(*own, strict=True) if own else ((), ())
    return np.array(low, dtype=float), np.array(high, dtype=float)


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

    gradient (n,): of the minimised objective; normals (n, k): gradients of rows and bounds as columns; limits: of their multipliers
    first_only, second_only, both: pairs by which side is zero; first_normals, second_normals (n, pairs): gradients of the sides
    scale: largest derivative of the objective, at least its size nearby
    """

    gradient: np.ndarray
    normals: sparse.csc_matrix
    limits: tuple[tuple[float | None, float | None], ...]
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
        sides = (first[:, self.first_only], second[:, self.second_only], first[:, self.both], second[:, self.both])
        return sparse.hstack([self.normals, *sides], format="csc")


def active_set(local: LocalModel, tolerance: float) -> ActiveSet:
    """The rows, bounds and sides of pairs within the tolerance of their limits."""
    covered = _covered_bounds(local)
    everything = sparse.vstack([local.jacobian, sparse.identity(len(local.variables), format="csr")], format="csr")
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
        scale=max(local.slope_nearby, float(np.max(np.abs(local.gradient), initial=0.0))),
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


def _multiplier_limits(row: ConstraintRow, tolerance: float) -> tuple[float | None, float | None] | None:
    """Limits of the multiplier of an active row; None for one that is not active."""
    low = row.value - row.lower <= tolerance * max(1.0, abs(row.lower)) if np.isfinite(row.lower) else False
    high = row.upper - row.value <= tolerance * max(1.0, abs(row.upper)) if np.isfinite(row.upper) else False
    if low and high:
        return None, None
    return (0.0, None) if low else (None, 0.0) if high else None

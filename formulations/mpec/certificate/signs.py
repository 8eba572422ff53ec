"""Classes of stationarity: which signs the multipliers of biactive pairs may have.

On biactive pairs (G = 0 = H):  S: nu, mu >= 0;  M: nu, mu > 0 or nu mu = 0;  C: nu mu >= 0;  A: nu >= 0 or mu >= 0;  W: any.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np

from formulations.mpec.certificate.active import ActiveSet


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
    """(lowest, highest) multipliers of the columns of `active.matrix`, with these signs on the biactive pairs."""
    own = [(-np.inf if low is None else low, np.inf if high is None else high) for low, high in active.limits]
    own += [_LIMITS["*"]] * (len(active.first_only) + len(active.second_only))
    own += [_LIMITS[first] for first, _ in signs] + [_LIMITS[second] for _, second in signs]
    low, high = zip(*own, strict=True) if own else ((), ())
    return np.array(low, dtype=float), np.array(high, dtype=float)


def pairs_of(active: ActiveSet, y: np.ndarray) -> list[tuple[float, float]]:
    """(nu, mu) of the biactive pairs among the multipliers of the columns of `active.matrix`."""
    nu, mu = np.split(y[len(y) - 2 * len(active.both) :], 2)
    return list(zip(nu.tolist(), mu.tolist(), strict=True))


def _beyond(number: float, low: float, high: float) -> float:
    return max(0.0, low - number, number - high)

"""What the multipliers of the fixed modes say about the contact problem itself.

With G = lam >= 0 and H = lam - k phi >= 0 and one of them zero at each step, the problem with fixed modes has multipliers s_G and s_H per
newton (L = ... - s_G G - s_H H). Where one of G and H is positive its multiplier is zero and the other may have any sign. Where both are zero (a
biactive pair: the bodies touch without pressing) the signs decide:

    S  both >= 0: no mode of these pairs is cheaper to first order       M  both > 0, or one of them zero
    C  the product is >= 0      A  one of them >= 0      W  neither
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_ZERO = 1e-6  # part of the largest multiplier that counts as zero


@dataclass(frozen=True, kw_only=True)
class Stationarity:
    """letter: the strongest class that holds; biactive: number of pairs; least: their smallest multiplier (0 without pairs)."""

    letter: str
    biactive: int
    least: float

    @property
    def sentence(self) -> str:
        if not self.biactive:
            return "S-stationary: no contact touches without pressing."
        pairs = "pair touches" if self.biactive == 1 else "pairs touch"
        return f"{self.letter}-stationary: {self.biactive} {pairs} without pressing, with multipliers of at least {self.least:.3g}."


def classify(of_force: np.ndarray, of_separation: np.ndarray, biactive: np.ndarray) -> Stationarity:
    """of_force, of_separation: multipliers s_G, s_H (steps, nc) per newton; biactive (steps, nc): whether both G and H are zero."""
    pairs = np.stack([of_force[biactive], of_separation[biactive]])
    if not pairs.size:
        return Stationarity(letter="S", biactive=0, least=0.0)
    zero = _ZERO * max(1.0, float(np.abs(np.stack([of_force, of_separation])).max()))
    low, high = pairs.min(axis=0), pairs.max(axis=0)
    is_zero = (np.abs(pairs) <= zero).any(axis=0)
    classes = (("S", low >= -zero), ("M", (low > zero) | is_zero), ("C", (low * high >= 0.0) | is_zero), ("A", high >= -zero))
    letter = next((letter for letter, holds in classes if holds.all()), "W")
    return Stationarity(letter=letter, biactive=int(biactive.sum()), least=float(low.min()))

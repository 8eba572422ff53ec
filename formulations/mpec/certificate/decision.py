"""Do multipliers with given signs leave at most a tolerance of the gradient? Both answers come with what proves them.

Yes: multipliers y. No: a vector p with p' gradient > tolerance |p|_1 that all conditions allow (-p points down, and no y makes up for it):

    |p|_1 |gradient - A y|_max >= p' (gradient - A y) >= p' gradient - across |y|_1        across: by how much p breaks a condition, at most

The projection of the gradient (`projection`) gives both. Where the largest component of its rest is above the tolerance and its p proves nothing
yet, components are weighed by what was left of them (Lawson's way to the smallest largest residual: University of California, 1961).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse

from formulations.mpec.certificate.projection import project

# Sum of multipliers (of the gradient divided by its scale) up to which they are excluded before it is said that there are none, by a vector that
# breaks no condition by more than this share of its largest component. (A linear program of HiGHS excludes with 1e-7.)
_LARGEST, _ACROSS = 1e6, 1e-10
# Weighings before it is left undecided, and the smallest weight.
_ROUNDS, _LIGHTEST = 6, 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Decision:
    """exists: None where it is not decided. residual: largest component that the best multipliers found leave, total: the sum of all; y
    (columns,): these multipliers. polar (n,): proves that there are none; slope: of the gradient along -polar, of largest component 1."""

    exists: bool | None
    residual: float
    y: np.ndarray
    total: float = np.inf
    polar: np.ndarray | None = None
    slope: float = 0.0


def decide(matrix: sparse.csc_matrix, gradient: np.ndarray, low: np.ndarray, high: np.ndarray, tolerance: float) -> Decision:
    """matrix (n, columns): active gradients; low, high (columns,): limits of their multipliers, each 0 or infinite."""
    weights = np.ones(len(gradient))
    best = Decision(exists=None, residual=np.inf, y=np.zeros(matrix.shape[1]))
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)
        found = project((sparse.diags(root) @ matrix).tocsc(), root * gradient, low, high)
        if found is None:
            break
        rest = gradient - matrix @ found.y
        residual = float(np.max(np.abs(rest), initial=0.0))
        if residual < best.residual:
            best = Decision(exists=True if residual <= tolerance else None, residual=residual, y=found.y, total=float(np.sum(np.abs(rest))))
        if best.exists:
            break
        polar = root * found.polar
        if excludes(gradient, polar, found.across, tolerance):
            return replace(best, exists=False, polar=polar, slope=-float(polar @ gradient) / float(np.max(np.abs(polar))))
        weights = np.maximum(weights * np.abs(rest) / residual, _LIGHTEST)
        weights /= np.max(weights)
    return best


def excludes(gradient: np.ndarray, polar: np.ndarray, across: float, tolerance: float) -> bool:
    """Whether a vector that breaks conditions by at most `across` proves that no multipliers leave as little as the tolerance."""
    enough = float(polar @ gradient) > tolerance * float(np.sum(np.abs(polar))) + _LARGEST * across
    return enough and across <= _ACROSS * float(np.max(np.abs(polar)))

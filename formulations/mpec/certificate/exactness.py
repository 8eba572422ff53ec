"""Would the constraints still hold if the complementarity held exactly?

    x y >= 1,   0 <= x complementary to y >= 0        at   x = 5e-13, y = 2e12

satisfies every residual to 1e-12, and there is no solution: the row lives on the 5e-13. Here the smaller side of each pair is moved to 0, and
the other constraints are asked how much of their violation no small step of the variables can mend.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from scipy.linalg import null_space
from scipy.optimize import linprog
from scipy.sparse.linalg import lsqr

from formulations.mpec.certificate.evaluation import LocalModel

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


def forced_violation(local: LocalModel, tolerance: float) -> float:
    """Largest violation of a row or bound (relative to max(1, |bound|)), to first order, after the step that makes every pair exact.

    The shortest step is taken where it keeps the violation within the tolerance, else the best; inf if no small one makes the pairs exact.
    """
    x = np.array([row.value for row in local.bounds])
    sides, matrix = _closed_sides(local)
    rows = (*local.rows, *local.bounds)
    value, low, high = (np.array([getattr(row, name) for row in rows]) for name in ("value", "lower", "upper"))
    scale = np.maximum(1.0, np.maximum(_finite(low), _finite(high)))

    def violation(now: np.ndarray) -> float:
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
    """min t: low - t scale <= moved + everything N z <= high + t scale, |shortest + N z| <= 1. N spans the steps that leave the sides where
    they are: as equations of the program they would hold within its tolerance only, which is what is in question."""
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

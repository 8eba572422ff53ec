"""What is active at a point, within a tolerance: gradients and the signs that their multipliers may have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse

from formulations.mpec.certificate.evaluation import LocalModel, Row

# Two sides with the same gradient whose values differ by less are one and the same.
_SAME_SIDE = 1e-12


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

    @property
    def matrix(self) -> sparse.csc_matrix:
        """Active gradients as columns: of rows and bounds, of sides that are zero alone, of the first and of the second sides of biactive pairs."""
        first, second = self.first_normals, self.second_normals
        sides = (first[:, self.first_only], second[:, self.second_only], first[:, self.both], second[:, self.both])
        return sparse.hstack([self.normals, *sides], format="csc")


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

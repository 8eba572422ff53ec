"""The questions of a certificate as linear programs (HiGHS), for where linear algebra (`decision`) leaves them open."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import Bounds, LinearConstraint, linprog, milp

from formulations.mpec.certificate.active import ActiveSet
from formulations.mpec.certificate.decision import Decision
from formulations.mpec.certificate.multipliers import signed_least_squares

# Share of the tolerance that a linear program may use: HiGHS holds a row to 1e-7 only.
_SHARE = 0.98
_INFEASIBLE = 2  # HiGHS's status


def multipliers_within(matrix: sparse.csc_matrix, gradient: np.ndarray, low: np.ndarray, high: np.ndarray, tolerance: float) -> Decision:
    """Arguments as in `decision.decide`; undecided where the program fails.

    Tolerances on both sides of each row are a far easier program than the smallest residual (`least_residual`), whose variable is in all rows.
    """
    columns = matrix.shape[1]
    if not all(matrix.shape):
        residual = float(np.max(np.abs(gradient), initial=0.0))
        return Decision(exists=residual <= tolerance, residual=residual, y=np.zeros(columns))
    rows = LinearConstraint(matrix, gradient - _SHARE * tolerance, gradient + _SHARE * tolerance)
    answer = milp(np.zeros(columns), constraints=rows, bounds=Bounds(low, high))
    if answer.x is None:
        return Decision(exists=False if answer.status == _INFEASIBLE else None, residual=np.inf, y=np.zeros(columns))
    y = np.clip(answer.x, low, high)
    used = np.flatnonzero(y)
    residual = float(np.max(np.abs(gradient - matrix @ y)))
    better = signed_least_squares(matrix[:, used], gradient, low[used], high[used], 0.0)  # a program stops at the tolerance
    if better is not None and float(np.max(np.abs(better.rest))) < residual:
        y, residual = np.zeros(columns), float(np.max(np.abs(better.rest)))
        y[used] = better.y
    return Decision(exists=residual <= tolerance, residual=residual, y=y)


def least_residual(matrix: sparse.csc_matrix, gradient: np.ndarray, low: np.ndarray, high: np.ndarray, tolerance: float) -> Decision:
    """The smallest residual that there is: min t with -t <= gradient - matrix y <= t."""
    n, columns = matrix.shape
    if not n or not columns:
        residual = float(np.max(np.abs(gradient), initial=0.0))
        return Decision(exists=residual <= tolerance, residual=residual, y=np.zeros(columns))
    ones = sparse.csr_matrix(np.ones((n, 1)))
    system = sparse.vstack([sparse.hstack([matrix, -ones]), sparse.hstack([-matrix, -ones])], format="csr")
    cost = np.zeros(columns + 1)
    cost[-1] = 1.0
    sides = [*zip(low.tolist(), high.tolist(), strict=True), (0.0, None)]
    answer = linprog(cost, A_ub=system, b_ub=np.concatenate([gradient, -gradient]), bounds=sides, method="highs")
    if answer.status != 0:
        return Decision(exists=None, residual=np.inf, y=np.zeros(columns))
    return Decision(exists=float(answer.fun) <= tolerance, residual=float(answer.fun), y=answer.x[:-1])


def steepest_direction(active: ActiveSet, first_held: np.ndarray, second_held: np.ndarray) -> tuple[float, np.ndarray | None]:
    """min gradient' d over |d| <= 1, relative to the scale: of the biactive pairs the held sides (masks) stay 0, the other sides do not go below
    0. NaN if the program, which has d = 0, fails."""
    n = len(active.gradient)
    if n == 0:
        return 0.0, None
    held_first = np.concatenate([active.first_only, active.both[first_held]])
    held_second = np.concatenate([active.second_only, active.both[second_held]])
    equal = [active.first_normals[:, held_first].T, active.second_normals[:, held_second].T]
    rising = [active.first_normals[:, active.both[~first_held]].T, active.second_normals[:, active.both[~second_held]].T]
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
    return (float(answer.fun), answer.x) if answer.status == 0 else (np.nan, None)

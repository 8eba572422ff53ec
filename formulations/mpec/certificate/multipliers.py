"""Multipliers of a point: by least squares, by projection onto a cone, by linear programs.

Least squares: a sparse factorisation instead of linear programs.

    minimise |gradient - A y|^2   ->   [I  A; A' 0] (r, y) = (gradient, 0)

If that matrix is regular, y is the only candidate: what its residual and signs say is the whole
truth (class S and B-stationarity are then the same). If it is singular there are many y, and the
same with -eps I in its corner, repeated (proximal point method; Rockafellar, SIAM J. Control and
Optimization 14, 1976), finds one that leaves as little. Where its signs are right, that is enough;
where they are wrong, others may still be right.

`decide`: do multipliers with given signs leave at most a tolerance of the gradient? Both answers
    come with what proves them.
Yes: multipliers y. No: a vector p with p' gradient > tolerance |p|_1 that all conditions allow (-p
    points down, and no y makes up for it):

    |p|_1 |gradient - A y|_max >= p' (gradient - A y) >= p' gradient - across |y|_1
        across: by how much p breaks a condition, at most

The projection of the gradient gives both. Where the largest component of its rest is above the
tolerance and its p proves nothing yet, components are weighed by what was left of them (Lawson's
way to the smallest largest residual: University of California, 1961).

`project`: the gradient onto the cone that the active gradients span with the signs their
    multipliers may have.

    minimise |gradient - A y|^2   over the y with the right signs:   gradient = A y + rest

Either the rest vanishes, and y are multipliers; or -rest leaves every active condition where it is
or on its good side, and the objective falls along it (Moreau's decomposition, the lemma of Farkas).
Found by a primal-dual interior point method with predictor and corrector (Mehrotra, SIAM J.
Optimization 2, 1992) on the sparse system [I A; A' -D]: some twenty factorisations, which are cheap
where time couples neighbours only. Nothing rests on its having converged: whoever asks judges y and
rest themselves.

`multipliers_within`, `least_residual`: linear programs (HiGHS), for what linear algebra leaves
    open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import Bounds, LinearConstraint, linprog, milp
from scipy.sparse.linalg import LinearOperator, onenormest, splu

# Share of the tolerance that a linear program may use: HiGHS holds a row to 1e-7 only.
_SHARE = 0.98
_INFEASIBLE = 2  # HiGHS's status


def multipliers_within(
    matrix: sparse.csc_matrix,
    gradient: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    tolerance: float,
) -> MultiplierDecision:
    """Multipliers that leave at most the tolerance, by a linear program; undecided where it fails.

    Tolerances on both sides of each row are a far easier program than the smallest residual
    (`least_residual`), whose variable is in all rows. Raises nothing: it is undecided where the
    program fails.

    Parameters
    ----------
    matrix : (n, columns) active gradients [row per variable]
    gradient : (n,) of the objective, divided by its scale [1 per variable]
    low, high : (columns,) limits of the multipliers, each 0 or infinite
    tolerance : largest component that may be left
    """
    columns = matrix.shape[1]
    if not all(matrix.shape):
        residual = float(np.max(np.abs(gradient), initial=0.0))
        return MultiplierDecision(
            exists=residual <= tolerance, residual=residual, y=np.zeros(columns)
        )
    rows = LinearConstraint(matrix, gradient - _SHARE * tolerance, gradient + _SHARE * tolerance)
    answer = milp(np.zeros(columns), constraints=rows, bounds=Bounds(low, high))
    if answer.x is None:
        return MultiplierDecision(
            exists=False if answer.status == _INFEASIBLE else None,
            residual=np.inf,
            y=np.zeros(columns),
        )
    y = np.clip(answer.x, low, high)
    used = np.flatnonzero(y)
    residual = float(np.max(np.abs(gradient - matrix @ y)))
    better = signed_least_squares(
        matrix[:, used], gradient, low[used], high[used], 0.0
    )  # a program stops at the tolerance
    if better is not None and float(np.max(np.abs(better.rest))) < residual:
        y, residual = np.zeros(columns), float(np.max(np.abs(better.rest)))
        y[used] = better.y
    return MultiplierDecision(exists=residual <= tolerance, residual=residual, y=y)


def least_residual(
    matrix: sparse.csc_matrix,
    gradient: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    tolerance: float,
) -> MultiplierDecision:
    """The smallest residual that there is: min t with -t <= gradient - matrix y <= t.

    Arguments as in `decide`: (n, columns), (n,), (columns,) [-].

    Raises ValueError for numbers that are not finite; it is undecided where the program fails.
    """
    n, columns = matrix.shape
    if not n or not columns:
        residual = float(np.max(np.abs(gradient), initial=0.0))
        return MultiplierDecision(
            exists=residual <= tolerance, residual=residual, y=np.zeros(columns)
        )
    ones = sparse.csr_matrix(np.ones((n, 1)))
    system = sparse.vstack(
        [sparse.hstack([matrix, -ones]), sparse.hstack([-matrix, -ones])], format="csr"
    )
    cost = np.zeros(columns + 1)
    cost[-1] = 1.0
    sides = [*zip(low.tolist(), high.tolist(), strict=True), (0.0, None)]
    answer = linprog(
        cost, A_ub=system, b_ub=np.concatenate([gradient, -gradient]), bounds=sides, method="highs"
    )
    if answer.status != 0:
        return MultiplierDecision(exists=None, residual=np.inf, y=np.zeros(columns))
    return MultiplierDecision(
        exists=float(answer.fun) <= tolerance, residual=float(answer.fun), y=answer.x[:-1]
    )


# Sum of multipliers (of the gradient divided by its scale) up to which they are excluded before it
# is said that there are none, by a vector that breaks no condition by more than this share of its
# largest component. (A linear program of HiGHS excludes with 1e-7.)
_LARGEST = 1e6
_ACROSS = 1e-10
# Weighings before it is left undecided, and the smallest weight.
_DECISION_ROUNDS = 6
_LIGHTEST = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class MultiplierDecision:
    """Whether multipliers exist.

    exists: None where it is not decided; residual: largest component that the best multipliers
        found leave, total: the sum of all; y (columns,): these
    multipliers; polar (n,): proves that there are none; slope: of the gradient along -polar, of
        largest component 1
    """

    exists: bool | None
    residual: float
    y: np.ndarray
    total: float = np.inf
    polar: np.ndarray | None = None
    slope: float = 0.0


def decide(
    matrix: sparse.csc_matrix,
    gradient: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    tolerance: float,
) -> MultiplierDecision:
    """Whether multipliers with these limits leave at most the tolerance of the gradient.

    Raises nothing: it is undecided where a factorisation fails.

    Parameters
    ----------
    matrix : (n, columns) active gradients [row per variable]
    gradient : (n,) of the objective, divided by its scale [1 per variable]
    low, high : (columns,) limits of the multipliers, each 0 or infinite
    tolerance : largest component that may be left
    """
    weights = np.ones(len(gradient))
    best = MultiplierDecision(exists=None, residual=np.inf, y=np.zeros(matrix.shape[1]))
    for _ in range(_DECISION_ROUNDS):
        root = np.sqrt(weights)
        found = project((sparse.diags(root) @ matrix).tocsc(), root * gradient, low, high)
        if found is None:
            break
        rest = gradient - matrix @ found.y
        residual = float(np.max(np.abs(rest), initial=0.0))
        if residual < best.residual:
            best = MultiplierDecision(
                exists=True if residual <= tolerance else None,
                residual=residual,
                y=found.y,
                total=float(np.sum(np.abs(rest))),
            )
        if best.exists:
            break
        polar = root * found.polar
        if excludes(gradient, polar, found.across, tolerance):
            return replace(
                best,
                exists=False,
                polar=polar,
                slope=-float(polar @ gradient) / float(np.max(np.abs(polar))),
            )
        weights = np.maximum(weights * np.abs(rest) / residual, _LIGHTEST)
        weights /= np.max(weights)
    return best


def excludes(gradient: np.ndarray, polar: np.ndarray, across: float, tolerance: float) -> bool:
    """Whether a vector proves that no multipliers leave as little as the tolerance.

    Raises nothing.

    Parameters
    ----------
    gradient : (n,) of the objective, divided by its scale [1 per variable]
    polar : (n,) the vector [-]
    across : by how much it breaks a condition, at most
    tolerance : largest component that may be left
    """
    enough = float(polar @ gradient) > tolerance * float(np.sum(np.abs(polar))) + _LARGEST * across
    return enough and across <= _ACROSS * float(np.max(np.abs(polar)))


# Of a step in y with columns of length 1: keeps the system regular where gradients depend on each
# other, and is gone where steps end.
_DAMPING = 1e-10
_ITERATIONS = 60
_TO_THE_BOUNDARY = 0.995
# The first y and z are at least this share of the gradient's length away from 0.
_INSIDE = 1e-2
# Solved where the sum of y z is this share of |rest|^2 and the conditions hold to this share of
# |rest|; or this share of the gradient is left.
_GAP = 1e-12
_DUAL = 1e-10
_NOTHING_LEFT = 1e-10
# Where the sum of y z is that small, but gradients depend on each other so nearly that the damping
# holds y back (for 60 steps and more), least squares with the columns that count may be the answer
# already: to this share of the lengths that are subtracted.
_ROUNDING = 1e-14


@dataclass(frozen=True, kw_only=True, eq=False)
class Projection:
    """A point of the cone that the columns span.

    y (columns,) with the right signs, and rest (n,) = gradient - A y: of what was found, that whose
    largest component is smallest polar (n,): of what was found, the rest that is nearest to leaving
    every condition on its good side; across: by how much it puts one on its bad side, at most
    """

    y: np.ndarray
    rest: np.ndarray
    polar: np.ndarray
    across: float


def project(
    matrix: sparse.csc_matrix, gradient: np.ndarray, low: np.ndarray, high: np.ndarray
) -> Projection | None:
    """The gradient projected onto the cone of the columns with the right signs.

    None where a factorisation fails.

    Raises nothing: None where a factorisation fails.

    Parameters
    ----------
    matrix : (n, columns) active gradients [row per variable]
    gradient : (n,) of the objective [objective per variable]
    low, high : (columns,) limits of y, each 0 or infinite
    """
    chosen = np.flatnonzero((low < 0.0) | (high > 0.0))
    free, falling = (low[chosen] < 0.0) & (high[chosen] > 0.0), high[chosen] <= 0.0
    part = (matrix[:, chosen] @ sparse.diags(np.where(falling, -1.0, 1.0))).tocsc()
    length = column_lengths(part)
    columns = len(chosen)
    candidates: list[np.ndarray] = [] if columns else [np.zeros(0)]
    used = np.ones(columns, dtype=bool)
    if not np.all(free):
        found = _interior_point(
            (part @ sparse.diags(1.0 / length)).tocsc(), gradient, np.flatnonzero(~free)
        )
        if found is None:
            return None
        candidates, used = [found[0] / length], found[1]
    exact = _proximal_least_squares(part[:, used], gradient)
    if exact is not None:
        candidates.append(np.zeros(columns))
        candidates[-1][used] = exact
    if not candidates:
        return None
    signed = [np.where(free, y, np.maximum(y, 0.0)) for y in candidates]
    rests, polars = ([gradient - part @ y for y in ys] for ys in (signed, candidates))
    across = [
        float(np.max(np.where(free, np.abs(products), products), initial=0.0))
        for products in (part.T @ p for p in polars)
    ]
    best = int(np.argmin([np.max(np.abs(rest), initial=0.0) for rest in rests]))
    straight = int(np.argmin(across))
    y = np.zeros(matrix.shape[1])
    y[chosen] = np.where(falling, -1.0, 1.0) * signed[best]
    return Projection(y=y, rest=rests[best], polar=polars[straight], across=across[straight])


def _interior_point(
    matrix: sparse.csc_matrix, gradient: np.ndarray, signed: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """(y, which columns count: all but those whose y vanishes).

    Columns of length 1, y[signed] >= 0. None where a factorisation fails.
    """
    columns = matrix.shape[1]
    size, count = float(np.linalg.norm(gradient)), len(signed)
    if size == 0.0:
        return np.zeros(columns), np.zeros(columns, dtype=bool)
    diagonal = np.full(columns, _DAMPING)
    diagonal[signed] = 1.0
    solve = _factorised(matrix, diagonal)
    if solve is None:
        return None
    y = solve(gradient, np.zeros(columns))
    z = np.maximum(np.abs(matrix[:, signed].T @ (gradient - matrix @ y)), _INSIDE * size)
    y[signed] = np.maximum(np.abs(y[signed]), _INSIDE * size)
    looked_at = np.zeros(0, dtype=bool)
    for _ in range(_ITERATIONS):
        rest = gradient - matrix @ y
        off = matrix.T @ rest
        off[signed] += z
        left, gap = float(np.linalg.norm(rest)), float(y[signed] @ z)
        if left <= _NOTHING_LEFT * size or (
            gap <= _GAP * left**2 and np.max(np.abs(off)) <= _DUAL * left
        ):
            break
        counts = y[signed] > z
        if gap <= _GAP * left**2 and not np.array_equal(counts, looked_at):
            looked_at = counts
            exact = _settled(matrix, gradient, signed, counts)
            if exact is not None:
                return exact
        diagonal[signed] = z / y[signed] + _DAMPING
        solve = _factorised(matrix, diagonal)
        if solve is None:
            break
        target = np.zeros(count)  # of y z: 0 for the predictor
        for is_corrector in (False, True):
            right = np.zeros(columns)
            right[signed] = -target / y[signed]
            step = solve(rest, right)
            change = step[signed]
            z_change = (target - z * change) / y[signed] - z
            reach = min(_reach(y[signed], change), _reach(z, z_change))
            if not is_corrector:
                ahead = float(
                    (y[signed] + min(1.0, reach) * change) @ (z + min(1.0, reach) * z_change)
                )
                target = gap / count * (ahead / gap) ** 3 - change * z_change
        if not np.all(np.isfinite(step)):
            break
        along = min(1.0, _TO_THE_BOUNDARY * reach)
        y, z = y + along * step, z + along * z_change
    used = np.ones(columns, dtype=bool)
    used[signed] = y[signed] > z
    return y, used


def _settled(
    matrix: sparse.csc_matrix, gradient: np.ndarray, signed: np.ndarray, counts: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Least squares with the signed columns that count and all others, and which these are.

    None where that is not the projection.
    """
    used = np.ones(matrix.shape[1], dtype=bool)
    used[signed] = counts
    part = _proximal_least_squares(matrix[:, used], gradient)
    if part is None:
        return None
    y = np.zeros(len(used))
    y[used] = part
    rest = gradient - matrix @ y
    products = matrix.T @ rest
    products[used] = np.abs(
        products[used]
    )  # of the others only those that would shorten the rest count
    lengths = float(np.linalg.norm(gradient)) + float(np.max(np.abs(y), initial=0.0))
    enough = max(_DUAL * float(np.linalg.norm(rest)), _ROUNDING * lengths)
    return (
        (y, used) if np.all(y[signed] >= 0.0) and np.max(products, initial=0.0) <= enough else None
    )


def _factorised(
    matrix: sparse.csc_matrix, diagonal: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], np.ndarray] | None:
    """Solves s + A dy = first, A' s - diagonal dy = second for dy.

    None where the factorisation fails.
    """
    n = matrix.shape[0]
    try:
        factors = splu(
            sparse.bmat(
                [[sparse.identity(n), matrix], [matrix.T, -sparse.diags(diagonal)]], format="csc"
            )
        )
    except RuntimeError:
        return None
    return lambda first, second: factors.solve(np.concatenate([first, second]))[n:]


def _reach(values: np.ndarray, change: np.ndarray) -> float:
    """How far to go along a change until one of the values, which are positive, is 0."""
    falls = change < 0.0
    return float(np.min(-values[falls] / change[falls], initial=np.inf))


# of the solution of the augmented system; the first brings three plans of 500 to 5000 steps from
# 1e-9 to 1e-14
_REFINEMENTS = 3
# Of the proximal point method with columns of length 1: eps, most steps of one solution, and how
# often multipliers of the wrong sign are left out and the rest is found again. A step that leaves
# more than _STALLS of what the last one left, and of its products with the columns, is the last.
_PROXIMAL = 1e-12
_STEPS = 12
_ROUNDS = 6
_STALLS = 0.9
# largest condition number (1-norm, estimated) of the augmented system that still counts as regular
_REGULAR = 1e14


@dataclass(frozen=True, kw_only=True, eq=False)
class LeastSquares:
    """y (columns,): the multipliers; rest (n,): what they leave of the gradient."""

    y: np.ndarray
    rest: np.ndarray
    _solve: Callable[[np.ndarray], np.ndarray]

    def leaving(self, column: int) -> np.ndarray:
        """The shortest direction in which the condition of this column rises by one and all others stay: the objective changes by y[column].

        Raises nothing.

        Returns
        -------
        (n,) direction [units of the variables]
        """
        right = np.zeros(len(self.rest) + len(self.y))
        right[len(self.rest) + column] = 1.0
        return self._solve(right)[: len(self.rest)]


def least_squares(matrix: sparse.csc_matrix, gradient: np.ndarray) -> LeastSquares | None:
    """Multipliers by least squares.

    None where the columns are not linearly independent (then there may be many y, or it is not
    known).

    Raises nothing.

    Parameters
    ----------
    matrix : (n, columns) active gradients [row per variable]
    gradient : (n,) of the objective [objective per variable]
    """
    n, columns = matrix.shape
    if columns > n:
        return None
    if not columns:
        return LeastSquares(y=np.zeros(0), rest=gradient, _solve=lambda right: right)
    system = sparse.bmat([[sparse.identity(n), matrix], [matrix.T, None]], format="csc")
    try:
        factors = splu(system)
    except RuntimeError:  # exactly singular
        return None
    size = n + columns
    inverse = LinearOperator(
        (size, size),
        matvec=factors.solve,
        rmatvec=lambda x: factors.solve(x, trans="T"),
        dtype=float,
    )
    if (
        not onenormest(inverse) * abs(system).sum(axis=0).max() <= _REGULAR
    ):  # NaN counts as singular
        return None
    right = np.concatenate([gradient, np.zeros(columns)])
    solution = factors.solve(right)
    for _ in range(_REFINEMENTS):
        solution = solution + factors.solve(right - system @ solution)
    y = solution[n:]
    return LeastSquares(y=y, rest=gradient - matrix @ y, _solve=factors.solve)


@dataclass(frozen=True, kw_only=True, eq=False)
class SignedMultipliers:
    """Multipliers within limits.

    y (columns,), and what it leaves (n,); least (n,): what the best without limits leave; across:
    the largest product of a column with `least`, 0 but for rounding
    """

    y: np.ndarray
    rest: np.ndarray
    least: np.ndarray
    across: float


def signed_least_squares(
    matrix: sparse.csc_matrix,
    gradient: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    tolerance: float,
) -> SignedMultipliers | None:
    """Multipliers within limits (which hold 0) that leave at most the tolerance in each component, if that is found; else those found last.

    The columns may depend on each other. None where there is no column, or the factorisation fails.
    Raises nothing.

    Parameters
    ----------
    matrix : (n, columns) active gradients [row per variable]
    gradient : (n,) of the objective [objective per variable]
    low, high : (columns,) limits of the multipliers
    tolerance : largest component that may be left
    """
    columns = matrix.shape[1]
    y = _proximal_least_squares(matrix, gradient)
    if y is None:
        return None
    least = gradient - matrix @ y
    held = np.clip(y, low, high)
    for _ in range(_ROUNDS):
        wrong = held != y
        if np.max(np.abs(gradient - matrix @ held), initial=0.0) <= tolerance or not np.any(wrong):
            break
        chosen = np.flatnonzero((held != 0.0) & ~wrong)
        part = _proximal_least_squares(matrix[:, chosen], gradient)
        if part is None:
            break
        y = np.zeros(columns)
        y[chosen] = part
        held = np.clip(y, low, high)
    across = float(np.max(np.abs(matrix.T @ least), initial=0.0))
    return SignedMultipliers(y=held, rest=gradient - matrix @ held, least=least, across=across)


def _proximal_least_squares(matrix: sparse.csc_matrix, gradient: np.ndarray) -> np.ndarray | None:
    """(columns,) least squares by the proximal point method; None if the factorisation fails."""
    n, columns = matrix.shape
    if not columns:
        return None
    length = column_lengths(matrix)
    matrix = (matrix @ sparse.diags(1.0 / length)).tocsc()
    try:
        factors = splu(
            sparse.bmat(
                [[sparse.identity(n), matrix], [matrix.T, -_PROXIMAL * sparse.identity(columns)]],
                format="csc",
            )
        )
    except RuntimeError:
        return None
    y, rest = np.zeros(columns), gradient
    for _ in range(_STEPS):
        trial = y + factors.solve(np.concatenate([rest, np.zeros(columns)]))[n:]
        left = gradient - matrix @ trial
        shorter = np.linalg.norm(left) < _STALLS * np.linalg.norm(rest)
        straighter = np.linalg.norm(matrix.T @ left) < _STALLS * np.linalg.norm(matrix.T @ rest)
        if not (shorter or straighter):  # as good as it gets; NaN too
            break
        y, rest = trial, left
    return y / length


def column_lengths(matrix: sparse.csc_matrix) -> np.ndarray:
    """Lengths (columns,) of the columns of a matrix (n, columns), in the 2-norm.

    1 for a column of zeros [units of the entries].

    Raises nothing.
    """
    length = np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=0)).ravel())
    return np.where(length == 0.0, 1.0, length)

"""Solve one branch of an MPEC exactly: fix one side of each pair at 0, and improve the choice.

In a branch, a pair with v = 0 = w has a multiplier on the fixed side. If it is negative, the other
branch has a lower objective to first order: these pairs are switched together, one by one, or in
every combination. `refined` moves Ipopt's answer to the active constraints, from which Ipopt stops
at about 1e-9 (1e-5 if the multiplier is zero), by Newton's method with a guessed active set.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse
from scipy.linalg import eigh, null_space
from scipy.sparse.linalg import splu

from formulations.ipopt import IpoptProblem, IpoptResult, Start
from formulations.mpec.homotopy import Columns, Workspace
from formulations.solution import Outcome

# A pair is biactive if both sides are below this.
_BIACTIVE = 1e-6
# A biactive pair needs its other branch if its multiplier is below -_WANTING.
_WANTING = 1e-6
# Largest number of branches tried without a known feasible one: all of 8 pairs. Small problems cost
# some 10 ms per branch.
NEAREST = 256
# Smallest improvement of the objective, relative to max(1, |objective|).
BETTER = 1e-9
# Iteration limit: a branch starts near its solution, or has no solution.
_BRANCH_ITERATIONS = 200
# Ipopt's codes for a solution in its own scaling.
_CLAIMS_SUCCESS = (0, 1)

# Ipopt relaxes fixed variables by this; `refined` restores them.
_LOOSELY_HELD = {"fixed_variable_treatment": "relax_bounds", "bound_relax_factor": 1e-9}

# Newton steps per guess: the method converges quadratically or not at all.
_STEPS = 6
# Largest system for the dense least-squares solve, which handles dependent rows and flat
# directions.
_DENSE = 150
# Regularisation of the sparse solve: repeated steps compensate for it.
_DELTA = 1e-9
# Limits of a refined point that is still the same solution: change of the objective, relative to
# max(1, |objective|).
_SAME = 1e-5
# Change of the point per step.
_LONGEST = 1e-1
# A guess with a smaller error ends the search.
_GOOD_ENOUGH = 1e-13
# Violation of a refined point, if Ipopt's own was smaller.
_STAYS_FEASIBLE = 1e-9
# With a larger error Ipopt's tolerance did not show the active set: solve again with a tighter one.
_UNREFINED = 1e-6
# Factor of the tighter tolerance; a flat objective needs more.
_TIGHTER = 1e-3
# Smallest tolerance.
_TIGHTEST = 1e-14
# Initial barrier of a solve that starts at a solution.
_SMALL_BARRIER = 1e-10
# Negative curvature, relative to the sum of its absolute terms, that exceeds rounding and the
# errors of multipliers.
_CURVED = 1e-6
# Largest error of a point whose multipliers show the active set.
_EXACT = 1e-9
# Largest component of the step along negative curvature, relative to max(1, |x|).
_ASIDE = 0.1
# Lanczos steps, each two solves with one factorisation.
_LANCZOS = 20
# A vector with a smaller remainder is in the span; a row with a smaller change is unchanged.
_EXHAUSTED = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """x (n,), lagrange (m,), and their KKT error: the largest violation, slope or wrong sign."""

    x: np.ndarray
    lagrange: np.ndarray
    error: float


def refined(problem: IpoptProblem, result: IpoptResult, size: float = 1.0) -> Refined:
    """Return the best of the result's point and three guesses of its active set. Raises nothing.

    size: derivatives of the objective that errors are relative to, if those at the point are
        smaller [objective per variable]
    """
    best = Refined(
        x=result.x,
        lagrange=result.lagrange,
        error=_kkt_error(problem, result.x, result.lagrange, size),
    )
    limit = _SAME * max(1.0, abs(result.objective))
    # Errors of slopes depend on the objective's unit; a smaller one does not justify infeasibility.
    feasible = max(_STAYS_FEASIBLE, problem.violation(result.x))
    for near, by_multiplier in ((1e-5, True), (1e-3, False), (1e-3, True)):
        candidate = _newton(problem, result, near, by_multiplier, size)
        if (
            candidate is None
            or not candidate.error < best.error
            or problem.violation(candidate.x) > feasible
        ):
            continue
        if abs(problem.sense * problem.objective(candidate.x) - result.objective) <= limit:
            best = candidate
        if best.error <= _GOOD_ENOUGH:
            break
    return best


def _kkt_error(problem: IpoptProblem, x: np.ndarray, lagrange: np.ndarray, size: float) -> float:
    """Return the largest violation, or slope or multiplier of a wrong sign, slopes relative."""
    low, high = problem.lower, problem.upper
    slope = problem.lagrangian_gradient(x, lagrange)
    wrong = np.abs(slope)
    at_low, at_high = x - low <= 1e-12, high - x <= 1e-12
    wrong[at_low] = np.maximum(-slope[at_low], 0.0)
    wrong[at_high] = np.maximum(slope[at_high], 0.0)
    wrong[low == high] = 0.0
    g = problem.constraints(x)
    equal = problem.constraint_lower == problem.constraint_upper
    off_low = ~equal & (lagrange < 0) & (g - problem.constraint_lower > 1e-10)
    off_high = ~equal & (lagrange > 0) & (problem.constraint_upper - g > 1e-10)
    loose = np.abs(lagrange[off_low | off_high])
    scale = max(size, problem.slope_size(x))
    worst = max(float(np.max(wrong, initial=0.0)), float(np.max(loose, initial=0.0))) / scale
    error = max(problem.violation(x), worst)
    return error if np.isfinite(error) and np.isfinite(g).all() else float("inf")


def _newton(
    problem: IpoptProblem, result: IpoptResult, near: float, by_multiplier: bool, floor: float
) -> Refined | None:
    """Solve for the constraints within `near` of their limit.

    by_multiplier: only those whose multiplier exceeds their distance.
    """
    x, y = result.x.copy(), result.lagrange.copy()
    low, high = problem.lower, problem.upper

    size = min(1.0, problem.slope_size(x))

    def active(gap: np.ndarray, multiplier: np.ndarray) -> np.ndarray:
        """Return the mask (k,) of active limits (k,) [-]. Raises nothing."""
        return (
            (gap <= near) & ((multiplier > size * np.minimum(gap, near)) | (gap <= 1e-12))
            if by_multiplier
            else gap <= near
        )

    at_low = active(x - low, result.zl) | (low == high)
    at_high = active(high - x, result.zu) & ~at_low
    x[at_low], x[at_high] = low[at_low], high[at_high]
    free = np.flatnonzero(~(at_low | at_high))
    g = problem.constraints(x)
    equal = problem.constraint_lower == problem.constraint_upper
    is_low = equal | active(np.abs(g - problem.constraint_lower), -y)
    is_high = ~is_low & active(np.abs(problem.constraint_upper - g), y)
    rows = np.flatnonzero(is_low | is_high)
    target = np.where(is_low, problem.constraint_lower, problem.constraint_upper)[rows]
    y[~(is_low | is_high)] = 0.0
    for _ in range(_STEPS):
        step = _step(problem, x, y, free, rows, target)
        if (
            step is None
            or not np.all(np.isfinite(step))
            or np.max(np.abs(step[: len(free)]), initial=0.0)
            > _LONGEST * (1 + np.max(np.abs(x), initial=0.0))
        ):
            return None
        x[free] += step[: len(free)]
        y[rows] = step[len(free) :]
        if np.max(np.abs(step[: len(free)]), initial=0.0) < 1e-15 * (
            1 + np.max(np.abs(x), initial=0.0)
        ):
            break
    return Refined(x=x, lagrange=y, error=_kkt_error(problem, x, y, floor))


def _step(
    problem: IpoptProblem,
    x: np.ndarray,
    y: np.ndarray,
    free: np.ndarray,
    rows: np.ndarray,
    target: np.ndarray,
) -> np.ndarray | None:
    """Return (step of the free variables, new multipliers of the active rows), or None."""
    row, column = problem.jacobianstructure()
    jacobian = sparse.csr_matrix(
        (problem.jacobian(x), (row, column)), shape=(problem.m, problem.n)
    )[rows][:, free]
    hessian = _hessian(problem, x, y)[free][:, free]
    right = np.concatenate([-problem.gradient(x)[free], target - problem.constraints(x)[rows]])
    if not np.all(np.isfinite(right)):
        return None
    system = sparse.bmat(
        [[hessian, jacobian.T], [jacobian, sparse.csr_matrix((len(rows), len(rows)))]], format="csc"
    )
    if system.shape[0] <= _DENSE:
        return (
            np.linalg.lstsq(system.toarray(), right, rcond=1e-12)[0]
            if system.shape[0]
            else np.zeros(0)
        )
    signs = np.concatenate([np.full(len(free), _DELTA), np.full(len(rows), -_DELTA)])
    # Proximal step: the regularisation vanishes as the multipliers converge.
    right[len(free) :] -= _DELTA * y[rows]
    try:
        return splu((system + sparse.diags(signs)).tocsc()).solve(right)
    except RuntimeError:  # singular despite the regularisation
        return None


def _hessian(problem: IpoptProblem, x: np.ndarray, y: np.ndarray) -> sparse.csr_matrix:
    lower = sparse.csr_matrix(
        (problem.hessian(x, y, 1.0), problem.hessianstructure()), shape=(problem.n, problem.n)
    )
    return (lower + sparse.tril(lower, -1).T).tocsr()


def step_aside(
    problem: IpoptProblem, x: np.ndarray, lagrange: np.ndarray, weak: float
) -> np.ndarray | None:
    """Return a step (n,) [variable units] that decreases the Lagrangian to second order, or None.

    Active constraints keep their values to first order, except inequalities whose multiplier is at
    most `weak` [objective per variable]. x (n,) is stationary with lagrange (m,). Raises nothing.
    """
    slope, g = np.abs(problem.lagrangian_gradient(x, lagrange)), problem.constraints(x)
    at_bound = np.minimum(x - problem.lower, problem.upper - x)
    at_row = np.minimum(g - problem.constraint_lower, problem.constraint_upper - g)
    is_held = (problem.lower == problem.upper) | ((at_bound <= _BIACTIVE) & (slope > weak))
    is_kept = (problem.constraint_lower == problem.constraint_upper) | (
        (at_row <= _BIACTIVE) & (np.abs(lagrange) > weak)
    )
    free, rows = np.flatnonzero(~is_held), np.flatnonzero(is_kept)
    hessian = _hessian(problem, x, lagrange)[free][:, free]
    jacobian = sparse.csr_matrix(
        (problem.jacobian(x), problem.jacobianstructure()), shape=(problem.m, problem.n)
    )[rows][:, free]
    if not np.all(np.isfinite(hessian.data)) or not np.all(np.isfinite(jacobian.data)):
        return None
    ways = _curving_down(hessian, jacobian)
    if not ways.shape[1]:
        return None
    # A random combination leaves no direction at its maximum.
    direction = ways @ np.random.default_rng(0).normal(size=ways.shape[1])
    step = np.zeros(problem.n)
    step[free] = direction * (_ASIDE / np.max(np.abs(direction) / np.maximum(1.0, np.abs(x[free]))))
    gain = -0.5 * float(step[free] @ (hessian @ step[free]))
    return step if gain > BETTER * max(1.0, abs(problem.objective(x))) else None


def _curving_down(hessian: sparse.csr_matrix, jacobian: sparse.csr_matrix) -> np.ndarray:
    """Return orthonormal directions (n, k) of negative curvature in the null space of the Jacobian.

    Large problems use the directions of Lanczos's method.
    """
    n, m = hessian.shape[0], jacobian.shape[0]
    length = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=1)).ravel())
    rows = sparse.diags(1.0 / np.where(length > 0.0, length, 1.0)) @ jacobian
    span = (
        _krylov(hessian, rows)
        if n > _DENSE
        else null_space(rows.toarray(), rcond=1e-10)
        if m
        else np.eye(n)
    )
    if not span.shape[1]:
        return span
    curvatures, mixed = eigh(span.T @ (hessian @ span))
    ways = span @ mixed
    is_down = curvatures < -_CURVED * np.sum(np.abs(ways) * (abs(hessian) @ np.abs(ways)), axis=0)
    return ways[:, is_down & (np.max(np.abs(rows @ ways), axis=0, initial=0.0) <= _EXHAUSTED)]


def _krylov(hessian: sparse.csr_matrix, rows: sparse.csr_matrix) -> np.ndarray:
    """Return orthonormal directions (n, k) that keep the rows: a Krylov space of the Hessian."""
    n, m = hessian.shape[0], rows.shape[0]
    try:
        factors = splu(
            sparse.bmat([[sparse.eye(n), rows.T], [rows, -_DELTA * sparse.eye(m)]], format="csc")
        )
    except RuntimeError:  # singular despite the regularisation
        return np.zeros((n, 0))
    span = np.zeros((n, 0))
    vector = np.random.default_rng(0).normal(size=n)
    for _ in range(_LANCZOS):
        size = np.linalg.norm(vector)
        for _ in range(2):  # the second pass removes regularisation and rounding errors
            vector = factors.solve(np.append(vector, np.zeros(m)))[:n]
            vector = vector - span @ (span.T @ vector)
        if not np.linalg.norm(vector) > _EXHAUSTED * size:
            break
        span = np.column_stack([span, vector / np.linalg.norm(vector)])
        vector = hessian @ span[:, -1]
    return span


@dataclass(frozen=True, kw_only=True, eq=False)
class Branch:
    """A solved branch.

    - closed: (pairs,) True if v is fixed at 0, else w is
    - x, lagrange: (n,), (m,), refined
    - biactive: (pairs,) both sides 0
    - multipliers: (pairs,) of the fixed side of each pair
    - slope: (n,) of `_bound_multipliers`
    """

    closed: np.ndarray
    x: np.ndarray
    lagrange: np.ndarray
    objective: float
    biactive: np.ndarray
    multipliers: np.ndarray
    slope: np.ndarray

    @property
    def is_strong(self) -> bool:
        """Return whether no biactive pair needs its other branch."""
        return not bool(np.any(self.wanting))

    @property
    def wanting(self) -> np.ndarray:
        """Return the mask (pairs,) of biactive pairs that need their other branch [-].

        Raises nothing.
        """
        return self.biactive & (self.multipliers < -_WANTING)


class Branching:
    """The branches of one problem, each solved once, and again after a saddle point."""

    def __init__(self, work: Workspace, start: np.ndarray) -> None:
        self._work, self._settings, self._budget = work, work.settings, work.budget
        self._columns = work.branches
        self._known: dict[bytes, Branch | None] = {}
        self.last: IpoptResult | None = None
        # True if some branch is unbounded.
        self.unbounded = False
        # True if the last branch of `past_saddle` has negative curvature, without a better branch.
        self.curves_down = False
        self._size = work.branches.problem.slope_size_nearby(work.branch_point(start))

    def polish(self, x: np.ndarray) -> Branch | None:
        """Return the best branch near a point x (n,) of the relaxation [variable units], or None.

        Raises the errors of `formulations.ipopt.solve`.
        """
        point = self._work.branch_point(x)
        first, second = self._columns.pair_values(point)
        branch = self._solve(first < second, point)
        if branch is None:
            branch = self._repair(first, second, point)
        return None if branch is None else self._improve(branch)

    def search(self, branch: Branch, start: np.ndarray) -> Branch:
        """Search locally: switch each pair in turn, and move to better branches.

        start: (n,) the user's start in the relaxation's columns [variable units]; the curved branch
            may have a better solution from there
        Raises the errors of `formulations.ipopt.solve`.
        """
        if len(branch.closed) > self._settings.search:
            return branch
        restarted = self._solve_anew(branch.closed, self._work.branch_point(start))
        if restarted is not None and self._is_better(restarted, branch):
            branch = self._improve(restarted)
        while True:
            neighbours = [self._try(branch, [k]) for k in range(len(branch.closed))]
            better = [self._improve(neighbour) for neighbour in neighbours if neighbour is not None]
            if not better:
                return branch
            branch = min(better, key=self._sense)

    def past_saddle(self, branch: Branch) -> Branch | None:
        """Return a better point of the same branch, beyond a maximum or saddle point, or None.

        `curves_down` is then True if negative curvature exists but no better point was found.
        """
        self.curves_down = False
        if _kkt_error(self._hold(branch.closed)[0], branch.x, branch.lagrange, self._size) > _EXACT:
            return None
        tried: np.ndarray | None = None
        for weak in (_WANTING * self._size, -np.inf):
            step = step_aside(self._hold(branch.closed)[0], branch.x, branch.lagrange, weak)
            if step is None:  # a stricter `weak` has none either
                return None
            if tried is None or not np.array_equal(step, tried):
                solved = [
                    self._solve_anew(branch.closed, branch.x + sign * step)
                    for sign in (1.0, -1.0)
                    if not self._budget.is_over
                ]
                better = [
                    other
                    for other in solved
                    if other is not None and self._is_better(other, branch)
                ]
                if better:
                    # Branches solved from the saddle point may be saddle points too.
                    self._known.clear()
                    return min((self._improve(other) for other in better), key=self._sense)
            tried = step
        self.curves_down = True
        return None

    def every_branch(self, starts: Sequence[np.ndarray]) -> tuple[Branch | None, Outcome]:
        """Return the best of all branches, and the outcome; for a few pairs.

        starts: points (n,) in the columns of the problem without products [variable units]
        DIVERGED if one branch is unbounded, INFEASIBLE only if all are infeasible from every start.
        Raises the errors of `formulations.ipopt.solve`.
        """
        best, outcomes = None, set[Outcome]()
        for closed in itertools.product((True, False), repeat=len(self._columns.first)):
            for start in starts:
                if self._budget.is_over:
                    return (
                        best,
                        Outcome.TIME_LIMIT if self._budget.is_late else Outcome.ITERATION_LIMIT,
                    )
                branch = self._solve_anew(np.array(closed), start)
                assert self.last is not None
                outcomes.add(self.last.outcome)
                if branch is not None:
                    best = branch if best is None or self._is_better(branch, best) else best
                    break
        if self.unbounded:
            return best, Outcome.DIVERGED
        if best is not None:
            return self._improve(best), Outcome.SOLVED
        return None, Outcome.INFEASIBLE if outcomes == {Outcome.INFEASIBLE} else Outcome.STALLED

    def nearest_branch(
        self, start: np.ndarray, iterations: float
    ) -> tuple[Branch | None, Outcome, int]:
        """Return the first solvable one of the NEAREST branches, the outcome, and the number tried.

        start: (n,) point in the columns of the problem without products [variable units]
        iterations: limit after which no branch starts [-]
        Raises the errors of `formulations.ipopt.solve`.
        """
        first, second = self._columns.pair_values(start)
        every = np.array(list(itertools.product((True, False), repeat=len(first))))
        distance = np.where(every, first, second).sum(axis=1)
        outcomes, tried, most = set[Outcome](), 0, self._budget.iterations + iterations
        for closed in every[np.argsort(distance, kind="stable")[:NEAREST]]:
            if self._budget.is_over:
                return None, Outcome.TIME_LIMIT, tried
            if self._budget.iterations > most:
                break
            branch, tried = self._solve_anew(closed, start), tried + 1
            if branch is not None:
                return self._improve(branch), Outcome.SOLVED, tried
            assert self.last is not None
            outcomes.add(self.last.outcome)
        return (
            None,
            Outcome.INFEASIBLE if outcomes == {Outcome.INFEASIBLE} else Outcome.STALLED,
            tried,
        )

    def _repair(self, first: np.ndarray, second: np.ndarray, point: np.ndarray) -> Branch | None:
        closed = first < second
        ambiguous = np.argsort(np.maximum(first, second) + np.abs(first - second))[
            : self._settings.max_biactive
        ]
        ambiguous = [k for k in ambiguous if max(first[k], second[k]) < 1e-2]
        for k in ambiguous:
            branch = self._solve(_switched(closed, [k]), point)
            if branch is not None:
                return branch
        return None

    def _improve(self, branch: Branch) -> Branch:
        while not branch.is_strong and not self._budget.is_over:
            better = self._best_neighbour(branch)
            if better is None:
                return branch
            branch = better
        return branch

    def _best_neighbour(self, branch: Branch) -> Branch | None:
        wanting = np.flatnonzero(branch.wanting)
        together = self._try(branch, wanting)
        if together is not None:
            return together
        singles = [self._try(branch, [k]) for k in wanting[:32]] if len(wanting) > 1 else []
        better = [single for single in singles if single is not None]
        biactive = np.flatnonzero(branch.biactive)
        if not better and len(biactive) <= self._settings.max_biactive:
            subsets = itertools.chain.from_iterable(
                itertools.combinations(biactive, size) for size in range(1, len(biactive) + 1)
            )
            better = [
                other
                for other in (self._try(branch, list(subset)) for subset in subsets)
                if other is not None
            ]
        return min(better, key=self._sense, default=None)

    def _sense(self, branch: Branch) -> float:
        return self._columns.problem.sense * branch.objective

    def _try(self, branch: Branch, switch: Any) -> Branch | None:
        if self._budget.is_over:
            return None
        other = self._solve(_switched(branch.closed, switch), branch.x)
        return other if other is not None and self._is_better(other, branch) else None

    def _is_better(self, other: Branch, branch: Branch) -> bool:
        return self._sense(other) < self._sense(branch) - BETTER * max(1.0, abs(branch.objective))

    def _solve(self, closed: np.ndarray, point: np.ndarray) -> Branch | None:
        key = np.packbits(closed).tobytes()
        if key not in self._known:
            self._known[key] = self._solve_anew(closed, point)
        return self._known[key]

    def _hold(self, closed: np.ndarray) -> tuple[IpoptProblem, np.ndarray]:
        """Set the bounds of a branch; return the problem and the fixed columns."""
        problem, columns = self._columns.problem, self._columns
        low, high, row_low, row_high = (bound.copy() for bound in self._columns.bounds)
        held = np.where(closed, columns.first, columns.second)
        high[held] = np.minimum(high[held], 0.0)
        # If v equals a user's variable u, both are fixed and the row between them is dropped. Its
        # tolerance would allow x = 5e-13, y = 2e12 with x y >= 1. Both bounds are one side.
        twins = closed & (columns.twin >= 0)
        high[columns.twin[twins]] = np.minimum(high[columns.twin[twins]], 0.0)
        row_low[columns.twin_row[twins]], row_high[columns.twin_row[twins]] = -np.inf, np.inf
        problem.lower, problem.upper, problem.constraint_lower, problem.constraint_upper = (
            low,
            high,
            row_low,
            row_high,
        )
        return problem, held

    def _solve_anew(self, closed: np.ndarray, point: np.ndarray) -> Branch | None:
        columns, (problem, held) = self._columns, self._hold(closed)
        options = {
            "max_iter": min(self._settings.step_iterations, _BRANCH_ITERATIONS),
            "bound_relax_factor": 0.0,
            "tol": 1e-9,
            **self._settings.ipopt,
        }
        start = Start(x=np.clip(point, problem.lower, np.maximum(problem.lower, problem.upper)))
        result = self._budget.run(problem, options, start)
        if not result.solved and result.status in _CLAIMS_SUCCESS and not self._budget.is_over:
            # Dependent rows (a pair stated twice, fixed on the same side) give multipliers of 1e17
            # that cancel; regularising the rows keeps them finite. With as many equations as free
            # variables Ipopt ignores the objective; relaxed fixed variables prevent this.
            free, equal = (
                problem.lower < problem.upper,
                problem.constraint_lower == problem.constraint_upper,
            )
            anew = (
                _LOOSELY_HELD
                if np.count_nonzero(free) == np.count_nonzero(equal)
                else {"perturb_always_cd": "yes"}
            )
            again = self._budget.run(problem, {**options, **anew, **self._settings.ipopt}, start)
            result = again if again.solved else result
        self.last = result
        self.unbounded = self.unbounded or result.outcome is Outcome.DIVERGED
        # A branch with a single point may have no multipliers: the certificate decides.
        if result.solved or (result.status in _CLAIMS_SUCCESS and result.residuals.feasible):
            better = self._refined(problem, result, options)
        elif (
            result.outcome in (Outcome.ITERATION_LIMIT, Outcome.STALLED)
            and result.residuals.feasible
            and not self._budget.is_over
        ):
            # Ipopt's steps are short near a maximum; Newton's method may make the point exact.
            better = refined(problem, result, self._size)
            if better.error > _EXACT:
                return None
        else:
            return None
        x = better.x
        first, second = columns.pair_values(x)
        slope = _bound_multipliers(columns, x, better.lagrange)
        return Branch(
            closed=closed.copy(),
            x=x,
            lagrange=better.lagrange,
            objective=problem.sense * problem.objective(x),
            biactive=np.maximum(first, second) <= _BIACTIVE,
            multipliers=slope[held],
            slope=slope,
        )

    def _refined(
        self, problem: IpoptProblem, result: IpoptResult, options: dict[str, Any]
    ) -> Refined:
        better = refined(problem, result, self._size)
        size = min(self._size, problem.slope_size(better.x))
        if better.error <= _UNREFINED or not size > 0.0 or self._budget.is_over:
            return better
        tight = {
            **options,
            "tol": max(_TIGHTEST, options["tol"] * min(size**2, _TIGHTER)),
            "mu_init": _SMALL_BARRIER,
        }
        scaled = self._budget.run(
            problem, tight, Start(x=result.x, lagrange=result.lagrange, zl=result.zl, zu=result.zu)
        )
        repeated = refined(problem, scaled, self._size) if scaled.solved else better
        return repeated if repeated.error < better.error else better


def _bound_multipliers(columns: Columns, x: np.ndarray, lagrange: np.ndarray) -> np.ndarray:
    """Return zl - zu (n,) from stationarity, with free signs.

    If v equals a user's variable u, both have the sum: they are one side of a pair.
    """
    slope = columns.problem.lagrangian_gradient(x, lagrange)
    twins = columns.twin >= 0
    np.add.at(slope, columns.twin[twins], slope[columns.first[twins]])
    slope[columns.first[twins]] = slope[columns.twin[twins]]
    return slope


def _switched(closed: np.ndarray, switch: Any) -> np.ndarray:
    other = closed.copy()
    other[switch] = ~other[switch]
    return other

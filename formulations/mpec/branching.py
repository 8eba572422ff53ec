"""Every pair decided: which side is 0 is fixed, and what remains is a smooth problem, solved exactly. Pairs with both sides 0 branch.

At a solution of a branch a pair with v = 0 = w has a multiplier on the side that is held at 0.
Where it is negative, the other branch goes down to first order. Those pairs are switched, all at
once, then one by one, then - where there are few - in every combination, and the best branch is
kept.

A branch is refined from Ipopt's answer to the vertex or face it stands beside, where active bounds
and rows hold to rounding, multipliers too: Ipopt stops at about 1e-9 from its bounds, and at 1e-5
from those whose multiplier is zero. Here the active set is guessed, variables with an active bound
are put on it, and Newton's method solves the equations that remain. A guess is taken only where it
makes the point better.
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

# A pair counts as biactive where both sides are below this, and as wanting the other branch where
# its multiplier is below -_WANTING.
_BIACTIVE = 1e-6
_WANTING = 1e-6
# Where nothing feasible is known so many branches are tried, until one is: of 8 pairs all. They
# cost some 10 ms each where a problem is small.
NEAREST = 256
# What counts as a better objective, relative to max(1, |objective|).
BETTER = 1e-9
# A branch is a smooth problem started near its solution, or one without any: no need to insist.
_BRANCH_ITERATIONS = 200
# Ipopt's codes for a point that it takes for a solution, in its own scaling.
_CLAIMS_SUCCESS = (0, 1)

# Where variables are held within 1e-9; refining the solution puts them back.
_LOOSELY_HELD = {"fixed_variable_treatment": "relax_bounds", "bound_relax_factor": 1e-9}

# Newton's steps of one guess: it converges quadratically or not at all.
_STEPS = 6
# Up to this many unknowns a dense least-squares solve, which does not mind dependent rows or flat
# directions.
_DENSE = 150
# Regularisation of the sparse solve: small steps are repeated, so it costs iterations and no
# accuracy.
_DELTA = 1e-9
# A refined point is the same solution: its objective may differ by this (relative to max(1,
# |objective|)), and each step by _LONGEST.
_SAME = 1e-5
_LONGEST = 1e-1
# A guess that leaves no more than this is not improved on.
_GOOD_ENOUGH = 1e-13
# A refined point may violate rows and bounds by this, or by as much as Ipopt's did.
_STAYS_FEASIBLE = 1e-9
# Where more than this is left, Ipopt's tolerance was too loose to tell what is active: once more
# from there with a tighter one, by this at least, and by more where the objective is flat.
_UNREFINED = 1e-6
_TIGHTER = 1e-3
_TIGHTEST = 1e-14
# The barrier that a solve begins with which goes on from a solution.
_SMALL_BARRIER = 1e-10
# A curvature below this, of the sum of what its terms are without their signs, is more than
# rounding and the errors of multipliers.
_CURVED = 1e-6
# Multipliers of a point with a larger error say too little about what is active.
_EXACT = 1e-9
# The step along a direction of negative curvature: of its largest component, relative to max(1,
# |x|).
_ASIDE = 0.1
# Steps of Lanczos's method, each two solves with one factorisation.
_LANCZOS = 20
# A vector of which no more than this is left spans nothing new, and a direction of length 1 that
# changes a row by no more keeps it.
_EXHAUSTED = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """x (n,), lagrange (m,) and how far they are from a KKT point: largest of violation, slope and wrong sign."""

    x: np.ndarray
    lagrange: np.ndarray
    error: float


def refined(problem: IpoptProblem, result: IpoptResult, size: float = 1.0) -> Refined:
    """The best of the given point and three guesses of what is active.

    Bounds are those of the problem as it stands.

    Raises nothing.

    Parameters
    ----------
    problem, result : a problem, and where Ipopt ended
    size : of the objective's derivatives, by which errors are measured where those at the point are
        smaller [objective per variable]
    """
    best = Refined(
        x=result.x,
        lagrange=result.lagrange,
        error=_kkt_error(problem, result.x, result.lagrange, size),
    )
    limit = _SAME * max(1.0, abs(result.objective))
    feasible = max(
        _STAYS_FEASIBLE, problem.violation(result.x)
    )  # slopes are of the objective's unit: what they gain is no price for feasibility
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
    """Largest of: violation, slope of a free variable, slope or multiplier with the wrong sign.

    Slopes relative to the objective's.
    """
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
    """Newton on what is active if everything within `near` of its limit is (and, by_multiplier, pulls harder than it is far)."""
    x, y = result.x.copy(), result.lagrange.copy()
    low, high = problem.lower, problem.upper

    size = min(1.0, problem.slope_size(x))

    def active(gap: np.ndarray, multiplier: np.ndarray) -> np.ndarray:
        """Mask (k,) of the limits at distance gap (k,) with multiplier (k,) that are active [-].

        Raises nothing.
        """
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
    """(step of the free variables, new multipliers of the active rows)."""
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
    right[len(free) :] -= (
        _DELTA * y[rows]
    )  # a proximal step: the regularisation vanishes as the multipliers settle
    try:
        return splu((system + sparse.diags(signs)).tocsc()).solve(right)
    except RuntimeError:  # singular in spite of the regularisation
        return None


def _hessian(problem: IpoptProblem, x: np.ndarray, y: np.ndarray) -> sparse.csr_matrix:
    """Of the Lagrangian, both triangles (n, n)."""
    lower = sparse.csr_matrix(
        (problem.hessian(x, y, 1.0), problem.hessianstructure()), shape=(problem.n, problem.n)
    )
    return (lower + sparse.tril(lower, -1).T).tocsr()


def step_aside(
    problem: IpoptProblem, x: np.ndarray, lagrange: np.ndarray, weak: float
) -> np.ndarray | None:
    """A step (n,) by which the Lagrangian falls to second order, while what is active keeps its value to first order; None where none is found.

    Raises nothing.

    Parameters
    ----------
    problem : with the bounds as they are to hold
    x, lagrange : (n,), (m,) a point that is stationary with these multipliers [units of the
        variables, objective per constraint]
    weak : an inequality need not keep its value where its multiplier is no more than this
        [objective per variable]
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
    direction = ways @ np.random.default_rng(0).normal(
        size=ways.shape[1]
    )  # along one alone the others would be left at their maximum
    step = np.zeros(problem.n)
    step[free] = direction * (_ASIDE / np.max(np.abs(direction) / np.maximum(1.0, np.abs(x[free]))))
    gain = -0.5 * float(step[free] @ (hessian @ step[free]))
    return step if gain > BETTER * max(1.0, abs(problem.objective(x))) else None


def _curving_down(hessian: sparse.csr_matrix, jacobian: sparse.csr_matrix) -> np.ndarray:
    """Orthogonal directions (n, k) of length 1, in the null space of the Jacobian, of negative curvature; with many unknowns those that Lanczos's method finds."""
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
    """Orthogonal directions (n, k) of length 1 that keep the rows: a random one, and what the Hessian makes of it again and again."""
    n, m = hessian.shape[0], rows.shape[0]
    try:
        factors = splu(
            sparse.bmat([[sparse.eye(n), rows.T], [rows, -_DELTA * sparse.eye(m)]], format="csc")
        )
    except RuntimeError:  # singular in spite of the regularisation
        return np.zeros((n, 0))
    span = np.zeros((n, 0))
    vector = np.random.default_rng(0).normal(size=n)
    for _ in range(_LANCZOS):
        size = np.linalg.norm(vector)
        for _ in range(
            2
        ):  # once leaves of the rows and of the others what the regularisation and rounding do
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

    closed: (pairs,) True where v is held at 0, else w; x (n,), lagrange (m,) refined; biactive:
        (pairs,) both sides 0; multipliers: (pairs,) of the held
    side of each pair; slope (n,): `_bound_multipliers`
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
        """Whether no biactive pair wants its other branch."""
        return not bool(np.any(self.wanting))

    @property
    def wanting(self) -> np.ndarray:
        """Mask (pairs,) of biactive pairs that want their other branch [-]. Raises nothing."""
        return self.biactive & (self.multipliers < -_WANTING)


class Branching:
    """The branches of one problem: each solved once from a point of the relaxation, anew once a saddle is left, and improved pair by pair."""

    def __init__(self, work: Workspace, start: np.ndarray) -> None:
        self._work, self._settings, self._budget = work, work.settings, work.budget
        self._columns = work.branches
        self._known: dict[bytes, Branch | None] = {}
        self.last: IpoptResult | None = None
        self.unbounded = False  # whether some branch turned out to be
        # whether the branch last given to `past_saddle` does, and it found none that is better
        self.curves_down = False
        self._size = work.branches.problem.slope_size_nearby(work.branch_point(start))

    def polish(self, x: np.ndarray) -> Branch | None:
        """The best branch reached from a point of the relaxation.

        None if the branch read off has no solution.

        Raises what `formulations.ipopt.solve` does.

        Parameters
        ----------
        x : (n,) point of the relaxation [units of the variables]
        """
        point = self._work.branch_point(x)
        first, second = self._columns.pair_values(point)
        branch = self._solve(first < second, point)
        if branch is None:
            branch = self._repair(first, second, point)
        return None if branch is None else self._improve(branch)

    def search(self, branch: Branch, start: np.ndarray) -> Branch:
        """Local search beyond the nearest solution: decide one pair after the other otherwise, go where it is better, until no neighbour is.

        Raises what `formulations.ipopt.solve` does.

        Parameters
        ----------
        branch : where to begin
        start : (n,) where the user started, in the relaxation's columns [units of the variables];
            the branch found is solved from there too, since it may be
            curved
        """
        if len(branch.closed) > self._settings.search:
            return branch
        again = self._solve_anew(branch.closed, self._work.branch_point(start))
        if again is not None and self._is_better(again, branch):
            branch = self._improve(again)
        while True:
            neighbours = [self._try(branch, [k]) for k in range(len(branch.closed))]
            found = [self._improve(neighbour) for neighbour in neighbours if neighbour is not None]
            if not found:
                return branch
            branch = min(found, key=self._sense)

    def past_saddle(self, branch: Branch) -> Branch | None:
        """A better point of the same branch where its Lagrangian curves downwards (a maximum, a saddle); None where it does not, or none is found.

        `curves_down` says afterwards whether it does, in both senses of a direction that keeps all
        that is active, and none was found.

        Raises what `formulations.ipopt.solve` does.

        Parameters
        ----------
        branch : where first order sees no way down
        """
        self.curves_down = False
        if _kkt_error(self._hold(branch.closed)[0], branch.x, branch.lagrange, self._size) > _EXACT:
            return None
        tried: np.ndarray | None = None
        for weak in (_WANTING * self._size, -np.inf):
            step = step_aside(self._hold(branch.closed)[0], branch.x, branch.lagrange, weak)
            if step is None:  # nor is there one that keeps more
                return None
            if tried is None or not np.array_equal(step, tried):
                found = [
                    self._solve_anew(branch.closed, branch.x + sign * step)
                    for sign in (1.0, -1.0)
                    if not self._budget.is_over
                ]
                better = [
                    other for other in found if other is not None and self._is_better(other, branch)
                ]
                if better:
                    # solved from the saddle other branches may end at saddles too
                    self._known.clear()
                    return min((self._improve(other) for other in better), key=self._sense)
            tried = step
        self.curves_down = True
        return None

    def every_branch(self, starts: Sequence[np.ndarray]) -> tuple[Branch | None, Outcome]:
        """The best of all branches, improved, and how it ended: for a few pairs of which no branch is known.

        Raises what `formulations.ipopt.solve` does.

        Parameters
        ----------
        starts : points (n,) in the columns of the problem without products [units of the variables]

        Returns
        -------
        branch or None, and outcome: DIVERGED where a branch is; INFEASIBLE only where each is from
            every start
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
        """The first branch that has a solution, of the NEAREST to a point, how it ended, as in `every_branch`, and how many were tried.

        Raises what `formulations.ipopt.solve` does.

        Parameters
        ----------
        start : (n,) point in the columns of the problem without products [units of the variables]
        iterations : no branch is begun after so many [-]
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

    # -- branches
    #   -----------------------------------------------------------------------------------------------------------------

    def _repair(self, first: np.ndarray, second: np.ndarray, point: np.ndarray) -> Branch | None:
        """The branch read off has no solution: decide the least clear pairs otherwise."""
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
        found = [single for single in singles if single is not None]
        biactive = np.flatnonzero(branch.biactive)
        if not found and len(biactive) <= self._settings.max_biactive:
            subsets = itertools.chain.from_iterable(
                itertools.combinations(biactive, size) for size in range(1, len(biactive) + 1)
            )
            found = [
                other
                for other in (self._try(branch, list(subset)) for subset in subsets)
                if other is not None
            ]
        return min(found, key=self._sense, default=None)

    def _sense(self, branch: Branch) -> float:
        return self._columns.problem.sense * branch.objective

    def _try(self, branch: Branch, switch: Any) -> Branch | None:
        """The branch with these pairs switched, if it is better."""
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
        """The problem with the bounds of a branch, and the columns (pairs,) that it holds at 0."""
        problem, columns = self._columns.problem, self._columns
        low, high, row_low, row_high = (bound.copy() for bound in self._columns.bounds)
        held = np.where(closed, columns.first, columns.second)
        high[held] = np.minimum(high[held], 0.0)
        # Where v equals a variable u of the user both are held and the row between them says
        # nothing more: a row holds within a tolerance only, and x = 5e-13 beside y = 2e12 would
        # satisfy x y >= 1. (It also makes them one side, with one multiplier.)
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
            # Rows that say the same twice (a pair stated twice, held on the same side): multipliers
            # of 1e17 that cancel, and a point off the solution. With the rows' block always
            # regularised they stay finite. Where they make as many equations as free variables,
            # Ipopt takes the objective for settled; with the held ones a little loose, as it does
            # itself where there are more, it does not.
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
        # Where a branch has a single point, say, its multipliers may not exist: the point counts,
        # and the certificate judges it.
        if result.solved or (result.status in _CLAIMS_SUCCESS and result.residuals.feasible):
            better = self._refined(problem, result, options)
        elif (
            result.outcome in (Outcome.ITERATION_LIMIT, Outcome.STALLED)
            and result.residuals.feasible
            and not self._budget.is_over
        ):
            better = refined(
                problem, result, self._size
            )  # Ipopt's steps are short near a maximum: a point that Newton's make exact is one
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
        again = refined(problem, scaled, self._size) if scaled.solved else better
        return again if again.error < better.error else better


def _bound_multipliers(columns: Columns, x: np.ndarray, lagrange: np.ndarray) -> np.ndarray:
    """What stationarity leaves to the bounds of each variable (n,), zl - zu with the signs free.

    Where v equals a variable u of the user both hold the sum: they are one side of a pair.
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

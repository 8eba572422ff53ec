"""Every pair decided: which side is 0 is fixed, and what remains is a smooth problem, solved exactly. Pairs with both sides 0 branch.

At a solution of a branch a pair with v = 0 = w has a multiplier on the side that is held at 0. Where it is negative, the other branch goes
down to first order. Those pairs are switched, all at once, then one by one, then - where there are few - in every combination, and the best
branch is kept.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from formulations.ipopt import IpoptResult, Start
from formulations.mpec.homotopy import WorkBudget
from formulations.mpec.refine import refined
from formulations.mpec.settings import MpecSettings
from formulations.mpec.workspace import Columns, Workspace
from formulations.solution import Outcome

# A pair counts as biactive where both sides are below this, and as wanting the other branch where its multiplier is below -_WANTING.
_BIACTIVE, _WANTING = 1e-6, 1e-6
# What counts as a better objective, relative to max(1, |objective|).
_BETTER = 1e-9
# A branch is a smooth problem started near its solution, or one without any: no need to insist.
_BRANCH_ITERATIONS = 200
# Ipopt's codes for a point that it takes for a solution, in its own scaling.
_CLAIMS_SUCCESS = (0, 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Branch:
    """A solved branch.

    closed: (pairs,) True where v is held at 0, else w; x (n,), lagrange (m,) refined; biactive: (pairs,) both sides 0; multipliers: (pairs,) of the held
    side of each pair; slope (n,): `_bound_multipliers`
    """

    closed: np.ndarray
    result: IpoptResult
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
        """Mask (pairs,) of biactive pairs that want their other branch [-]."""
        return self.biactive & (self.multipliers < -_WANTING)


class Branching:
    """The branches of one problem: each solved at most once from a point of the relaxation, and improved pair by pair."""

    def __init__(self, work: Workspace, settings: MpecSettings, budget: WorkBudget) -> None:
        self._work, self._settings, self._budget = work, settings, budget
        self._columns = work.branches
        self._known: dict[bytes, Branch | None] = {}
        self.last: IpoptResult | None = None
        self.unbounded = False  # whether some branch turned out to be

    def polish(self, x: np.ndarray) -> Branch | None:
        """The best branch reached from a point of the relaxation; None if the branch read off has no solution.

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

        Parameters
        ----------
        branch : where to begin
        start : (n,) where the user started, in the relaxation's columns [units of the variables]; the branch found is solved from there too, since it may be
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

    def every_branch(self, starts: Sequence[np.ndarray]) -> tuple[Branch | None, Outcome]:
        """The best of all branches, improved, and how it ended: for a few pairs of which no branch is known.

        Parameters
        ----------
        starts : points (n,) in the columns of the problem without products [units of the variables]

        Returns
        -------
        branch or None, and outcome: DIVERGED where a branch is; INFEASIBLE only where each is from every start
        """
        best, outcomes = None, set[Outcome]()
        for closed in itertools.product((True, False), repeat=len(self._columns.first)):
            for start in starts:
                if self._budget.is_over:
                    return best, Outcome.TIME_LIMIT
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

    # -- branches -----------------------------------------------------------------------------------------------------------------

    def _repair(self, first: np.ndarray, second: np.ndarray, point: np.ndarray) -> Branch | None:
        """The branch read off has no solution: decide the least clear pairs otherwise."""
        closed = first < second
        ambiguous = np.argsort(np.maximum(first, second) + np.abs(first - second))[: self._settings.max_biactive]
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
            subsets = itertools.chain.from_iterable(itertools.combinations(biactive, size) for size in range(1, len(biactive) + 1))
            found = [other for other in (self._try(branch, list(subset)) for subset in subsets) if other is not None]
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
        return self._sense(other) < self._sense(branch) - _BETTER * max(1.0, abs(branch.objective))

    def _solve(self, closed: np.ndarray, point: np.ndarray) -> Branch | None:
        key = np.packbits(closed).tobytes()
        if key not in self._known:
            self._known[key] = self._solve_anew(closed, point)
        return self._known[key]

    def _solve_anew(self, closed: np.ndarray, point: np.ndarray) -> Branch | None:
        problem, columns = self._columns.problem, self._columns
        low, high, row_low, row_high = (bound.copy() for bound in self._work.branch_bounds)
        held = np.where(closed, columns.first, columns.second)
        high[held] = np.minimum(high[held], 0.0)
        # Where v equals a variable u of the user both are held and the row between them says nothing more: a row holds within a tolerance
        # only, and x = 5e-13 beside y = 2e12 would satisfy x y >= 1. (It also makes them one side, with one multiplier.)
        twins = closed & (columns.twin >= 0)
        high[columns.twin[twins]] = np.minimum(high[columns.twin[twins]], 0.0)
        row_low[columns.twin_row[twins]], row_high[columns.twin_row[twins]] = -np.inf, np.inf
        problem.lower, problem.upper, problem.constraint_lower, problem.constraint_upper = low, high, row_low, row_high
        options = {
            "max_iter": min(self._settings.step_iterations, _BRANCH_ITERATIONS),
            "bound_relax_factor": 0.0,
            "tol": 1e-9,
            **self._settings.ipopt,
        }
        start = Start(x=np.clip(point, low, np.maximum(low, high)))
        result = self._budget.run(problem, options, start)
        if not result.solved and result.status in _CLAIMS_SUCCESS and not self._budget.is_over:
            # Rows that say the same twice (a pair stated twice, held on the same side): multipliers of 1e17 that cancel, and a point off the
            # solution. With the rows' block always regularised they stay finite.
            again = self._budget.run(problem, {"perturb_always_cd": "yes", **options}, start)
            result = again if again.solved else result
        self.last = result
        self.unbounded = self.unbounded or result.outcome is Outcome.DIVERGED
        # Where a branch has a single point, say, its multipliers may not exist: the point counts, and the certificate judges it.
        usable = result.solved or (result.status in _CLAIMS_SUCCESS and result.residuals.feasible)
        if not usable:
            return None
        better = refined(problem, result)
        x = better.x
        first, second = columns.pair_values(x)
        slope = _bound_multipliers(columns, x, better.lagrange)
        return Branch(
            closed=closed.copy(),
            result=result,
            x=x,
            lagrange=better.lagrange,
            objective=problem.sense * problem.objective(x),
            biactive=np.maximum(first, second) <= _BIACTIVE,
            multipliers=slope[held],
            slope=slope,
        )


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

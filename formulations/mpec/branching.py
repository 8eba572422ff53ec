"""Every pair decided: which side is 0 is fixed, and what remains is a smooth problem, solved exactly. Pairs with both sides 0 branch.

At a solution of a branch a pair with v = 0 = w has a multiplier on the side that is held at 0. Where it is negative, the other branch goes
down to first order. Those pairs are switched, all at once, then one by one, then - where there are few - in every combination, and the best
branch is kept.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from formulations.ipopt import IpoptResult, Start
from formulations.mpec.homotopy import Account
from formulations.mpec.refine import refined
from formulations.mpec.settings import Settings
from formulations.mpec.workspace import Workspace
from formulations.solution import Outcome

# A pair counts as biactive where both sides are below this, and as wanting the other branch where its multiplier is below -_WANTING.
_BIACTIVE, _WANTING = 1e-6, 1e-6
# What counts as a better objective, relative to max(1, |objective|).
_BETTER = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Branch:
    """A solved branch. closed: (pairs,) True where v is held at 0, else w; x refined; multiplier of the held side of each pair."""

    closed: np.ndarray
    result: IpoptResult
    x: np.ndarray
    objective: float
    biactive: np.ndarray
    multipliers: np.ndarray

    @property
    def is_strong(self) -> bool:
        """Whether no biactive pair wants its other branch."""
        return not bool(np.any(self.wanting))

    @property
    def wanting(self) -> np.ndarray:
        return self.biactive & (self.multipliers < -_WANTING)


class Branching:
    def __init__(self, work: Workspace, settings: Settings, account: Account) -> None:
        self._work, self._settings, self._account = work, settings, account
        self._columns = work.branches
        self._known: dict[bytes, Branch | None] = {}
        self.last: IpoptResult | None = None

    def polish(self, x: np.ndarray) -> Branch | None:
        """The best branch reached from a point of the relaxation; None if the branch read off has no solution."""
        point = self._work.branch_point(x)
        first, second = self._columns.pair_values(point)
        branch = self._solve(first < second, point)
        if branch is None:
            branch = self._repair(first, second, point)
        return None if branch is None else self._improve(branch)

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
        while not branch.is_strong and not self._account.is_over:
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
        if self._account.is_over:
            return None
        other = self._solve(_switched(branch.closed, switch), branch.x)
        margin = _BETTER * max(1.0, abs(branch.objective))
        return other if other is not None and self._sense(other) < self._sense(branch) - margin else None

    def _solve(self, closed: np.ndarray, point: np.ndarray) -> Branch | None:
        key = np.packbits(closed).tobytes()
        if key not in self._known:
            self._known[key] = self._solve_anew(closed, point)
        return self._known[key]

    def _solve_anew(self, closed: np.ndarray, point: np.ndarray) -> Branch | None:
        problem, columns = self._columns.problem, self._columns
        low, high = (bound.copy() for bound in self._work.branch_bounds)
        held = np.where(closed, columns.first, columns.second)
        high[held] = np.minimum(high[held], 0.0)
        problem.lower, problem.upper = low, high
        options = {"max_iter": self._settings.step_iterations, "bound_relax_factor": 0.0, "tol": 1e-9, **self._settings.ipopt}
        start = Start(x=np.clip(point, low, np.maximum(low, high)))
        result = self._account.run(problem, options, start)
        self.last = result
        usable = result.solved or (
            result.outcome is Outcome.STALLED and result.residuals.feasible and result.residuals.relative_dual < 1e-4
        )
        if not usable:
            return None
        x = refined(problem, result)
        first, second = columns.pair_values(x)
        slope = lagrangian_slope(problem, x, result.lagrange)
        return Branch(
            closed=closed.copy(),
            result=result,
            x=x,
            objective=problem.sense * problem.objective(x),
            biactive=np.maximum(first, second) <= _BIACTIVE,
            multipliers=slope[held],
        )


def lagrangian_slope(problem: Any, x: np.ndarray, lagrange: np.ndarray) -> np.ndarray:
    """Gradient of f + lagrange' g at x (n,): at a solution it is zl - zu."""
    rows, columns = problem.jacobianstructure()
    return problem.gradient(x) + np.bincount(columns, problem.jacobian(x) * lagrange[rows], problem.n)


def _switched(closed: np.ndarray, switch: Any) -> np.ndarray:
    other = closed.copy()
    other[switch] = ~other[switch]
    return other

"""Results of an MPEC solve: judge a candidate, and map it to the user's components."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

import numpy as np
from pyomo.common.collections import ComponentMap
from pyomo.core.base.var import VarData
from pyomo.core.expr import value

from formulations.certificate.certificate import Certificate, Multipliers
from formulations.ipopt.result import write_point
from formulations.mpec.branching import Branch
from formulations.mpec.homotopy import Columns, PathPoint, Step, Workspace
from formulations.mpec.lifted import relation_of
from formulations.solution import Outcome


def verdict(
    candidate: Candidate, residual: float, certificate: Certificate | None
) -> tuple[Outcome, str]:
    """Return outcome and sentence of a candidate with a point."""
    summary = f"{candidate.work.strategy.name}: " + (
        certificate.sentence
        if certificate
        else f"complementarity {residual:.1e}, no certificate requested"
    )
    if candidate.branch is None and candidate.outcome is not Outcome.SOLVED:
        return candidate.outcome, f"{candidate.message}; {summary}"
    if certificate is not None and certificate.lives_on_tolerance:
        return Outcome.STALLED, f"the point holds only within tolerances; {summary}"
    if certificate is not None and certificate.endless and not certificate.b_stationary:
        return Outcome.STALLED, summary
    if certificate is not None and not certificate.feasible:
        worst = f" (worst: {certificate.worst})" if certificate.worst else ""
        return Outcome.STALLED, f"the point found is not feasible{worst}; {summary}"
    if residual > candidate.work.settings.complementarity_tolerance:
        return Outcome.STALLED, f"the pairs could not be decided; {summary}"
    if candidate.curves_down:
        if candidate.unbounded:
            return (
                Outcome.DIVERGED,
                f"a branch of the problem is unbounded, and the objective curves down towards it from a stationary point; {summary}",
            )
        summary = f"{summary}; its Lagrangian curves downwards along a direction, but no better point was found there"
    if certificate is not None and certificate.b_stationary is False:
        if candidate.unbounded:
            return (
                Outcome.DIVERGED,
                f"a branch of the problem is unbounded, and a direction goes down towards it; {summary}",
            )
        return Outcome.STALLED, f"the point is feasible, but a direction goes down; {summary}"
    return Outcome.SOLVED, summary


def outcome_without_point(candidate: Candidate) -> tuple[Outcome, str]:
    """Return outcome and sentence if no relaxation was solved."""
    if candidate.work.budget.is_late:
        return (
            Outcome.TIME_LIMIT,
            f"the time limit was reached before any relaxation was solved; {candidate.message}",
        )
    if candidate.outcome is Outcome.SOLVED:
        return Outcome.FAILED, "no relaxation was solved, for no known reason"
    return candidate.outcome, candidate.message


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """The result of one strategy: a branch, or only a point of its relaxation, or neither.

    unbounded: whether a branch was unbounded
    curves_down: whether the branch has negative curvature, and no better branch was found
    """

    work: Workspace
    branch: Branch | None
    point: PathPoint | None
    outcome: Outcome
    message: str
    unbounded: bool = False
    curves_down: bool = False

    @property
    def columns(self) -> Columns:
        """Return the columns of the point."""
        return (
            self.work.relaxed
            if self.branch is None and self.point is not None
            else self.work.branches
        )

    @property
    def sense(self) -> int:
        """Return 1 to minimise, -1 to maximise."""
        return self.work.branches.problem.sense

    @property
    def objective(self) -> float:
        """Return the objective in the model's own sense without a penalty, NaN without a point."""
        if self.branch is not None:
            return self.branch.objective
        return (
            math.nan
            if self.point is None
            else self.sense
            * self.work.branches.problem.objective(self.work.branch_point(self.point.x))
        )

    @property
    def x(self) -> np.ndarray | None:
        """Return the point (columns,) [variable units], or None. Raises nothing."""
        result = self.branch or self.point
        return None if result is None else result.x


@dataclass(frozen=True, kw_only=True)
class StrategyAttempt:
    """The result of one strategy from one start (0: the user's, else the seed).

    objective: in the model's own sense, NaN without a point
    outcome: SOLVED if a branch was found, and not refuted; only improvements are certified
    """

    strategy: str
    start: int
    outcome: Outcome
    objective: float
    iterations: int


@dataclass(frozen=True, kw_only=True, eq=False)
class PairState:
    """The values of a complementarity's two sides, and their multipliers (NaN without polish).

    The sides of a box l <= body <= u are the distance to the nearer bound and the free expression.
    """

    name: str
    first: float
    second: float
    first_multiplier: float
    second_multiplier: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MpecResult:
    """The result of a solve; objective in the model's own sense.

    - variables, x: (n,) the user's variables and their values
    - rows, lagrange: (m,) the user's constraints and their multipliers in Ipopt's signs, or NaN
    - zl, zu: (n,) of the bounds, or NaN
    - polished: every pair is decided, and the branch solved exactly
    - has_multipliers: False without polish, or if the branch's multipliers do not fit the point
    - residual: largest min of a pair
    - pair_multipliers: (complementarity, multipliers of its two arguments): the change of the
      objective when the bound of the argument grows
    - attempts: by strategy and start; the best is the answer
    - steps: of all paths
    - certificate: recomputed from the model (None if switched off)
    """

    outcome: Outcome
    message: str
    strategy: str
    variables: tuple[Any, ...]
    x: np.ndarray
    rows: tuple[Any, ...]
    lagrange: np.ndarray
    zl: np.ndarray
    zu: np.ndarray
    sense: int
    objective: float
    polished: bool
    has_multipliers: bool
    residual: float
    pairs: tuple[PairState, ...]
    pair_multipliers: tuple[tuple[Any, tuple[float, float]], ...] = ()
    attempts: tuple[StrategyAttempt, ...] = ()
    steps: tuple[Step, ...] = ()
    iterations: int = 0
    solves: int = 0
    seconds: float = 0.0
    certificate: Certificate | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    has_objective: bool = True

    @property
    def solved(self) -> bool:
        """Return whether the outcome is SOLVED."""
        return self.outcome is Outcome.SOLVED

    @property
    def spread(self) -> float:
        """Return the worst minus the best objective of successful attempts.

        0 for one [objective units].
        """
        objectives = [
            attempt.objective for attempt in self.attempts if attempt.outcome is Outcome.SOLVED
        ]
        return max(objectives) - min(objectives) if objectives else 0.0

    @property
    def has_point(self) -> bool:
        """Return whether x is worth loading."""
        return (
            self.x.size == len(self.variables)
            and bool(np.all(np.isfinite(self.x)))
            and self.outcome.has_answer
        )


def is_feasible(result: MpecResult) -> bool:
    """Return whether the point is known to satisfy the model including complementarity."""
    return result.has_point and result.certificate is not None and result.certificate.feasible


def load(result: MpecResult) -> None:
    """Write x into the variables, marking all other variables stale, as Pyomo's solvers do."""
    write_point(result.variables, result.x)


def result_of(
    candidate: Candidate,
    outcome: Outcome,
    message: str,
    *,
    residual: float = math.nan,
    certificate: Certificate | None = None,
    multipliers: Multipliers | None = None,
) -> MpecResult:
    """Return the result of a candidate, without steps and totals of the whole solve.

    residual: largest min of a pair
    multipliers: of the candidate's branch, if they fit the point
    """
    work, branch, x, settings = (
        candidate.work,
        candidate.branch,
        candidate.x,
        candidate.work.settings,
    )
    problem = candidate.columns.problem
    keep = np.array(
        [k for k, variable in enumerate(problem.variables) if id(variable) not in work.own],
        dtype=np.intp,
    )
    rows = _user_rows(candidate)
    point = np.full(len(keep), np.nan) if x is None else x[keep]
    lagrange, zl, zu = (
        np.full(len(rows), np.nan),
        np.full(len(keep), np.nan),
        np.full(len(keep), np.nan),
    )
    if branch is not None and multipliers is not None:
        multiplier = dict(zip((id(row) for row in problem.equations), branch.lagrange, strict=True))
        lagrange = np.array([multiplier.get(id(row), 0.0) for row in rows])
        slope = branch.slope[keep]
        # Fixed sides keep the sign of their multiplier, which decides the class of stationarity.
        held_low = np.isclose(point, problem.lower[keep], rtol=0.0, atol=1e-9)
        zl, zu = (
            np.where(held_low, slope, np.maximum(slope, 0.0)),
            np.where(held_low, 0.0, np.maximum(-slope, 0.0)),
        )
    return MpecResult(
        outcome=outcome,
        message=message,
        strategy=work.strategy.name,
        variables=tuple(problem.variables[k] for k in keep),
        x=point,
        rows=rows,
        lagrange=lagrange,
        zl=zl,
        zu=zu,
        sense=candidate.sense,
        objective=candidate.objective,
        has_objective=work.branches.problem.objective_data is not None,
        polished=branch is not None,
        has_multipliers=multipliers is not None,
        residual=residual,
        pairs=() if x is None else _pair_states(candidate, x, multipliers is not None),
        pair_multipliers=() if multipliers is None else _pair_multipliers(candidate.sense,
            multipliers),
        certificate=certificate,
        options=MappingProxyType({
            **{item.name: getattr(settings,
                                  item.name) for item in fields(settings) if item.name != "ipopt"},
            "strategy": work.strategy.name, "eps_start": settings.eps_start or work.strategy.first,
            "eps_end": settings.eps_end or work.strategy.last, **settings.ipopt,
        }),
    )  # fmt: skip


def _pair_states(
    candidate: Candidate, x: np.ndarray, with_multipliers: bool
) -> tuple[PairState, ...]:
    lifted, columns = candidate.work.lifted, candidate.columns
    first, second = columns.pair_values(x)
    nu = mu = np.full(len(first), np.nan)
    if candidate.branch is not None and with_multipliers:
        nu, mu = candidate.branch.slope[columns.first], candidate.branch.slope[columns.second]
    states = []
    for k, pair in enumerate(lifted.pairs):
        sides = ((first[k], nu[k]), (second[k], mu[k]))
        (a, a_multiplier), (b, b_multiplier) = sides[::-1] if pair.swapped else sides
        states.append(
            PairState(
                name=pair.condition.name,
                first=a,
                second=b,
                first_multiplier=a_multiplier,
                second_multiplier=b_multiplier,
            )
        )
    return tuple(states)


def multipliers_of(candidate: Candidate) -> Multipliers:
    """Return the branch's multipliers by the user's components, in the certificate's signs."""
    branch, lifted, columns, mine = (
        candidate.branch,
        candidate.work.lifted,
        candidate.work.branches,
        candidate.work.own,
    )
    assert branch is not None
    slope, users = branch.slope, {id(row) for row in _user_rows(candidate)}
    of_rows = list(zip(columns.problem.equations, (-branch.lagrange).tolist(), strict=True))
    rows = ComponentMap((row, multiplier) for row, multiplier in of_rows if id(row) in users)
    bounds = ComponentMap(
        (v, z)
        for v, z in zip(columns.problem.variables, slope.tolist(), strict=True)
        if id(v) not in mine
    )
    by_row = {id(row): multiplier for row, multiplier in of_rows}
    pairs: Any = ComponentMap((condition, (0.0, 0.0)) for condition in lifted.conditions)

    def add(condition: Any, argument: int, multiplier: float) -> None:
        both = list(pairs[condition])
        both[argument] += multiplier
        pairs[condition] = (both[0], both[1])

    for condition, argument, row in lifted.imposed:
        add(condition, argument, by_row.get(id(row), 0.0))
    for k, pair in enumerate(lifted.pairs):
        nu, mu = float(slope[columns.first[k]]), float(slope[columns.second[k]])
        # The multiplier of a user's variable belongs to its first pair only.
        if id(pair.second) not in mine:
            mu = bounds.pop(pair.second, 0.0)
        if pair.twin is not None:
            nu = bounds.pop(pair.twin, 0.0)
        for (argument, sign), multiplier in zip(pair.sides, (nu, mu), strict=True):
            if sign:
                add(pair.condition, argument, sign * multiplier)
    return Multipliers(rows=rows, bounds=bounds, pairs=pairs)


def _pair_multipliers(
    sense: int, multipliers: Multipliers
) -> tuple[tuple[Any, tuple[float, float]], ...]:
    """Return the multipliers of each complementarity, in the model's own sense.

    A side that repeats a variable's bound includes the multiplier of that bound.
    """
    results = []
    bounds = ComponentMap(multipliers.bounds.items())
    for condition, sides in multipliers.pairs.items():
        both = list(sides)
        for k, side in enumerate(condition._args):
            lower, body, upper = relation_of(side, condition)
            z = bounds.get(body, 0.0) if isinstance(body, VarData) else 0.0
            bound, own = (
                (lower, body.lb) if z > 0.0 else (upper, body.ub) if z < 0.0 else (None, None)
            )
            if bound is not None and value(bound) == own:
                both[k] += z
                del bounds[body]  # of two pairs with this side one has it
        results.append((condition, (sense * both[0], sense * both[1])))
    return tuple(results)


def _user_rows(candidate: Candidate) -> tuple[Any, ...]:
    rows = candidate.work.lifted.shadow.component("user_rows")
    return () if rows is None else tuple(rows.values())

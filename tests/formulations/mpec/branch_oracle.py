"""A random MPEC against all its branches, each a smooth program solved from several starts: judge(problem) says how `solve_mpec` compares."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyomo.environ as pyo
from pyomo.mpec import Complementarity

from formulations.ipopt import ModelRefusedError, compile_model, solve
from formulations.mpec import load, solve_mpec
from formulations.solution import Outcome

# A point belongs to the model where no row, bound or condition is violated by more, relative to
# max(1, |limit|); two objectives are the same within _SAME; an objective this low, in the sense of
# minimising, at a feasible point is none of a bounded problem of this generator.
_FEASIBLE = 2e-6
_SAME = 1e-5
_BOTTOMLESS = -1e6
# More branches than this are solved from one start only.
_MANY = 40
_BRANCH_OPTIONS = {"max_iter": 300, "bound_relax_factor": 0.0, "tol": 1e-9}
WRONG = ("wrong optimal", "wrong infeasible", "wrong unbounded")


@dataclass(frozen=True)
class Verdict:
    """agreement: 'same' (best of all branches, or none feasible, or one unbounded), 'better' or 'worse' (another local solution), 'local of
    unbounded', 'undecided' (no claim was made), 'refused', or one of WRONG. best: of the branches,
    in the model's sense.
    """

    seed: int
    kind: str
    outcome: str
    agreement: str
    objective: float
    best: float
    note: str


@dataclass(kw_only=True)
class Branches:
    """best: lowest objective of feasible points found (sense of minimising).

    unclear: solves without an answer.
    """

    best: float = math.inf
    unbounded: bool = False
    unclear: int = 0
    descent: float = 0.0  # how far a branch that holds the judged point goes below it


def judge(problem: Any) -> Verdict:
    seed, model = problem.seed, problem.model
    free = [v for v in model.component_data_objects(pyo.Var, descend_into=True) if not v.fixed]
    start = np.array([v.value for v in free], dtype=float)
    try:
        result = solve_mpec(model)
    except ModelRefusedError as error:
        return Verdict(seed, problem.kind, "refused", "refused", math.nan, math.nan, str(error))
    sense = 1 if model.cost.sense == pyo.minimize else -1
    violation, mine = math.inf, math.inf
    if result.has_point:
        load(result)
        violation, mine = largest_violation(problem), sense * result.objective
    point = np.array([v.value for v in free], dtype=float)
    for condition in list(model.component_objects(Complementarity, active=True, descend_into=True)):
        condition.deactivate()
    found = _enumerate(problem, free, start, point if result.solved else None, sense, mine)
    agreement, note = _compare(result, found, mine, violation, problem.is_convex)
    return Verdict(
        seed,
        problem.kind,
        result.outcome.name,
        agreement,
        result.objective,
        sense * found.best,
        note,
    )


def _compare(
    result: Any, found: Branches, mine: float, violation: float, is_convex: bool
) -> tuple[str, str]:
    same = _SAME * max(1.0, abs(found.best) if math.isfinite(found.best) else 1.0)
    if result.outcome is Outcome.SOLVED:
        if violation > _FEASIBLE:
            return "wrong optimal", f"a row, bound or condition is violated by {violation:.1e}"
        if is_convex and found.descent > same:
            return (
                "wrong optimal",
                f"a convex branch that holds the point goes down by {found.descent:.1e}",
            )
        if found.unbounded:
            return "local of unbounded", ""
        return (
            "worse"
            if mine > found.best + same
            else "better"
            if mine < found.best - same
            else "same",
            "",
        )
    if result.outcome is Outcome.INFEASIBLE:
        if found.best < math.inf or found.unbounded:
            return "wrong infeasible", f"a branch has a feasible point with {found.best:.6g}"
        return "same", ""
    if result.outcome is Outcome.DIVERGED:
        bottomless = mine < _BOTTOMLESS and violation <= _FEASIBLE * max(1.0, abs(mine))
        if found.unbounded or bottomless or found.unclear:
            return "same" if found.unbounded or bottomless else "undecided", ""
        return "wrong unbounded", f"every branch has an answer, the best {found.best:.6g}"
    return "undecided", result.message


def _enumerate(
    problem: Any,
    free: list[Any],
    start: np.ndarray,
    point: np.ndarray | None,
    sense: int,
    mine: float,
) -> Branches:
    random = np.random.default_rng(problem.seed + 10**6)
    starts = [start, start + random.normal(size=start.size) * np.maximum(1.0, np.abs(start))]
    if point is not None:
        starts.append(point)
    if math.prod(map(len, problem.branches)) > _MANY:
        starts = starts[-1:]
    found = Branches()
    for branch in itertools.product(*problem.branches):
        relations = [relation for side in branch for relation in side]
        lowest = _solve_branch(problem, relations, free, starts, sense, found)
        if point is not None:
            _set(free, point)
            if max(map(_off, relations), default=0.0) <= _FEASIBLE:
                found.descent = max(found.descent, mine - lowest)
    found.unbounded = found.unbounded or found.best < _BOTTOMLESS
    return found


def _solve_branch(
    problem: Any,
    relations: list[Any],
    free: list[Any],
    starts: list[np.ndarray],
    sense: int,
    found: Branches,
) -> float:
    """The lowest objective of this branch, which goes into `found` too.

    A convex one has one answer.
    """
    model, is_convex, lowest = problem.model, problem.is_convex, math.inf
    model.branch = pyo.ConstraintList()
    for body, low, high in relations:
        model.branch.add(
            (None if low == -math.inf else low, body, None if high == math.inf else high)
        )
    for start in starts:
        if is_convex and lowest < math.inf:
            break
        _set(free, start)
        result = solve(compile_model(model), options=_BRANCH_OPTIONS)
        if result.outcome is Outcome.INFEASIBLE:
            continue
        if result.outcome is Outcome.DIVERGED:
            found.unbounded = True
        elif result.outcome is Outcome.SOLVED or (
            result.residuals.feasible and result.residuals.relative_violation < 1e-9
        ):
            lowest = min(lowest, sense * result.objective)
        else:
            found.unclear += 1
    model.del_component(model.branch)
    found.best = min(found.best, lowest)
    return lowest


def _set(free: list[Any], point: np.ndarray) -> None:
    for variable, number in zip(free, point.tolist(), strict=True):
        variable.set_value(number, skip_validation=True)


def largest_violation(problem: Any) -> float:
    """Of rows, bounds and conditions (of each the least violated alternative) at the model's values, relative to max(1, |limit|)."""
    model, worst = problem.model, [0.0]
    for row in model.component_data_objects(pyo.Constraint, active=True, descend_into=True):
        worst.append(
            _off(
                (
                    row.body,
                    -math.inf if row.lb is None else row.lb,
                    math.inf if row.ub is None else row.ub,
                )
            )
        )
    for variable in model.component_data_objects(pyo.Var, descend_into=True):
        if not variable.fixed:
            worst.append(
                _off(
                    (
                        variable,
                        -math.inf if variable.lb is None else variable.lb,
                        math.inf if variable.ub is None else variable.ub,
                    )
                )
            )
    worst += [
        min(max(map(_off, relations)) for relations in condition) for condition in problem.branches
    ]
    return max(worst)


def _off(relation: Any) -> float:
    """How far a relation is violated, relative to max(1, |limit|)."""
    body, low, high = relation
    value = pyo.value(body)
    scale = max([1.0, *(abs(limit) for limit in (low, high) if math.isfinite(limit))])
    return max(low - value, value - high, 0.0) / scale

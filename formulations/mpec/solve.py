"""Solve an MPEC: follow a relaxation, decide the pairs, solve the branch, certify the point.

    result = solve_mpec(model)  # MpecResult; the model is unchanged
    load(result)  # write the variables

or behind Pyomo's solver interface, with our options by name and the rest passed to Ipopt:

    solver = pyo.SolverFactory("mpec_ipopt")
    solver.options["strategy"] = "scholtes"
    solver.solve(model)
    solver.last_result.certificate.sentence
"""

from __future__ import annotations

import itertools
import logging
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from pyomo.opt import SolverResults

from formulations.certificate.certificate import certify
from formulations.certificate.kinks import SmoothCopy, smooth_copy
from formulations.certificate.local import values_set
from formulations.ipopt.model import NotSmoothError
from formulations.ipopt.pyomo_solver import PyomoAnswer, PyomoPlugin, pyomo_multipliers
from formulations.mpec.branching import BETTER, Branch, Branching
from formulations.mpec.homotopy import (
    Path,
    PathPoint,
    Step,
    WorkBudget,
    Workspace,
    compile_branches,
    natural_residual,
)
from formulations.mpec.lifted import lift
from formulations.mpec.result import (
    Candidate,
    MpecResult,
    StrategyAttempt,
    is_feasible,
    multipliers_of,
    outcome_without_point,
    result_of,
    verdict,
)
from formulations.mpec.strategies import LARGE, STRATEGIES, MpecSettings, read_settings
from formulations.solution import Outcome

logger = logging.getLogger(__name__)

# Pairs are decided early if two consecutive steps agree on all of them, below this eps.
_EARLY_EPS = 1e-3
# An early branch is accepted if it is strongly stationary, with an objective this close to the
# relaxation's, relative to max(1, |objective|).
_NEAR = 1e-2
# Early limit of a penalty, whose eps is no distance: largest smaller side of a pair.
_EARLY_RESIDUAL = 1e-3
# A step with wrong multipliers has decided the pairs if their smaller sides are below this.
_DECIDED = 1e-6
# Multipliers with a larger relative residual are not returned.
_WRONG_MULTIPLIERS = 1e-4
# Iterations after the first success, as a multiple of those before it, per start, for problems of
# at most `search` pairs.
_SMALL_WORK = 1.0
# The same for larger problems. With more than LARGE pairs the factor is 1 for each further start,
# and nothing otherwise: none of 8 problems with 832 to 1748 pairs improved by another strategy.
_WORK = 3.0
# Limit of iterations times entries of derivatives, some 8 CPU s; also for the nearest branches.
_ENTRIES = 1e7
# Smallest share of the first success's iterations with which a new attempt starts.
_WORTHWHILE = 0.5
# Bound on consecutive saddle points, far above any seen; it only ensures termination.
_SADDLES = 100
# First rank of `_rank` without a feasible point.
_WITHOUT = 3
# An absolute value with both parts below this is at its kink.
_ON_KINK = 1e-6


def solve_mpec(
    model: Any, settings: MpecSettings | None = None, *, time_limit: float | None = None
) -> MpecResult:
    """Solve from the current values of the model's variables; the model is only read.

    Parameters
    ----------
    model : a Pyomo model, with or without Complementarity
    settings : strategy, tolerances, Ipopt's options
    time_limit : wall time [s]

    Raises
    ------
    ModelRefusedError
        for a component that cannot be treated, before the solve starts
    MissingValueError
        for data without a value, before the solve starts
    ValueError
        for a time limit that is not positive
    """
    settings = settings or MpecSettings()
    budget = WorkBudget(time_limit)
    try:
        return _solved(model, settings, budget)
    except NotSmoothError:
        smooth = smooth_copy(model)
        return _by_users(_solved(smooth.model, settings, budget), smooth)


def _by_users(result: MpecResult, smooth: SmoothCopy) -> MpecResult:
    kept = np.array(
        [k for k, variable in enumerate(result.variables) if id(variable) in smooth.users],
        dtype=np.intp,
    )
    rows = np.array(
        [k for k, row in enumerate(result.rows) if id(row) in smooth.users], dtype=np.intp
    )
    own = [pair for pair in result.pairs if pair.name.startswith(f"{smooth.block.name}.")]
    on_kink = sum(max(pair.first, pair.second) <= _ON_KINK for pair in own)
    words = f"{len(smooth.block.pair)} absolute values, minima and maxima written as pairs, {on_kink} of them on their kink"
    return replace(
        result,
        message=f"{result.message}; {words}",
        variables=tuple(smooth.users[id(result.variables[k])] for k in kept),
        x=result.x[kept],
        zl=result.zl[kept],
        zu=result.zu[kept],
        rows=tuple(smooth.users[id(result.rows[k])] for k in rows),
        lagrange=result.lagrange[rows],
        pairs=tuple(pair for pair in result.pairs if pair not in own),
        pair_multipliers=tuple(
            (smooth.users[id(pair)], both)
            for pair, both in result.pair_multipliers
            if id(pair) in smooth.users
        ),
    )


def _solved(model: Any, settings: MpecSettings, budget: WorkBudget) -> MpecResult:
    """Return the best of all attempts: all strategies from each start, within the allowed work."""
    begin = time.perf_counter()
    best: MpecResult | None = None
    steps: list[Step] = []
    attempts: list[StrategyAttempt] = []
    searched: list[Branch] = []
    first_success = 0
    lifted = lift(model)
    branches, works = compile_branches(lifted), dict[str, Workspace]()
    strategies = settings.order(len(lifted.pairs))
    for start, name in itertools.product(range(settings.starts), strategies):
        before = budget.iterations
        if name not in works:
            works[name] = Workspace(lifted, branches, STRATEGIES[name], settings, budget)
        is_tried = len(lifted.pairs) > LARGE and best is None and len(strategies) > 1
        is_last = len(attempts) == settings.starts * len(strategies) - 1 and (
            best is None or _rank(best)[0] >= _WITHOUT
        )
        candidate = _run_strategy(
            works[name], start, steps, searched, is_tried=is_tried, is_last=is_last
        )
        outcome, objective = (
            candidate.outcome if candidate.branch is None else Outcome.SOLVED,
            candidate.objective,
        )
        if (
            best is None
            or not best.solved
            or candidate.sense * objective
            < candidate.sense * best.objective - _better(best.objective)
        ):
            result = _judged(model, candidate)
            logger.info("%s from start %d on '%s': %s", name, start, model.name, result.message)
            outcome = result.outcome
            if best is None or _rank(result) < _rank(best):
                best = result
        attempts.append(
            StrategyAttempt(
                strategy=name,
                start=start,
                outcome=outcome,
                objective=objective,
                iterations=budget.iterations - before,
            )
        )
        if budget.is_over or outcome in (Outcome.INTERRUPTED, Outcome.TIME_LIMIT):
            break
        if best.solved and math.isinf(budget.most_iterations):
            first_success = budget.iterations
            budget.most_iterations = first_success + _further_iterations(
                candidate.work, first_success
            )
        if budget.most_iterations - budget.iterations < _WORTHWHILE * first_success:
            break
    assert best is not None  # there is always a strategy
    message = (
        best.message if len(attempts) == 1 else f"{best.message}; {_attempts_in_words(attempts)}"
    )
    return replace(
        best, message=message, attempts=tuple(attempts), steps=tuple(steps),
        iterations=budget.iterations, solves=budget.solves,
        seconds=time.perf_counter() - begin,
    )  # fmt: skip


def _further_iterations(work: Workspace, first_success: int) -> float:
    settings = work.settings
    if settings.work is not None:
        return settings.work * first_success
    pairs, starts = len(work.lifted.pairs), settings.starts
    multiple = (
        starts * _SMALL_WORK
        if pairs <= settings.search
        else starts * _WORK
        if pairs <= LARGE
        else starts - 1
    )
    return min(multiple * first_success, starts * _ENTRIES / work.branches.problem.nonzeros)


def _better(objective: float) -> float:
    return BETTER * max(1.0, abs(objective))


def _attempts_in_words(attempts: list[StrategyAttempt]) -> str:
    words = []
    for attempt in attempts:
        outcome = (
            f"{attempt.objective:.6g}"
            if attempt.outcome is Outcome.SOLVED
            else attempt.outcome.name.lower().replace("_", " ")
        )
        if attempt.outcome is Outcome.REFUSED:
            outcome += f" (more equations than variables{', each pair is one' if attempt.strategy == 'smoothing' else ''})"
        words.append(
            f"{attempt.strategy}{f' from start {attempt.start}' if attempt.start else ''} {outcome}"
        )
    return f"best of {len(attempts)}: {', '.join(words)}"


def _run_strategy(
    work: Workspace,
    number: int,
    steps: list[Step],
    searched: list[Branch],
    *,
    is_tried: bool,
    is_last: bool,
) -> Candidate:
    """Follow one strategy from one start, and return the branch or point that it reaches.

    steps: receives the steps of the path
    searched: branches whose neighbours were already tried
    is_tried: as in `Path.points`
    is_last: no feasible point is known, and this is the last attempt
    """
    strategy, settings = work.strategy, work.settings
    start = work.start(number)
    path, branching = Path(work, steps), Branching(work, start)
    work.set(settings.eps_start or strategy.first)
    branch, last, outcome, message = None, None, Outcome.SOLVED, ""
    if not work.lifted.pairs:
        branch = branching.polish(start)
        searched = [] if branch is None else [branch]  # without pairs there are no other branches
    else:
        before: np.ndarray | None = None
        for last in path.points(start, is_tried=is_tried):
            first, second = work.relaxed.pair_values(last.x)
            closed, residual = first < second, natural_residual(first, second)
            clear = before is not None and np.array_equal(closed, before)
            before = closed
            is_early = last.eps <= _EARLY_EPS or (
                strategy.eps_is_weight and residual <= _EARLY_RESIDUAL
            )
            if (
                settings.polish
                and is_early
                and clear
                and (last.result.solved or residual <= _DECIDED)
            ):
                branch = branching.polish(last.x)
                if (
                    branch is not None
                    and branch.is_strong
                    and _agrees(branch.objective, last.result.objective)
                ):
                    break
        else:
            if last is not None and settings.polish:
                branch = branching.polish(last.x)
    if branch is not None:
        branch = _settled(branching, branch, start, searched)
    elif work.lifted.pairs:
        branch, outcome, message = _without_branch(
            work, start, branching, path, last, is_last=is_last
        )
    else:
        assert branching.last is not None
        outcome, message = branching.last.outcome, branching.last.explanation
    return Candidate(
        work=work,
        branch=branch,
        point=last,
        outcome=outcome,
        message=message,
        unbounded=branching.unbounded,
        curves_down=branching.curves_down,
    )


def _settled(
    branching: Branching, branch: Branch, start: np.ndarray, searched: list[Branch]
) -> Branch:
    for _ in range(_SADDLES):
        if not any(_is_same(branch, known) for known in searched):
            searched.append(branch)
            branch = branching.search(branch, start)
            searched.append(branch)
        lower = branching.past_saddle(branch)
        if lower is None:
            break
        branch = lower
    return branch


def _is_same(branch: Branch, known: Branch) -> bool:
    return np.array_equal(branch.closed, known.closed) and abs(
        branch.objective - known.objective
    ) <= _better(known.objective)


def _without_branch(
    work: Workspace,
    start: np.ndarray,
    branching: Branching,
    path: Path,
    last: PathPoint | None,
    *,
    is_last: bool,
) -> tuple[Branch | None, Outcome, str]:
    """Return branch, outcome and message of a path without a branch; try all branches if few."""
    settings, budget = work.settings, work.budget
    pairs = len(work.lifted.pairs)
    is_small = pairs <= settings.max_biactive
    if (
        settings.polish
        and not budget.is_over
        and (is_small or (is_last and pairs <= settings.search))
    ):
        starts = (
            [work.branch_point(start)]
            if last is None
            else [work.branch_point(x) for x in (last.x, start)]
        )
        count = tried = 2**pairs
        if is_small:
            branch, outcome = branching.every_branch(starts)
        else:
            branch, outcome, tried = branching.nearest_branch(
                starts[0], _ENTRIES / work.branches.problem.nonzeros
            )
        reason = f"{path.last_message}; " if path.last_outcome is Outcome.INFEASIBLE else ""
        if outcome is Outcome.INFEASIBLE and (tried == count or reason):
            which = f"the {'' if tried == count else f'nearest {tried} of the '}{count} branches"
            return None, outcome, f"{reason}each of {which} of the problem is infeasible (locally)"
        if branch is not None and outcome is Outcome.SOLVED:
            return _settled(branching, branch, start, [branch] if is_small else []), outcome, ""
    if budget.is_late:
        return None, Outcome.TIME_LIMIT, "the time limit was reached before the last eps"
    if budget.is_over:
        return (
            None,
            Outcome.ITERATION_LIMIT,
            "the work that is allowed after the first success was done before the last eps",
        )
    if branching.unbounded:
        return (
            None,
            Outcome.DIVERGED,
            "a branch of the problem is unbounded: its objective falls without end at feasible points",
        )
    if last is None or path.gave_up:
        return None, path.last_outcome, path.last_message
    if not last.result.solved:
        return None, last.result.outcome, last.result.message
    return None, Outcome.SOLVED, ""


def _judged(model: Any, candidate: Candidate) -> MpecResult:
    x = candidate.x
    if x is None:
        return result_of(candidate, *outcome_without_point(candidate))
    residual = natural_residual(*candidate.columns.pair_values(x))
    certificate, multipliers = None, None if candidate.branch is None else multipliers_of(candidate)
    if candidate.work.settings.certificate:
        with values_set(candidate.columns.problem.variables, x.tolist()):
            certificate = certify(model, multipliers)
            if (
                certificate.given_dual > _WRONG_MULTIPLIERS
            ):  # the branch has none where it is degenerate; the certificate found its own
                multipliers, certificate = None, replace(certificate, given_dual=math.nan)
    ended = verdict(candidate, residual, certificate)
    return result_of(
        candidate, *ended, residual=residual, certificate=certificate, multipliers=multipliers
    )


def _agrees(objective: float, relaxed: float) -> bool:
    return abs(objective - relaxed) <= _NEAR * max(1.0, abs(relaxed))


def _rank(result: MpecResult) -> tuple[int, float]:
    if result.solved or (is_feasible(result) and result.outcome is not Outcome.DIVERGED):
        return 0 if result.solved else 2, result.sense * result.objective
    order = {Outcome.DIVERGED: 1, Outcome.INFEASIBLE: 3}.get(result.outcome, 4)
    return order, result.residual if result.residual == result.residual else float("inf")


class MpecIpopt(PyomoPlugin):
    """Pyomo's solver for MPECs; `last_result` is the MpecResult of the last solve.

    A solve starts from the model's values. "optimal" is a B-stationary point, not a global optimum.
    """

    title = "mpec_ipopt"

    def run(
        self, model: Any, *, options: dict[str, Any], timelimit: float | None, warmstart: bool
    ) -> tuple[SolverResults, PyomoAnswer]:
        """Solve with `solve_mpec`."""
        result = self.last_result = solve_mpec(model, read_settings(options), time_limit=timelimit)
        answer = PyomoAnswer(
            result=result,
            is_feasible=result.solved or is_feasible(result),
            sense=result.sense,
            has_objective=result.has_objective,
            equations=result.rows,
            variables=result.variables,
            x=result.x if result.has_point else None,
            multipliers=pyomo_multipliers(result.sense, result.lagrange, result.zl, result.zu)
            if result.has_multipliers
            else None,
            wall=result.seconds,
            pair_multipliers=result.pair_multipliers,
        )
        return answer.results(self.title, model), answer

"""Follow a relaxation as its eps goes to 0: how far a step goes is learnt from the steps before, and a failed one is taken again, shorter.

`Workspace` holds the numbers of one solve: the compiled relaxation, the compiled problem without
products, and the columns of the pairs in both.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyomo.environ as pyo

from formulations.ipopt import (
    IpoptProblem,
    IpoptResult,
    MissingValueError,
    Start,
    compile_model,
    solve,
)
from formulations.ipopt.solve import repeats_constraints
from formulations.mpec.lifted import Lifted
from formulations.mpec.strategies import MpecSettings, Strategy
from formulations.solution import Outcome

# eps goes down by this at first; a step of few iterations makes the next one bolder, one of many
# makes it more careful.
_FIRST_FACTOR = 0.1
_BOLDEST = 1e-3
_MOST_CAREFUL = 0.5
_FEW = 15
_MANY = 120
# eps does nothing where it is this much larger than all products; after two such steps in a row it
# goes to the products at once. (After one the same problem, begun anew, may have a better solution:
# water-net ends at 909.0 instead of 927.3.)
_IDLE = 1e-2
# Failed steps in a row, and in all, before the path is given up; the factors by which a first step
# that fails is tried again: a looser relaxation is easier to satisfy, a tighter one is bounded
# where a looser one is not.
_RETRIES = 3
_FAILURES = 8
_LOOSER = 100.0
_TIGHTER = 1e-2
# Iterations of the first step of a path that is only tried.
_TRIAL = 100


class Columns:
    """Where things are in a compiled problem.

    bounds: of variables and rows as the problem was compiled, (n,), (n,), (m,), (m,); first[k],
        second[k]: columns of pair k; twin[k]: the column of the
    user's variable which first[k] equals, or -1; twin_row[k]: the row that says so
    """

    def __init__(self, problem: IpoptProblem, lifted: Lifted) -> None:
        self.problem = problem
        self.bounds = (
            problem.lower.copy(),
            problem.upper.copy(),
            problem.constraint_lower.copy(),
            problem.constraint_upper.copy(),
        )
        self.place = {id(variable): column for column, variable in enumerate(problem.variables)}
        self.first = np.array([self.place[id(pair.first)] for pair in lifted.pairs], dtype=np.intp)
        self.second = np.array(
            [self.place[id(pair.second)] for pair in lifted.pairs], dtype=np.intp
        )
        self.twin = np.array(
            [-1 if pair.twin is None else self.place[id(pair.twin)] for pair in lifted.pairs],
            dtype=np.intp,
        )
        row = {id(equation): number for number, equation in enumerate(problem.equations)}
        self.twin_row = np.array([row[id(pair.data.ve)] for pair in lifted.pairs], dtype=np.intp)

    def pair_values(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both sides v, w (pairs,) of all pairs at x (n,) [units of the sides]. Raises nothing."""
        return x[self.first], x[self.second]


def natural_residual(first: np.ndarray, second: np.ndarray) -> float:
    """Largest |min(v, w)| of a pair, 0 without pairs.

    Raises nothing: NaN stays NaN.

    Parameters
    ----------
    first, second : (pairs,) values of the two sides [units of the sides]
    """
    return float(np.max(np.abs(np.minimum(first, second)))) if first.size else 0.0


class Workspace:
    """Compiled once per strategy, `branches` once for all.

    Only numbers change afterwards. own: `id`s of the variables that the user does not have.

    settings, budget: of the whole solve
    """

    def __init__(
        self,
        lifted: Lifted,
        branches: Columns,
        strategy: Strategy,
        settings: MpecSettings,
        budget: WorkBudget,
    ) -> None:
        self.lifted, self.branches, self.strategy, self.settings, self.budget = (
            lifted,
            branches,
            strategy,
            settings,
            budget,
        )
        self._steered = strategy.attach(lifted)
        self.relaxed = Columns(compile_model(lifted.shadow), lifted)
        added = lifted.shadow.relaxation.component_data_objects(pyo.Var)
        self.own = {id(variable) for variable in (*self._slacks(), *added)}
        known = self.relaxed.place
        self._to_branch = np.array(
            [known.get(id(variable), -1) for variable in self.branches.problem.variables],
            dtype=np.intp,
        )

    def set(self, eps: float) -> None:
        """Move the relaxation to eps."""
        self._steered.value = self.strategy.number(eps)
        self.relaxed.problem.refresh(check=False)

    def start(self, number: int = 0) -> np.ndarray:
        """A start in the relaxation's columns.

        Every slack at the value that its own equation asks for, at least its bound.

        Parameters
        ----------
        number : 0 for the user's values; else the seed of a random point around them

        Returns
        -------
        (n,) point of the relaxation [units of the variables]

        Raises
        ------
        MissingValueError
            where a variable starts at a number that is not finite
        """
        problem = self.relaxed.problem
        x, _ = problem.start()
        for k in np.flatnonzero(~np.isfinite(x)):
            raise MissingValueError(
                f"variable '{problem.variables[k].name}' starts at {x[k]}: give it a finite value, or none"
            )
        if number:
            x = _random_start(problem, x, np.random.default_rng(number))
        settle(self.relaxed, x, self._slacks())
        return x

    def branch_point(self, x: np.ndarray) -> np.ndarray:
        """A point of the relaxation (n,) in the columns of the problem without products (columns,) [units of the variables].

        Raises nothing.
        """
        point = np.zeros(self.branches.problem.n)
        known = self._to_branch >= 0
        point[known] = x[self._to_branch[known]]
        return point

    def _slacks(self) -> list[Any]:
        return [*self.lifted.shadow.slack.values(), *(pair.first for pair in self.lifted.pairs)]


def _random_start(problem: IpoptProblem, x: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A point (n,) around x: uniform between two finite bounds, else normal with the size of x.

    Never beyond a bound.
    """
    low, high = problem.lower, problem.upper
    around = np.clip(x + np.maximum(1.0, np.abs(x)) * random.normal(size=len(x)), low, high)
    share = random.uniform(size=len(x))
    boxed = np.isfinite(low) & np.isfinite(high)
    around[boxed] = low[boxed] + share[boxed] * (high - low)[boxed]
    return around


def settle(relaxed: Columns, x: np.ndarray, slacks: list[Any]) -> None:
    """Give each slack the value that makes its defining row hold, within its bounds.

    The row is an equality that no slack of a later pair enters. Raises nothing.

    Parameters
    ----------
    relaxed : the compiled problem
    x : (n,) point, changed in place [units of the variables]
    slacks : Pyomo variables
    """
    problem, place = relaxed.problem, relaxed.place
    columns = np.array([place[id(s)] for s in slacks if id(s) in place], dtype=np.intp)
    if not columns.size:
        return
    x[columns] = np.clip(0.0, problem.lower[columns], problem.upper[columns])
    rows, entries = problem.jacobianstructure()
    for _ in range(
        2
    ):  # slacks of user expressions first, then v == expression, which may hold such a slack
        values, slopes = problem.constraints(x), problem.jacobian(x)
        is_equality = problem.constraint_lower == problem.constraint_upper
        wanted = np.full(problem.n, np.nan)
        pick = np.isin(entries, columns) & is_equality[rows] & (slopes != 0.0)
        with np.errstate(all="ignore"):
            wanted[entries[pick]] = (
                x[entries[pick]]
                + (problem.constraint_lower[rows[pick]] - values[rows[pick]]) / slopes[pick]
            )
        chosen = np.where(np.isfinite(wanted[columns]), wanted[columns], x[columns])
        x[columns] = np.clip(chosen, problem.lower[columns], problem.upper[columns])


def compile_branches(lifted: Lifted) -> Columns:
    """The problem without products, to be compiled before any relaxation.

    A side that stands nowhere else keeps its row w >= 0, so that it has a column.
    """
    lifted.products(active=False)
    problem = compile_model(lifted.shadow)
    present = {id(variable) for variable in problem.variables}
    lonely = [pair.data for pair in lifted.pairs if id(pair.second) not in present]
    if lonely:
        for pair in lonely:
            pair.c.activate()
        problem = compile_model(lifted.shadow)
        for pair in lonely:
            pair.c.deactivate()
    return Columns(problem, lifted)


@dataclass(frozen=True, kw_only=True)
class Step:
    """One solve at one eps: how it ended, and the largest min(v, w) of a pair at its point."""

    strategy: str
    eps: float
    outcome: Outcome
    iterations: int
    objective: float
    residual: float
    seconds: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PathPoint:
    """Where the path is after a step that can be believed: x (n,), in the relaxation's columns."""

    eps: float
    x: np.ndarray
    result: IpoptResult


class WorkBudget:
    """Time and iterations of a whole solve; `remaining` is None where there is no limit.

    most_iterations: of Ipopt, in all; infinite until a first answer is there
    """

    def __init__(self, limit: float | None) -> None:
        if limit is not None and not limit > 0:
            raise ValueError(f"the time limit is a positive number of seconds, not {limit!r}")
        self._deadline = None if limit is None else time.perf_counter() + limit
        self.most_iterations = math.inf
        self.iterations = 0
        self.solves = 0

    @property
    def remaining(self) -> float | None:
        """Seconds left [s], at least a millisecond; None where there is no limit."""
        return None if self._deadline is None else max(1e-3, self._deadline - time.perf_counter())

    @property
    def is_late(self) -> bool:
        """Whether the time is over."""
        return self._deadline is not None and time.perf_counter() >= self._deadline

    @property
    def is_over(self) -> bool:
        """Whether the time or the iterations are used up."""
        return self.is_late or self.iterations >= self.most_iterations

    def run(self, problem: Any, options: dict[str, Any], start: Start) -> IpoptResult:
        """Solve within the time and the iterations that are left, and count them."""
        if math.isfinite(self.most_iterations):
            options = {
                **options,
                "max_iter": int(
                    min(options["max_iter"], max(1.0, self.most_iterations - self.iterations))
                ),
            }
        result = solve(problem, options=options, warm_start=start, time_limit=self.remaining)
        self.iterations += result.iterations
        self.solves += 1
        return result


class Path:
    """The steps of one strategy, taken one at a time by `points` and added to `steps`.

    gave_up: it ended before its last eps, and `last_outcome` and `last_message` say why
    """

    def __init__(self, work: Workspace, steps: list[Step]) -> None:
        self._work, self._strategy, self._settings, self._budget, self._steps = (
            work,
            work.strategy,
            work.settings,
            work.budget,
            steps,
        )
        self._regularised: dict[str, Any] = {}
        self.gave_up = False
        self.last_outcome = Outcome.SOLVED
        self.last_message = ""

    def points(self, start: np.ndarray, *, is_tried: bool = False) -> Iterator[PathPoint]:
        """Points of smaller and smaller eps.

        Ends at the last eps, at a limit, or where no shorter step helps either.

        Raises what `formulations.ipopt.solve` does.

        Parameters
        ----------
        start : (n,) point of the relaxation [units of the variables]
        is_tried : whether others are left to go, so that a first step may take _TRIAL iterations,
            and is not taken again from another eps
        """
        settings, strategy = self._settings, self._strategy
        first = settings.eps_start or strategy.first
        last = min(settings.eps_end or strategy.last, first)
        good: PathPoint | None = None
        eps, factor, failures, tried, was_idle = first, _FIRST_FACTOR, 0, {first}, False
        while True:
            result = self._take(
                eps, start, good, _TRIAL if is_tried and good is None else settings.step_iterations
            )
            if _is_usable(result):
                self.gave_up = False
                good, failures = PathPoint(eps=eps, x=result.x, result=result), max(0, failures - 1)
                yield good
                if eps <= last:
                    return
                factor = _next_factor(factor, result.iterations)
                largest = self._largest_product(good)
                if largest < _IDLE * eps and was_idle:
                    eps = largest
                was_idle = largest < _IDLE * eps
                eps = max(last, eps * factor)
                continue
            failures += 1
            self.gave_up = True
            self.last_outcome, self.last_message = result.outcome, result.explanation
            if (
                self._budget.is_over
                or result.outcome in (Outcome.INTERRUPTED, Outcome.TIME_LIMIT)
                or failures > _FAILURES
            ):
                return
            if good is None:
                if is_tried:
                    return
                eps *= _TIGHTER if result.outcome is Outcome.DIVERGED else _LOOSER
                if eps in tried or failures > _RETRIES:
                    return
                tried.add(eps)
            elif failures > _RETRIES or eps > 0.9 * good.eps:
                return
            else:
                factor = math.sqrt(factor)
                eps = math.sqrt(eps * good.eps)

    def _largest_product(self, good: PathPoint) -> float:
        """Largest v w of a pair where eps bounds it; infinite for other strategies."""
        first, second = self._work.relaxed.pair_values(good.x)
        return (
            float(np.max(first * second, initial=0.0))
            if self._strategy.bounds_products
            else math.inf
        )

    def _take(
        self, eps: float, start: np.ndarray, good: PathPoint | None, most: int
    ) -> IpoptResult:
        begin = time.perf_counter()
        self._work.set(eps)
        options: dict[str, Any] = {
            "max_iter": min(most, self._settings.step_iterations),
            "bound_relax_factor": 0.0,
        }
        begins = Start(x=start if good is None else good.x)
        if good is not None and eps <= self._strategy.warm_below and good.result.solved:
            # Multipliers are worth keeping only where the solution hardly moves any more; earlier
            # they mislead.
            before = good.result
            begins = Start(x=before.x, lagrange=before.lagrange, zl=before.zl, zu=before.zu)
            options["mu_init"] = min(1e-4, max(1e-11, 1e-2 * eps))
        problem, options = (
            self._work.relaxed.problem,
            {**options, **self._regularised, **self._settings.ipopt},
        )
        result = self._budget.run(problem, options, begins)
        if not self._regularised and repeats_constraints(result) and not self._budget.is_over:
            self._regularised = {
                "perturb_always_cd": "yes"
            }  # products that rows imply repeat them: from here on, as here, the rows' block is regularised
            again = self._budget.run(problem, {**options, **self._regularised}, begins)
            result = again if again.solved else result
        self._steps.append(
            Step(
                strategy=self._strategy.name,
                eps=eps,
                outcome=result.outcome,
                iterations=result.iterations,
                objective=result.objective,
                residual=natural_residual(*self._work.relaxed.pair_values(result.x)),
                seconds=time.perf_counter() - begin,
            )
        )
        return result


def _is_usable(result: IpoptResult) -> bool:
    """Solved, or stalled at a feasible point: good enough to go on from, since every later step is judged again."""
    return result.solved or (
        result.outcome in (Outcome.STALLED, Outcome.ITERATION_LIMIT) and result.residuals.feasible
    )


def _next_factor(factor: float, iterations: int) -> float:
    if iterations <= _FEW:
        factor **= 1.5
    elif iterations > _MANY:
        factor **= 0.6
    return min(_MOST_CAREFUL, max(_BOLDEST, factor))

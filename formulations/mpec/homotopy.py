"""Follow a relaxation as its eps tends to 0, with adaptive steps.

Retry a failed step with a shorter one.

`Workspace` holds the compiled problems of a solve and the columns of their pairs.
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

# First factor of eps.
_FIRST_FACTOR = 0.1
# Smallest factor.
_BOLDEST = 1e-3
# Largest factor.
_MOST_CAREFUL = 0.5
# A step of fewer iterations enlarges the next step.
_FEW = 15
# A step of more iterations shortens the next step.
_MANY = 120
# eps has no effect if its product with this exceeds all products v w; after two such steps in a row
# eps falls to the products. (After one step a restart may find a better solution: water-net ends at
# 909.0 instead of 927.3.)
_IDLE = 1e-2
# Failed steps in a row that end the path.
_RETRIES = 3
# Failed steps in total that end the path.
_FAILURES = 8
# Factor of eps after a failed first step: a looser relaxation is easier to satisfy.
_LOOSER = 100.0
# Factor of eps after a first step that diverged: a tighter relaxation may be bounded.
_TIGHTER = 1e-2
# Iterations of the first step of a trial path.
_TRIAL = 100


class Columns:
    """Positions of variables and rows in a compiled problem.

    - bounds: of variables (n,), (n,) and rows (m,), (m,), as compiled
    - first, second: columns of each pair
    - twin: the column of the user's variable equal to first[k], or -1
    - twin_row: the row of that equality
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
        """Return v (pairs,), w (pairs,) at x (n,) [units of the sides]. Raises nothing."""
        return x[self.first], x[self.second]


def natural_residual(first: np.ndarray, second: np.ndarray) -> float:
    """Return the largest |min(v, w)| of sides (pairs,) [side units], 0 without pairs.

    NaN stays NaN. Raises nothing.
    """
    return float(np.max(np.abs(np.minimum(first, second)))) if first.size else 0.0


class Workspace:
    """The compiled problems; `branches` is shared by all strategies, and only numbers change later.

    own: `id`s of the variables that are not the user's
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
        """Set eps of the relaxation."""
        self._steered.value = self.strategy.number(eps)
        self.relaxed.problem.refresh(check=False)

    def start(self, number: int = 0) -> np.ndarray:
        """Return a start (n,) of the relaxation, with slacks from their equations [variable units].

        number: 0 for the user's values, else the seed of a random point around them
        Raises MissingValueError if a variable starts at a non-finite number.
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
        """Return a relaxation's point (n,) in the columns of `branches` (columns,) [-].

        Raises nothing.
        """
        point = np.zeros(self.branches.problem.n)
        shared = self._to_branch >= 0
        point[shared] = x[self._to_branch[shared]]
        return point

    def _slacks(self) -> list[Any]:
        return [*self.lifted.shadow.slack.values(), *(pair.first for pair in self.lifted.pairs)]


def _random_start(problem: IpoptProblem, x: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Sample uniformly in a box, else normally around x, within the bounds."""
    low, high = problem.lower, problem.upper
    around = np.clip(x + np.maximum(1.0, np.abs(x)) * random.normal(size=len(x)), low, high)
    share = random.uniform(size=len(x))
    boxed = np.isfinite(low) & np.isfinite(high)
    around[boxed] = low[boxed] + share[boxed] * (high - low)[boxed]
    return around


def settle(relaxed: Columns, x: np.ndarray, slacks: list[Any]) -> None:
    """Set each slack in x (n,) by its defining equality, within its bounds [variable units].

    The equality contains no slack of a later pair. Raises nothing.
    """
    problem, place = relaxed.problem, relaxed.place
    columns = np.array([place[id(s)] for s in slacks if id(s) in place], dtype=np.intp)
    if not columns.size:
        return
    x[columns] = np.clip(0.0, problem.lower[columns], problem.upper[columns])
    rows, entries = problem.jacobianstructure()
    # The first pass sets slacks of user expressions, the second v == expression with such slacks.
    for _ in range(2):
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
    """Compile the problem without products, before any relaxation.

    A side that appears nowhere else keeps its row w >= 0, so that it has a column.
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
    """One solve at one eps: its outcome, and the largest min(v, w) of a pair."""

    strategy: str
    eps: float
    outcome: Outcome
    iterations: int
    objective: float
    residual: float
    seconds: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PathPoint:
    """A point of the path after a usable step: x (n,), in the relaxation's columns."""

    eps: float
    x: np.ndarray
    result: IpoptResult


class WorkBudget:
    """Time and iterations of a whole solve; `remaining` is None without a limit.

    most_iterations: total limit, infinite before the first answer
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
        """Return the remaining seconds [s], at least a millisecond, or None."""
        return None if self._deadline is None else max(1e-3, self._deadline - time.perf_counter())

    @property
    def is_late(self) -> bool:
        """Return whether the time is used up."""
        return self._deadline is not None and time.perf_counter() >= self._deadline

    @property
    def is_over(self) -> bool:
        """Return whether the time or the iterations are used up."""
        return self.is_late or self.iterations >= self.most_iterations

    def run(self, problem: Any, options: dict[str, Any], start: Start) -> IpoptResult:
        """Solve within the remaining time and iterations, and count them."""
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
    """The steps of one strategy; `points` performs and stores them.

    gave_up: the path ended before its last eps, for `last_outcome` and `last_message`
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
        """Yield points of decreasing eps, up to the last eps, a limit, or repeated failure.

        start: (n,) point of the relaxation [variable units]
        is_tried: trial: limit the first step to _TRIAL iterations, without retries
        Raises the errors of `formulations.ipopt.solve`.
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
            # Multipliers help only near convergence; earlier ones mislead.
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
    return result.solved or (
        result.outcome in (Outcome.STALLED, Outcome.ITERATION_LIMIT) and result.residuals.feasible
    )


def _next_factor(factor: float, iterations: int) -> float:
    if iterations <= _FEW:
        factor **= 1.5
    elif iterations > _MANY:
        factor **= 0.6
    return min(_MOST_CAREFUL, max(_BOLDEST, factor))

"""Options, stage rules and budgets of direct-transcription methods; light to import (no Pyomo)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any

import sympy as sp

from formulations.method import Options, option
from formulations.solution import Seconds, Solution
from models.errors import SceneError
from models.scene import Scene

if TYPE_CHECKING:
    from formulations.ipopt import IpoptProblem, IpoptResult


SMOOTH = (
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
    "exp",
    "log",
    "sqrt",
)


def check_smooth(scene: Scene, what: str, expressions: Iterable[Any]) -> None:
    """Raise SceneError for a function that Pyomo does not have (atan2).

    Scenes have no functions with corners (models.scene.functions).
    """
    for expression in expressions:
        for call in sp.sympify(expression).atoms(sp.Function):
            if call.func.__name__ not in SMOOTH:
                raise SceneError(
                    f"scene {scene.name}: {what} contains {call}, which has no form in Pyomo; use {', '.join(SMOOTH)} and powers."
                )


def why_not_collocated(scene: Scene) -> str | None:
    """Return the reason why a scene has no collocation, or None."""
    if scene.nf:
        return (
            f"scene {scene.name} has friction, whose force jumps where it begins to slip: a stage of a step cannot stick, and the order is lost; "
            "semi-implicit Euler has a friction law of its own."
        )
    if scene.damped:
        return f"scene {scene.name} has damped contacts, whose law is written for semi-implicit Euler only."
    return None


@dataclass(frozen=True, kw_only=True)
class TranscriptionOptions(Options):
    """Options of methods that solve a plan's model by Ipopt."""

    tolerance: float = option(1e-8, "Ipopt's own stopping tolerance (tol)", lower=1e-12, upper=1e-2)
    max_iterations: int = option(3000, "most Ipopt iterations of a stage", lower=1, upper=10**9)
    plan_tolerance: float = option(
        1e-6,
        "solved only if start, goal, time step and bounds are met to this, unscaled and recomputed from the scene [m, rad, N ..]",
        lower=0.0,
        upper=1.0,
    )

    def ipopt(self) -> dict[str, object]:
        """Return Ipopt's options of every solve."""
        return {"tol": self.tolerance, "max_iter": self.max_iterations}

    def promises(self) -> dict[str, float]:
        """Return the largest residuals of a SOLVED plan, for any contact law."""
        names = (
            "dynamics_defect",
            "start_error",
            "terminal_error",
            "input_bound_excess",
            "velocity_bound_excess",
        )
        return dict.fromkeys(names, self.plan_tolerance)


def duals_option(unit: str = "1") -> Any:
    """Declare the option `duals_from`, for an eps of this unit."""
    words = "a stage at this eps or below also takes the multipliers of the stage before it; larger eps move the plan too much"
    return option(1e-4, words, unit=unit, lower=0.0, upper=1.0)


def first_eps_option(upper: float, unit: str = "1") -> Any:
    """Declare the option `first_eps`, up to the largest eps, of this unit."""
    words = "walk down from this eps where it is above the one asked for, in steps that adapt to what they cost"
    return option(0.0, words, unit=unit, lower=0.0, upper=upper)


# Ipopt's defaults of 0.1 and 0.01 start a complementarity model close to its bounds (no force, no
# separation), and progress is slow. The first relaxed plan of the three carts takes 428 iterations,
# and 78 from an interior start.
@dataclass(frozen=True, kw_only=True)
class BarrierOptions(TranscriptionOptions):
    """Options of a complementarity model, including Ipopt's initial distance from the bounds."""

    barrier_start: float = option(
        10.0, "Ipopt's mu_init of a start without a plan", lower=1e-9, upper=1e9
    )
    bound_push: float = option(
        1.0, "Ipopt's bound_push of a start without a plan", lower=1e-9, upper=1e9
    )

    def ipopt(self) -> dict[str, object]:
        """Return the options without relaxed bounds, which would allow a force of -1e-8 N."""
        return {**super().ipopt(), "bound_relax_factor": 0.0}

    def cold_barrier(self) -> dict[str, object]:
        """Return Ipopt's options without a plan to start from."""
        return {
            "mu_init": self.barrier_start,
            "bound_push": self.bound_push,
            "bound_frac": min(0.5, self.bound_push),
        }


@dataclass(frozen=True)
class Work:
    """Iteration limit times the size of the model, and the minimum number of iterations."""

    most: float
    fewest: int

    def iterations(self, size: int) -> int:
        """Return the iteration limit for a model of this size."""
        return max(self.fewest, int(self.most / size))


@dataclass(frozen=True, kw_only=True)
class StageRules:
    """The rules of a stage at one eps.

    - ipopt: options of every solve
    - cold: more options, for a start without a plan
    - cold_work, warm_work: limit of one solve (None: only `max_iter`)
    - takes_duals: whether a stage starts with the multipliers of the previous stage too
    - sharpest: sharpness b [1/m] of softplus contact as far from the true law as the method's
      contact
    - plan_limits: largest residuals of an unsolved last iterate that counts as a plan
    - promises: largest residuals of a SOLVED plan
    """

    ipopt: Mapping[str, object]
    cold: Mapping[str, object]
    cold_work: Work | None
    warm_work: Work | None
    takes_duals: bool
    sharpest: float
    plan_limits: Mapping[str, float]
    promises: Mapping[str, float]


_COLUMNS = ("objective", "inf_pr", "inf_du", "mu")


class SolveBudget:
    """The iterations, work and seconds of one stage.

    opened: wall and CPU seconds before the stage that count for it
    work: Ipopt iterations times nonzeros of Jacobian and Hessian, machine-independent
    most_work: limit of work
    """

    def __init__(self, time_limit: float, opened: tuple[float, float] = (0.0, 0.0)) -> None:
        self._wall, self._cpu = perf_counter() - opened[0], process_time() - opened[1]
        self._deadline = self._wall + time_limit
        self.build, self.translate, self.evaluate, self.linear_algebra = opened[0], 0.0, 0.0, 0.0
        self.iterations = 0
        self.work, self.most_work = 0.0, math.inf
        self.solver = ""  # Ipopt's version
        self.history: dict[str, list[float]] = {name: [] for name in _COLUMNS}

    @property
    def remaining(self) -> float:
        """Return the remaining wall seconds, at least 1 ms: Ipopt needs a positive limit."""
        return max(1e-3, self._deadline - perf_counter())

    @property
    def is_late(self) -> bool:
        """Return whether the time is used up."""
        return perf_counter() >= self._deadline

    @property
    def is_over(self) -> bool:
        """Return whether the time or the work is used up."""
        return self.is_late or self.work >= self.most_work

    def iterations_left(self, problem: IpoptProblem) -> float:
        """Return the iterations of Ipopt on a problem within the work limit."""
        return (
            max(0, math.ceil((self.most_work - self.work) / problem.nonzeros))
            if math.isfinite(self.most_work)
            else math.inf
        )

    def add(self, result: IpoptResult, problem: IpoptProblem) -> None:
        """Count one solve of a problem."""
        self.iterations += result.iterations
        self.work += result.iterations * problem.nonzeros
        self.solver = result.version
        self.evaluate += result.seconds.evaluate
        self.linear_algebra += result.seconds.linear_algebra
        for line in result.history:
            for name in _COLUMNS:
                self.history[name].append(getattr(line, name))

    @contextmanager
    def building(self) -> Iterator[None]:
        """Count the time inside the context as building."""
        begin = perf_counter()
        yield
        self.build += perf_counter() - begin

    def spent_on(self, solution: Solution) -> Solution:
        """Return the solution with the spent iterations and seconds, and its finite residuals."""
        return replace(
            solution,
            iterations=self.iterations,
            seconds=Seconds(
                build=self.build,
                translate=self.translate,
                evaluate=self.evaluate,
                linear_algebra=self.linear_algebra,
                wall=perf_counter() - self._wall,
                cpu=process_time() - self._cpu,
            ),
            residuals={
                name: value for name, value in solution.residuals.items() if math.isfinite(value)
            },
            solver=self.solver,
            history={name: tuple(values) for name, values in self.history.items()},
        )

    def add_solution(self, solution: Solution) -> None:
        """Count the stage of another method; its work has limits of its own."""
        self.iterations += solution.iterations
        self.solver = self.solver or solution.solver
        for name in ("build", "translate", "evaluate", "linear_algebra"):
            setattr(self, name, getattr(self, name) + getattr(solution.seconds, name))
        self.history = {
            name: values + list(solution.history.get(name, ()))
            for name, values in self.history.items()
        }

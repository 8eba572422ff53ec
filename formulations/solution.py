"""The result of a method: a Solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING

from models.results.run import ModelSize, Seconds
from models.trajectory import Trajectory

if TYPE_CHECKING:  # a Solution does not import Pyomo
    from formulations.certificate.certificate import Certificate
    from models.scene import Scene


class Outcome(Enum):
    """The end of a solve; the value is a sentence of advice."""

    SOLVED = "Solved: the method's own stopping rule was met."
    ITERATION_LIMIT = "Stopped at the number of iterations it was given; allow more, or use the plan as a warm start."
    TIME_LIMIT = "Stopped at its time limit; allow more time, or start it warm."
    INFEASIBLE = "No plan satisfies the constraints (locally); check goal, bounds and horizon, or start from another guess."
    DIVERGED = "Iterates or gradients grew without bound; set bounds, or start from another guess."
    STALLED = "No further progress before the tolerances were met; start from another guess."
    EVALUATION_ERROR = (
        "A function value was not a finite number; check the start and the parameters."
    )
    INTERRUPTED = "Stopped by the user."
    REFUSED = "The method does not apply to this scene; see the message."
    CRASHED = "The process ended without an answer; see the log."
    GIVEN = "Read from a file; no method of ours found this plan."
    FAILED = "The solver ended without a known reason; see the log."

    def __repr__(self) -> str:
        return f"Outcome.{self.name}"

    @property
    def has_answer(self) -> bool:
        """Return whether a plan may come with this outcome, valid or not."""
        return self in {
            Outcome.SOLVED,
            Outcome.ITERATION_LIMIT,
            Outcome.TIME_LIMIT,
            Outcome.STALLED,
            Outcome.INTERRUPTED,
            Outcome.GIVEN,
        }


@dataclass(frozen=True, kw_only=True)
class Solution:
    """The result of one stage.

    - message: one sentence, or ""
    - trajectory: the plan, or None
    - cost: running cost over the steps plus final cost
    - residuals: unscaled, by name, recomputed from the scene
    - certificate: of the plan in the scene's strict model (`certify_solution`),
      or None
    - starts: all starts, if there are several
    - options: all options
    - solver: name and version of the underlying solver
    - history: per iteration, columns of equal length by name
    - size: of the model of the solver; paper_size: counted by hand
    """

    method: str
    outcome: Outcome
    message: str = ""
    trajectory: Trajectory | None = None
    cost: float | None = None
    iterations: int = 0
    seconds: Seconds = field(default_factory=Seconds)
    residuals: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    solver: str = ""
    options: Mapping[str, object] = field(default_factory=lambda: MappingProxyType({}))
    history: Mapping[str, tuple[float, ...]] = field(default_factory=lambda: MappingProxyType({}))
    certificate: Certificate | None = None
    starts: tuple[Attempt, ...] = ()
    size: ModelSize | None = None
    paper_size: ModelSize | None = None


def ended(message: str) -> str:
    """Return the message with a full stop."""
    return message if not message or message.endswith(".") else f"{message}."


def as_asked(scene: Scene, solution: Solution) -> Solution:
    """Turn SOLVED into STALLED for a cost above the scene's limit: a local optimum."""
    limit = scene.limit("replay_cost")
    most = None if limit is None else limit.value
    if (
        solution.outcome is not Outcome.SOLVED
        or solution.cost is None
        or most is None
        or solution.cost <= most
    ):
        return solution
    local = f"It is a local optimum: its cost is {solution.cost:.3g}, the scene allows at most {most:.3g}; start elsewhere."
    return replace(solution, outcome=Outcome.STALLED, message=f"{solution.message} {local}".strip())


def checked(
    outcome: Outcome, message: str, residuals: Mapping[str, float], limits: Mapping[str, float]
) -> tuple[Outcome, str]:
    """Turn SOLVED into STALLED if a residual exceeds its limit or is NaN, and name it."""
    missed = beyond(limits, residuals)
    if outcome is not Outcome.SOLVED or not missed:
        return outcome, message
    worst = ", ".join(
        f"{name} is {residuals[name]:.3g} (limit {limit:g})" for name, limit in missed.items()
    )
    return Outcome.STALLED, f"{message} Checked on the plan itself, {worst}."


def beyond(limits: Mapping[str, float], residuals: Mapping[str, float]) -> dict[str, float]:
    """Return the limits that are exceeded; NaN exceeds."""
    return {name: limit for name, limit in limits.items() if not residuals.get(name, 0.0) <= limit}


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One of several starts.

    start: description
    cost: None without a plan
    """

    start: str
    outcome: Outcome
    cost: float | None = None

"""What a solve hands back, frozen; and the explicit step that writes it into the Pyomo model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from pyomo.core.staleflag import StaleFlagManager

from formulations.ipopt.problem import IpoptProblem
from formulations.ipopt.residuals import Residuals
from formulations.solution import Outcome


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """One line of Ipopt's log. objective and mu in the model's sign and scale, inf_pr and inf_du as Ipopt scales them."""

    iteration: int
    restoration: bool
    objective: float
    inf_pr: float
    inf_du: float
    mu: float
    step: float
    regularization: float
    alpha_du: float
    alpha_pr: float
    trials: int


@dataclass(frozen=True, kw_only=True)
class Seconds:
    """Wall time of one solve [s]: inside the model's functions, in the rest of Ipopt (its linear algebra), and in all; CPU time in all."""

    evaluate: float = 0.0
    linear_algebra: float = 0.0
    wall: float = 0.0
    cpu: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class IpoptResult:
    """How a solve ended.

    status: Ipopt's code (`NOT_SENT` if Ipopt was not needed); outcome: after our own check; message: one sentence
    x: (n,) by `problem.variables`; lagrange: (m,) by `problem.equations`; zl, zu: (n,), all in Ipopt's signs, L = f + lagrange' g - zl' x + zu' x
    objective: in the model's own sense; residuals: unscaled, at x
    """

    status: int
    outcome: Outcome
    message: str
    x: np.ndarray
    lagrange: np.ndarray
    zl: np.ndarray
    zu: np.ndarray
    objective: float
    iterations: int
    residuals: Residuals
    history: tuple[Iteration, ...]
    seconds: Seconds
    calls: Mapping[str, int] = field(default_factory=dict)
    options: Mapping[str, str | int | float]
    version: str

    @property
    def solved(self) -> bool:
        return self.outcome is Outcome.SOLVED


def load(problem: IpoptProblem, result: IpoptResult) -> None:
    """Write x into the model's variables (marking all others stale, as Pyomo's solvers do)."""
    StaleFlagManager.mark_all_as_stale()
    for variable, number in zip(problem.variables, result.x.tolist(), strict=True):
        variable.set_value(number, skip_validation=True)
    StaleFlagManager.mark_all_as_stale(delayed=True)

"""What a solve hands back, and the explicit step that writes it into the user's model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pyomo.core.staleflag import StaleFlagManager

from formulations.mpec.certificate.certificate import Certificate
from formulations.mpec.homotopy import Step
from formulations.solution import Outcome


@dataclass(frozen=True, kw_only=True, eq=False)
class PairState:
    """How one complementarity ended: the values of its two sides, and their multipliers (NaN without polish).

    For a box l <= body <= u the sides are the distance to the nearer bound and the free expression towards it.
    """

    name: str
    first: float
    second: float
    first_multiplier: float
    second_multiplier: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MpecResult:
    """variables, x: the user's variables and their values; rows, lagrange: the user's constraints and their multipliers (Ipopt's signs),
    zl, zu (n,): of bounds; all NaN where there are none. objective in the model's own sense. polished: every pair decided, and what
    remained solved exactly; has_multipliers: false without polish, and where those of the branch do not belong to the point. steps: the path. residual: largest min of a pair. certificate: recomputed from the model (None if switched off).
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
    steps: tuple[Step, ...]
    iterations: int
    solves: int
    seconds: float
    certificate: Certificate | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    has_objective: bool = True

    @property
    def solved(self) -> bool:
        return self.outcome is Outcome.SOLVED

    @property
    def has_point(self) -> bool:
        return self.x.size == len(self.variables) and bool(np.all(np.isfinite(self.x))) and self.outcome.has_answer


def is_feasible(result: MpecResult) -> bool:
    """Whether the point is known to satisfy the model, complementarity included."""
    return result.has_point and result.certificate is not None and result.certificate.feasible


def load(result: MpecResult) -> None:
    """Write x into the variables, marking all others stale as Pyomo's solvers do."""
    StaleFlagManager.mark_all_as_stale()
    for variable, number in zip(result.variables, result.x.tolist(), strict=True):
        variable.set_value(number, skip_validation=True)
    StaleFlagManager.mark_all_as_stale(delayed=True)

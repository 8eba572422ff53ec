"""The results of a solve, and the explicit step that writes them into the Pyomo model.

`STATUS` maps Ipopt's return codes to an Outcome; an unknown code is FAILED. `residuals` measures
the distance from a KKT point of the model as written, independently of Ipopt's own report.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

import numpy as np
from pyomo.core.staleflag import StaleFlagManager

from formulations.ipopt.problem import IpoptProblem
from formulations.solution import Outcome, Seconds

# Ipopt's ApplicationReturnStatus (IpReturnCodes_inc.h), complete as of Ipopt 3.14. SOLVED is
# Ipopt's claim; `solve` keeps it only if the unscaled residuals agree.
STATUS = MappingProxyType({
    0: ("Solve_Succeeded", Outcome.SOLVED),
    1: ("Solved_To_Acceptable_Level", Outcome.SOLVED),
    2: ("Infeasible_Problem_Detected", Outcome.INFEASIBLE),
    3: ("Search_Direction_Becomes_Too_Small", Outcome.STALLED),
    4: ("Diverging_Iterates", Outcome.DIVERGED),
    5: ("User_Requested_Stop", Outcome.INTERRUPTED),
    6: ("Feasible_Point_Found", Outcome.SOLVED),
    -1: ("Maximum_Iterations_Exceeded", Outcome.ITERATION_LIMIT),
    -2: ("Restoration_Failed", Outcome.STALLED),
    -3: ("Error_In_Step_Computation", Outcome.STALLED),
    -4: ("Maximum_CpuTime_Exceeded", Outcome.TIME_LIMIT),
    -5: ("Maximum_WallTime_Exceeded", Outcome.TIME_LIMIT),
    -10: ("Not_Enough_Degrees_Of_Freedom", Outcome.REFUSED),
    -11: ("Invalid_Problem_Definition", Outcome.REFUSED),
    -12: ("Invalid_Option", Outcome.FAILED),
    -13: ("Invalid_Number_Detected", Outcome.EVALUATION_ERROR),
    -100: ("Unrecoverable_Exception", Outcome.FAILED),
    -101: ("NonIpopt_Exception_Thrown", Outcome.FAILED),
    -102: ("Insufficient_Memory", Outcome.CRASHED),
    -199: ("Internal_Error", Outcome.CRASHED),
})  # fmt: skip

# Status of a problem decided without Ipopt: no free variable, contradicting bounds, or a violated
# constraint without variables.
NOT_SENT = -1000


def outcome_of(status: int) -> Outcome:
    """Return the outcome that Ipopt's code claims, FAILED for an unknown code."""
    return STATUS[status][1] if status in STATUS else Outcome.FAILED


def name_of(status: int) -> str:
    """Return Ipopt's name of a status."""
    return STATUS[status][0] if status in STATUS else f"unknown Ipopt status {status}"


# Limits of the relative residuals of a solved point. Ipopt stops at 1e-8 in its own scaling, which
# can differ from the model's by a factor 100, and relaxes bounds by 1e-8: hence 1e-6.
# Violation of a constraint or bound, relative to max(1, |bound|).
FEASIBILITY = 1e-6
# Stationarity, relative to the largest term of its own sum (at least 1).
STATIONARITY = 1e-5
# Complementarity, relative to max(1, |objective|).
COMPLEMENTARITY = 1e-5


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Largest absolute residuals, and the decisive relative ones; all NaN if a function is NaN."""

    constraint_violation: float
    dual_infeasibility: float
    complementarity: float
    relative_violation: float
    relative_dual: float
    relative_complementarity: float

    def meets(self, tolerance: float = 0.0) -> bool:
        """Return whether the point passes; a `tolerance` above the limits replaces them."""
        return (
            self.relative_violation <= max(FEASIBILITY, tolerance)
            and self.relative_dual <= max(STATIONARITY, tolerance)
            and self.relative_complementarity <= max(COMPLEMENTARITY, tolerance)
        )

    @property
    def feasible(self) -> bool:
        """Return whether all constraints and bounds hold to `FEASIBILITY`."""
        return self.relative_violation <= FEASIBILITY

    @property
    def sentence(self) -> str:
        """Return the three residuals as text."""
        return (
            f"constraint violation {self.constraint_violation:.2e}, dual infeasibility {self.dual_infeasibility:.2e}, "
            f"complementarity {self.complementarity:.2e} (unscaled)"
        )


def _largest(values: np.ndarray) -> float:
    return float(np.max(values)) if values.size else 0.0


def bound_products(
    problem: IpoptProblem,
    x: np.ndarray,
    g: np.ndarray,
    lagrange: np.ndarray,
    zl: np.ndarray,
    zu: np.ndarray,
    rows: np.ndarray,
) -> np.ndarray:
    """Return |distance to a finite bound * multiplier| (bounds,) [objective units]. Raises nothing.

    rows: (m,) mask of the constraints to include; all variables are.
    """
    low, high = problem.constraint_lower, problem.constraint_upper
    sides = (
        (x - problem.lower, zl, np.isfinite(problem.lower)),
        (problem.upper - x, zu, np.isfinite(problem.upper)),
        (g - low, np.maximum(-lagrange, 0.0), rows & np.isfinite(low)),
        (high - g, np.maximum(lagrange, 0.0), rows & np.isfinite(high)),
    )
    return np.concatenate(
        [np.abs(distance[where] * multiplier[where]) for distance, multiplier, where in sides]
    )


def residuals(
    problem: IpoptProblem, x: np.ndarray, lagrange: np.ndarray, zl: np.ndarray, zu: np.ndarray
) -> Residuals:
    """Return the unscaled residuals at x (n,); NaN if a function is NaN. Raises nothing.

    lagrange (m,), zl, zu (n,) are multipliers in Ipopt's signs [objective per row].
    """
    objective, g = problem.values(x)
    gradient, jacobian = problem.derivatives(x)
    rows, columns = problem.jacobianstructure()
    with np.errstate(all="ignore"):
        values = np.concatenate([g, x])
        low = np.concatenate([problem.constraint_lower, problem.lower])
        high = np.concatenate([problem.constraint_upper, problem.upper])
        below, above = np.maximum(low - values, 0.0), np.maximum(values - high, 0.0)
        violation = np.where(np.isnan(values), np.nan, np.maximum(below, above))
        size = np.maximum(1.0, np.maximum(_finite_size(low), _finite_size(high)))

        products = jacobian * lagrange[rows]
        stationarity = gradient + np.bincount(columns, products, problem.n) - zl + zu
        # Equal bounds admit any multiplier.
        stationarity[problem.lower == problem.upper] = 0.0
        wrong_side = np.concatenate([
            np.maximum(-lagrange, 0.0)[np.isinf(problem.constraint_lower)],
            np.maximum(lagrange, 0.0)[np.isinf(problem.constraint_upper)],
        ])  # fmt: skip
        dual = np.concatenate(
            [np.abs(stationarity), wrong_side, np.maximum(-zl, 0.0), np.maximum(-zu, 0.0)]
        )
        terms = [
            1.0,
            _largest(np.abs(gradient)),
            _largest(np.abs(products)),
            _largest(np.abs(zl)),
            _largest(np.abs(zu)),
        ]

        complementarity = bound_products(problem, x, g, lagrange, zl, zu, np.full(problem.m, True))
    worst_dual, worst_product = _largest(dual), _largest(complementarity)
    if not np.isfinite(objective):
        worst_dual = float("nan")
    return Residuals(
        constraint_violation=_largest(violation),
        dual_infeasibility=worst_dual,
        complementarity=worst_product,
        relative_violation=_largest(violation / size),
        relative_dual=worst_dual / max(terms),
        relative_complementarity=worst_product / max(1.0, abs(objective)),
    )


def _finite_size(bound: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(bound), np.abs(bound), 0.0)


UNKNOWN = Residuals(**dict.fromkeys((item.name for item in fields(Residuals)), float("nan")))


@dataclass(frozen=True)
class Iteration:
    """One line of Ipopt's log, in Ipopt's order except for the first two fields.

    objective and mu have the model's sign and scale; inf_pr and inf_du have Ipopt's scaling
    """

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


@dataclass(frozen=True, kw_only=True, eq=False)
class IpoptExit:
    """The end of an Ipopt run: status (`NOT_SENT` without a run), point and multipliers.

    message: only if Ipopt did not run
    x, zl, zu: (n,)
    lagrange: (m,), in Ipopt's signs, L = f + lagrange' g - zl' x + zu' x
    """

    status: int
    message: str = ""
    x: np.ndarray
    lagrange: np.ndarray
    zl: np.ndarray
    zu: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class IpoptResult(IpoptExit):
    """The result of a solve.

    outcome: after our own check of the residuals
    objective: in the model's own sense
    residuals: unscaled, at x
    seconds: in the model's functions, in the rest of Ipopt, in total
    """

    outcome: Outcome
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
        """Return whether the outcome is SOLVED."""
        return self.outcome is Outcome.SOLVED

    @property
    def explanation(self) -> str:
        """Return the message; for a local infeasibility with the remark that it proves nothing."""
        if self.outcome is Outcome.INFEASIBLE and self.status != NOT_SENT:
            return f"no feasible point was found near the start; another start may find one ({self.message})"
        return self.message


def load(problem: IpoptProblem, result: IpoptResult) -> None:
    """Write x into the model's variables."""
    write_point(problem.variables, result.x)


def write_point(variables: tuple[Any, ...], x: np.ndarray) -> None:
    """Set variables to x (n,) [variable units], and mark the rest stale, as Pyomo's solvers do.

    Raises ValueError if x has another size.
    """
    StaleFlagManager.mark_all_as_stale()
    for variable, number in zip(variables, x.tolist(), strict=True):
        variable.set_value(number, skip_validation=True)
    StaleFlagManager.mark_all_as_stale(delayed=True)

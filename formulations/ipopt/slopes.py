"""Report derivatives that are infinite or undefined at the end point of a solver.

    endless_slope(problem, x)  # "the slope of objective 'o' is infinite at x = 0", or ""

Such a point may be optimal: sqrt(x) is smallest at x = 0, which derivatives cannot show.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formulations.ipopt.problem import IpoptProblem

# Distance from a bound or round number with an infinite slope, relative to max(1, |x|), at which
# solvers stop. A square root changes by 0.01 there, more than any tolerance.
_NEAR = 1e-4
# Significant digits of a round number.
_DIGITS = 4


def endless_slope(problem: IpoptProblem, x: np.ndarray) -> str:
    """Return a clause on the first function without a finite derivative at x (n,), or "".

    Bounds and round numbers near x [units of the variables] are checked too. Raises nothing.
    """
    if not np.all(np.isfinite(x)):
        return ""
    row, column = problem.jacobianstructure()
    for point in (x, _rounded(problem, x)):
        objective, constraints = problem.values(point)
        gradient, entries = problem.derivatives(point)
        for wrong in np.flatnonzero(~np.isfinite(gradient)).tolist():
            if np.isfinite(objective):
                variable = problem.variables[wrong]
                return in_words(problem.objective_data, variable, point[wrong], gradient[wrong])
        for wrong in np.flatnonzero(~np.isfinite(entries)).tolist():
            if np.isfinite(constraints[row[wrong]]):
                source, at = problem.equations[row[wrong]], column[wrong]
                return in_words(source, problem.variables[at], point[at], entries[wrong])
    return ""


def in_words(source: Any, variable: Any, at: Any, slope: Any) -> str:
    """Return a clause such as `the slope of objective 'o' is infinite at x = 0`.

    source is a component; variable and at [unit of the variable] are those of the derivative; slope
    is infinite, or NaN if undefined. Raises nothing.
    """
    what = f"{source.ctype.__name__.lower()} '{source.name}'"
    where = f"{variable.name} = {at:.6g}"
    if np.isnan(slope):
        return f"{what} has no derivative at {where}"
    return f"the slope of {what} is infinite at {where}"


def _rounded(problem: IpoptProblem, x: np.ndarray) -> np.ndarray:
    """Return the point (n,) with each variable moved to a bound or round number close to it."""
    with np.errstate(all="ignore"):
        rounded = np.array([float(f"{value:.{_DIGITS}g}") for value in x.tolist()])
    rounded = np.where(np.abs(x) <= _NEAR, 0.0, rounded)
    rounded = np.where(np.abs(rounded - x) <= _NEAR * np.maximum(1.0, np.abs(x)), rounded, x)
    for bound in (problem.lower, problem.upper):
        near = np.isfinite(bound) & (np.abs(x - bound) <= _NEAR * np.maximum(1.0, np.abs(bound)))
        rounded = np.where(near, bound, rounded)
    return rounded

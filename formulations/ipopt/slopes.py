"""Derivatives that are infinite or undefined where a solver ended, in words.

    endless_slope(problem, x)       # "the slope of objective 'o' is infinite at x = 0", "" without one

Such a point may be right, and no test by derivatives can tell: sqrt(x) is least at x = 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formulations.ipopt.problem import IpoptProblem

# Solvers end this near the bound, or the round number, at which a slope is infinite, relative to
# max(1, |x|): a root changes by a hundredth there, which no tolerance overlooks.
_NEAR = 1e-4
_DIGITS = 4


def endless_slope(problem: IpoptProblem, x: np.ndarray) -> str:
    """Name the first function that has no finite derivative at x (n,) [units of the variables], or at the bounds and round numbers that x is near, and a variable.

    Empty if there is none. Raises nothing.
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
    """Return `the slope of objective 'o' is infinite at x = 0`, a clause.

    Parameters
    ----------
    source : the objective, constraint or complementarity
    variable, at : by which it has no finite derivative, and its value [unit of the variable]
    slope : the derivative: infinite, or NaN where there is none

    Raises
    ------
    Nothing.
    """
    what = f"{source.ctype.__name__.lower()} '{source.name}'"
    where = f"{variable.name} = {at:.6g}"
    if np.isnan(slope):
        return f"{what} has no derivative at {where}"
    return f"the slope of {what} is infinite at {where}"


def _rounded(problem: IpoptProblem, x: np.ndarray) -> np.ndarray:
    """The point (n,) with each variable at the bound or at the round number that it is within rounding of."""
    with np.errstate(all="ignore"):
        found = np.array([float(f"{value:.{_DIGITS}g}") for value in x.tolist()])
    found = np.where(np.abs(x) <= _NEAR, 0.0, found)
    found = np.where(np.abs(found - x) <= _NEAR * np.maximum(1.0, np.abs(x)), found, x)
    for bound in (problem.lower, problem.upper):
        near = np.isfinite(bound) & (np.abs(x - bound) <= _NEAR * np.maximum(1.0, np.abs(bound)))
        found = np.where(near, bound, found)
    return found

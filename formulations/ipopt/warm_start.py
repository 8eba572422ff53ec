"""A start for Ipopt out of what the caller has: a point, perhaps multipliers, perhaps only some of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from formulations.ipopt.options import WARM_START_DEFAULTS
from formulations.ipopt.problem import IpoptProblem

# Limits of the barrier parameter that a primal-dual start begins with: Ipopt's own first value, and about its last.
_MU_LARGEST, _MU_SMALLEST = 0.1, 1e-9


@dataclass(frozen=True, kw_only=True)
class Start:
    """x (n,); multipliers lagrange (m,), zl, zu (n,) in Ipopt's signs, or None for a primal start."""

    x: np.ndarray
    lagrange: np.ndarray | None = None
    zl: np.ndarray | None = None
    zu: np.ndarray | None = None


def complete_start(problem: IpoptProblem, given: Start | None) -> tuple[Start, int]:
    """(start with all multipliers or none, number of variables that had no value).

    Missing lagrange are 0; missing zl and zu are what stationarity leaves to them. Raises ValueError for a wrong shape or a NaN.
    """
    if given is None:
        x, missing = problem.start()
        return Start(x=x), missing
    x = _checked("x", given.x, problem.n)
    if given.lagrange is None and given.zl is None and given.zu is None:
        return Start(x=x), 0
    lagrange = np.zeros(problem.m) if given.lagrange is None else _checked("lagrange", given.lagrange, problem.m)
    zl = None if given.zl is None else _checked("zl", given.zl, problem.n)
    zu = None if given.zu is None else _checked("zu", given.zu, problem.n)
    if zl is None or zu is None:
        slope = np.nan_to_num(_lagrangian_slope(problem, x, lagrange), nan=0.0, posinf=0.0, neginf=0.0)
        if zl is None:
            zl = np.where(np.isfinite(problem.lower), np.maximum(slope, 0.0), 0.0)
        if zu is None:
            zu = np.where(np.isfinite(problem.upper), np.maximum(-slope, 0.0), 0.0)
    return Start(x=x, lagrange=lagrange, zl=zl, zu=zu), 0


def _checked(name: str, values: np.ndarray, size: int) -> np.ndarray:
    array = np.array(values, dtype=float)
    if array.shape != (size,):
        raise ValueError(f"warm_start.{name} has shape {array.shape}, the problem needs ({size},)")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"warm_start.{name} holds a number that is not finite")
    return array


def _lagrangian_slope(problem: IpoptProblem, x: np.ndarray, lagrange: np.ndarray) -> np.ndarray:
    gradient, jacobian = problem.split_entries(problem.entries_at(x))
    rows, columns = problem.jacobianstructure()
    return gradient + np.bincount(columns, jacobian * lagrange[rows], problem.n)


def warm_options(problem: IpoptProblem, start: Start) -> dict[str, str | int | float]:
    """Options of a primal-dual start; the barrier parameter is the mean complementarity of what was given."""
    if start.lagrange is None or start.zl is None or start.zu is None:
        return {}
    g = problem.constraints(start.x)
    inequality = problem.constraint_lower < problem.constraint_upper
    products = np.concatenate([
        _products(start.x - problem.lower, start.zl, np.isfinite(problem.lower)),
        _products(problem.upper - start.x, start.zu, np.isfinite(problem.upper)),
        _products(g - problem.constraint_lower, np.maximum(-start.lagrange, 0.0), inequality & np.isfinite(problem.constraint_lower)),
        _products(problem.constraint_upper - g, np.maximum(start.lagrange, 0.0), inequality & np.isfinite(problem.constraint_upper)),
    ])  # fmt: skip
    products = products[np.isfinite(products)]
    mean = float(np.mean(products)) if products.size else _MU_SMALLEST
    return {**WARM_START_DEFAULTS, "mu_init": min(_MU_LARGEST, max(_MU_SMALLEST, mean))}


def _products(distance: np.ndarray, multiplier: np.ndarray, where: np.ndarray) -> np.ndarray:
    return np.abs(distance[where] * multiplier[where])

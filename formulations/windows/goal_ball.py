"""The cheapest end state within a ball around the goal: with e = z[T] - goal the optimal cost is a convex quadratic of e,

    J(e) = J(0) - w(0)' e - 1/2 e' W e,     w(e) = w(0) + W e the multipliers of the goal,

so that |e| <= ball leaves a problem of 2*nq numbers, solved by one eigenvalue decomposition and one scalar equation.
"""

from __future__ import annotations

import numpy as np

from formulations.windows.kkt import BandedKKT

_HALVINGS = 80  # of the interval in which the logarithm of the multiplier lies: below rounding


def nearest_goal(kkt: BandedKKT, x: np.ndarray, columns: np.ndarray, right: np.ndarray, ball: float) -> tuple[np.ndarray, np.ndarray]:
    """(solution, right-hand side) with the goal moved by the best e. x: solution for the goal itself; columns: per unit of e."""
    moved = kkt.goal_columns()
    place = np.nonzero(moved)[0]
    curvature = -columns[place]
    e = cheapest_in_ball(-x[place], 0.5 * (curvature + curvature.T), ball)
    return x + columns @ e, right + moved @ e


def cheapest_in_ball(slope: np.ndarray, curvature: np.ndarray, radius: float) -> np.ndarray:
    """argmin over |e| <= radius of slope' e + 1/2 e' curvature e, for a positive semidefinite curvature (n, n)."""
    values, vectors = np.linalg.eigh(curvature)
    values = np.maximum(values, 0.0)
    along = vectors.T @ slope

    def length(shift: float) -> float:
        return float(np.linalg.norm(along / (values + shift)))

    smallest = np.finfo(float).tiny + 1e-15 * values[-1]
    if length(smallest) <= radius:
        return -vectors @ (along / (values + smallest))
    low, high = np.log(smallest), np.log(np.linalg.norm(along) / radius) + 1.0  # beyond the upper end the length is below the radius
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if length(np.exp(middle)) > radius else (low, middle)
    return -vectors @ (along / (values + np.exp(high)))

"""Inputs that hit the goal to rounding: the last 1e-9 between a solver's plan and its replay, taken out by Newton steps on the true rollout.

    rollout, u = land(kernel, start, goal, u, step, (lower, upper), ball)

Each step is the smallest change of the inputs that moves the end state where it should be, by the adjoint of the time step; inputs on their bounds stay.
"""

from __future__ import annotations

import numpy as np

from models import goal as goals
from models.codegen.kernel import Kernel, Rollout

_GOOD_ENOUGH = 1e-13  # relative to the size of the goal: what a rollout of some hundred steps rounds to
_MOST, _HALVINGS = (
    30,
    6,
)  # Newton steps (a plan of a solver needs one or two), and how often one is halved where contact modes change on the way


def land(
    kernel: Kernel,
    start: np.ndarray,
    goal: np.ndarray,
    u: np.ndarray,
    step: float,
    bounds: tuple[np.ndarray, np.ndarray],
    ball: float = 0.0,
) -> tuple[Rollout, np.ndarray]:
    """The rollout and the corrected inputs; it ends nearer to the goal (or to the ball around it) than that of u, or is that of u."""
    u = np.clip(u, *bounds)
    best = kernel.rollout(start, u, step)
    miss = miss_of(best, goal, ball)
    for _ in range(_MOST):
        if best.diverged or np.linalg.norm(miss) <= _GOOD_ENOUGH * max(1.0, float(np.linalg.norm(np.nan_to_num(goal)))):
            break
        slopes = _sensitivity(kernel, best, u, len(goal))
        slopes = np.where((u > bounds[0]) & (u < bounds[1]), slopes, 0.0).reshape(len(goal), -1)
        slopes[np.isnan(goal)] = 0.0  # a free component does not ask for anything
        change = np.linalg.lstsq(slopes, -miss, rcond=1e-12)[0].reshape(u.shape)
        for halving in range(_HALVINGS):
            tried_u = np.clip(u + 0.5**halving * change, *bounds)
            tried = kernel.rollout(start, tried_u, step)
            tried_miss = miss_of(tried, goal, ball)
            if not tried.diverged and np.linalg.norm(tried_miss) < np.linalg.norm(miss):
                break
        else:
            break
        best, u, miss = tried, tried_u, tried_miss
    return best, u


def miss_of(rollout: Rollout, goal: np.ndarray, ball: float) -> np.ndarray:
    """By how much the end misses the ball around the goal, as a vector."""
    error = goals.miss(np.concatenate([rollout.q[-1], rollout.v[-1]]), goal)
    size = float(np.linalg.norm(error))
    return error * (max(0.0, size - ball) / size) if size > 0.0 else error


def _sensitivity(kernel: Kernel, rollout: Rollout, u: np.ndarray, n: int) -> np.ndarray:
    """d(q, v)[T]/du: (n, steps, nu)."""
    rows = []
    for index in range(n):
        q_bar, v_bar = np.zeros_like(rollout.q), np.zeros_like(rollout.v)
        end = np.zeros(n)
        end[index] = 1.0
        q_bar[-1], v_bar[-1] = end[: n // 2], end[n // 2 :]
        rows.append(kernel.adjoint(rollout, u, q_bar, v_bar)[0])
    return np.stack(rows)

"""From contact modes that miss the goal to modes that reach it: the same search over windows, with the miss as a price that rises.

    answer = approach(problem, closed, stride, is_over)          # closed: the modes of a rollout, whatever it ends at

The modes of a rollout always have a plan if the goal need not be met. Its cost is sum_t cost + |z[T] - goal|^2 / (2 softness); windows are
searched for less of it, the softness falls, until the modes found have a plan that meets the goal. Steering one rollout stops where a contact
would have to begin or end; here that is a neighbour like any other, and the multipliers of touching pairs say which.

Inputs that hit the goal to rounding: what a solver's plan misses it by in its replay is taken out by steps on the true rollout.

    rollout, u = land(kernel, start, goal, u, step, (lower, upper), ball)

Each step is the smallest change of the inputs that moves the end state where it should be, by the adjoint of the time step (Levenberg and
Marquardt: a Newton step where that works, as it does for a miss of 1e-9; a shorter one, along which contacts may begin and end, from further
off). Inputs on a bound are not pushed across it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from formulations.contact_modes.quadratic import ModesAnswer, ModesProblem
from formulations.contact_modes.search import search_windows
from models.codegen.kernel import Kernel, Rollout
from models.contact_law import ContactLaw
from models.scene import goal as goals
from models.scene.goal import distance

_GOOD_ENOUGH = 1e-13  # relative to the size of the goal: what a rollout of some hundred steps rounds to
_MOST = 150  # steps tried; the plan of a solver needs one or two, a softplus plan with many contacts up to a hundred
_FIRST_TRIES, _CALMER, _BOLDER = (
    1e-4,
    4.0,
    0.2,
)  # damping after the first failure (part of the largest eigenvalue); its factor after failure and success
_LEAST, _LARGEST = 1e-10, 1e8  # damping below which it is none at all, and above which nothing is left to try

# By softplus: factor between two sharpnesses b L, the last (eps = exp(-b L) must be a number), steps tried at each, and the miss that is enough there.
_SHARPER, _SHARPEST, _EACH, _ON_THE_WAY = 1.25, 700.0, 25, 1e-7


def land(
    kernel: Kernel,
    start: np.ndarray,
    goal: np.ndarray,
    u: np.ndarray,
    step: float,
    bounds: tuple[np.ndarray, np.ndarray],
    ball: float = 0.0,
    *,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
    most: int = _MOST,
    enough: float = _GOOD_ENOUGH,
) -> tuple[Rollout, np.ndarray]:
    """The rollout and the corrected inputs; it ends nearer to the goal (or to the ball around it) than that of u, or is that of u."""
    u = np.clip(u, *bounds)
    best = kernel.rollout(start, u, step, law, eps)
    miss = miss_of(best, goal, ball)
    near = enough * max(1.0, float(np.linalg.norm(np.nan_to_num(goal))))
    damping, slopes = 0.0, None
    for _ in range(most):
        if best.diverged or np.linalg.norm(miss) <= near or damping > _LARGEST:
            break
        if slopes is None:
            slopes = _sensitivity(kernel, best, u, len(goal))
            slopes[np.isnan(goal)] = 0.0  # a free component does not ask for anything
        tried_u = np.clip(u + _change(slopes, miss, u, bounds, damping), *bounds)
        tried = kernel.rollout(start, tried_u, step, law, eps)
        tried_miss = miss_of(tried, goal, ball)
        if not tried.diverged and np.linalg.norm(tried_miss) < np.linalg.norm(miss):
            best, u, miss, slopes = tried, tried_u, tried_miss, None
            damping = damping * _BOLDER if damping > _LEAST else 0.0
        else:
            damping = max(_FIRST_TRIES, damping * _CALMER)
    return best, u


def land_by_softplus(
    kernel: Kernel,
    start: np.ndarray,
    goal: np.ndarray,
    u: np.ndarray,
    step: float,
    bounds: tuple[np.ndarray, np.ndarray],
    ball: float,
    sharpness: float,
) -> tuple[Rollout, np.ndarray]:
    """The same by way of softplus contact that grows sharper in small steps, from `sharpness` (b L, L the scene's length),
    at which u nearly ends where it should.

    A contact that begins or ends on the way bends the path of the true law, and a miss may be smallest at such a bend; softplus has none.
    """
    for b in np.geomspace(sharpness, _SHARPEST, 2 + int(np.log(_SHARPEST / sharpness) / np.log(_SHARPER))):
        _, u = land(
            kernel, start, goal, u, step, bounds, ball, law=ContactLaw.SOFTPLUS, eps=float(np.exp(-b)), most=_EACH, enough=_ON_THE_WAY
        )
    return land(kernel, start, goal, u, step, bounds, ball)


def miss_of(rollout: Rollout, goal: np.ndarray, ball: float) -> np.ndarray:
    """By how much the end misses the ball around the goal, as a vector."""
    error = goals.miss(np.concatenate([rollout.q[-1], rollout.v[-1]]), goal)
    size = float(np.linalg.norm(error))
    return error * (max(0.0, size - ball) / size) if size > 0.0 else error


def _change(slopes: np.ndarray, miss: np.ndarray, u: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], damping: float) -> np.ndarray:
    """The damped step of the inputs (steps, nu); those on a bound that it would push outwards are left out of it."""
    free = np.ones(u.shape, dtype=bool)
    change = np.zeros(u.shape)
    for _ in range(2):
        matrix = (slopes * free).reshape(len(slopes), -1)
        gram = matrix @ matrix.T
        values, vectors = np.linalg.eigh(gram)
        shifted = values + damping * values[-1]
        along = np.where(shifted > 1e-14 * values[-1], vectors.T @ -miss / np.where(shifted > 0.0, shifted, 1.0), 0.0)
        change = (matrix.T @ (vectors @ along)).reshape(u.shape)
        free = ~(((u <= bounds[0]) & (change < 0.0)) | ((u >= bounds[1]) & (change > 0.0)))
    return change


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


_FIRST = 0.05  # the first miss is worth twenty times the cost of the inputs
_FALL, _LEVELS = 0.02, 4
_TRIES = 120  # modes tried at a level


def approach(problem: ModesProblem, closed: np.ndarray, stride: int, is_over: Callable[[], bool]) -> ModesAnswer | None:
    """The optimum of modes that meet the goal, or None where none were found."""
    linear = problem.linear
    try:
        problem.softness = 1.0
        answer = problem.solve(closed)
        if answer is None:
            return None
        problem.softness = _FIRST * distance(answer.point.z[-1], linear.goal) ** 2 / max(linear.cost(answer.point.z[:-1], answer.u), 1e-12)
        for _ in range(_LEVELS):
            softness = problem.softness
            if not softness > 0.0:
                return None
            answer = problem.solve(closed)
            if answer is None:
                return None
            last = problem.solves + _TRIES
            found = search_windows(
                answer,
                lambda modes, near, below: problem.solve(modes, near=near, below=below),
                stride=stride,
                is_over=lambda last=last: is_over() or problem.solves > last,
            )
            closed, problem.softness = found.best.closed, 0.0
            answer = problem.solve(closed)
            if answer is not None or is_over():
                return answer
            problem.softness = softness * _FALL
        return None
    finally:
        problem.softness = 0.0

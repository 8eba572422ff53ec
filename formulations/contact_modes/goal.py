"""Meet the goal: correct inputs until their rollout ends there, or continue modes to it.

    rollout, u = correct_end(scene, kernel, u)  # Levenberg-Marquardt by the adjoint
    answer = continue_to_goal(problem, closed, stride, is_over)

With the cost |z[T] - goal|^2 / (2 softness) instead of a hard goal, the modes of every rollout have
a plan. The softness falls during the mode search, until the modes meet the goal.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from formulations.contact_modes.quadratic import ModesProblem, QuadraticAnswer
from formulations.contact_modes.search import search_sequences
from formulations.grids import input_bounds
from models.codegen.kernel import Kernel, Rollout
from models.contact_law import ContactLaw
from models.scene import Scene
from models.scene.goal import distance, goal_state, miss

# Error of the goal relative to its size: rounding of a rollout of some hundred steps.
_GOOD_ENOUGH = 1e-13
# Steps tried; a solver's plan needs 1 or 2, a softplus plan with many contacts up to 100.
_MOST = 150
# Damping after the first failure, relative to the largest eigenvalue.
_FIRST_DAMPING = 1e-4
# Factor of the damping after a failure.
_CALMER = 4.0
# Factor of the damping after a success.
_BOLDER = 0.2
# A smaller damping is set to 0.
_LEAST = 1e-10
# A larger damping ends the correction.
_LARGEST = 1e8

# Factor between two sharpnesses b L of softplus.
_SHARPER = 1.25
# Last sharpness: eps = exp(-b L) must not underflow.
_SHARPEST = 700.0
# Steps tried at each sharpness.
_EACH = 25
# Sufficient error at each sharpness.
_ON_THE_WAY = 1e-7

# First softness: the initial error costs twenty times the inputs.
_FIRST = 0.05
# Factor of the softness per level.
_FALL = 0.02
# Number of levels.
_LEVELS = 4
# Modes tried per level.
_TRIES = 120


def correct_end(
    scene: Scene,
    kernel: Kernel,
    u: np.ndarray,
    *,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
    most: int = _MOST,
    enough: float = _GOOD_ENOUGH,
    scale: np.ndarray | float = 1.0,
) -> tuple[Rollout, np.ndarray]:
    """Change inputs u (steps, nu) [N, N m] as little as possible to end on the goal.

    - law, eps: contact law of the rollouts, and eps of softplus [-]
    - most: maximum number of steps
    - enough: tolerance relative to the goal's size [-]
    - scale: (2*nq,) [m, rad, m/s, rad/s], of each component of the error

    Return the closest rollout (at least as close as that of u) and its inputs. Raises KernelError
    if the mass matrix is not positive definite.
    """
    start, goal, step, bounds = (
        np.array(scene.task.start),
        goal_state(scene.task),
        scene.task.step,
        input_bounds(scene),
    )
    u = np.clip(u, *bounds)
    best = kernel.rollout(start, u, step, law, eps)
    missed = _end_miss(best, goal) / scale
    near = enough * max(1.0, float(np.linalg.norm(np.nan_to_num(goal) / scale)))
    aimed = np.flatnonzero(~np.isnan(goal))  # free components have no error
    ends = (np.eye(len(goal)) / scale)[aimed]
    damping, slopes = 0.0, None
    for _ in range(most):
        if best.diverged or np.linalg.norm(missed) <= near or damping > _LARGEST:
            break
        if slopes is None:
            slopes = np.zeros((len(goal), *u.shape))  # d(q, v)[T]/du
            for index, component in zip(aimed, ends, strict=True):
                slopes[index] = kernel.adjoint(best, u, end_bar=component)[0]
        tried_u = np.clip(u + _change(slopes, missed, u, bounds, damping), *bounds)
        tried = kernel.rollout(start, tried_u, step, law, eps)
        tried_miss = _end_miss(tried, goal) / scale
        if not tried.diverged and np.linalg.norm(tried_miss) < np.linalg.norm(missed):
            best, u, missed, slopes = tried, tried_u, tried_miss, None
            damping = damping * _BOLDER if damping > _LEAST else 0.0
        else:
            damping = max(_FIRST_DAMPING, damping * _CALMER)
    return best, u


def correct_end_by_softplus(
    scene: Scene, kernel: Kernel, u: np.ndarray, sharpness: float
) -> tuple[Rollout, np.ndarray]:
    """Correct the end through softplus contact of increasing sharpness, and then the true contact.

    The path of the true law has kinks where contacts begin or end; softplus has none.

    - u: (steps, nu) [N, N m], the initial inputs
    - sharpness: b L [-] of their softplus contact

    Raises KernelError if the mass matrix is not positive definite.
    """
    for b in np.geomspace(
        sharpness, _SHARPEST, 2 + int(np.log(_SHARPEST / sharpness) / np.log(_SHARPER))
    ):
        _, u = correct_end(
            scene,
            kernel,
            u,
            law=ContactLaw.SOFTPLUS,
            eps=float(np.exp(-b)),
            most=_EACH,
            enough=_ON_THE_WAY,
        )
    return correct_end(scene, kernel, u)


def _end_miss(rollout: Rollout, goal: np.ndarray) -> np.ndarray:
    return miss(np.concatenate([rollout.q[-1], rollout.v[-1]]), goal)


def _change(
    slopes: np.ndarray,
    missed: np.ndarray,
    u: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    damping: float,
) -> np.ndarray:
    """Return the damped step of the inputs (steps, nu), within their bounds."""
    free = np.ones(u.shape, dtype=bool)
    change = np.zeros(u.shape)
    for _ in range(2):
        matrix = (slopes * free).reshape(len(slopes), -1)
        gram = matrix @ matrix.T
        values, vectors = np.linalg.eigh(gram)
        shifted = values + damping * values[-1]
        along = np.where(
            shifted > 1e-14 * values[-1],
            vectors.T @ -missed / np.where(shifted > 0.0, shifted, 1.0),
            0.0,
        )
        change = (matrix.T @ (vectors @ along)).reshape(u.shape)
        free = ~(((u <= bounds[0]) & (change < 0.0)) | ((u >= bounds[1]) & (change > 0.0)))
    return change


def continue_to_goal(
    problem: ModesProblem, closed: np.ndarray, stride: int, is_over: Callable[[], bool]
) -> QuadraticAnswer | None:
    """Return the optimum of modes that meet the goal, from modes that miss it; None if not found.

    closed (steps, nc) [-] need not have a plan; stride is the first one of the searches [steps].
    Raises ValueError for modes of another shape.
    """
    linear = problem.linear
    try:
        problem.softness = 1.0
        answer = problem.solve(closed)
        if answer is None:
            return None
        problem.softness = (
            _FIRST
            * distance(answer.point.z[-1], linear.goal) ** 2
            / max(linear.cost(answer.point.z[:-1], answer.u), 1e-12)
        )
        for _ in range(_LEVELS):
            softness = problem.softness
            if not softness > 0.0:
                return None
            answer = problem.solve(closed)
            if answer is None:
                return None
            last = problem.solves + _TRIES
            search = search_sequences(
                answer,
                problem.solve,
                stride=stride,
                is_over=lambda last=last: is_over() or problem.solves > last,
            )
            closed, problem.softness = search.best.closed, 0.0
            answer = problem.solve(closed)
            if answer is not None or is_over():
                return answer
            problem.softness = softness * _FALL
        return None
    finally:
        problem.softness = 0.0

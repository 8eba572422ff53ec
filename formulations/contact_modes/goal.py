"""How the goal is met: inputs corrected until their rollout ends on it, and modes that miss it continued to modes that meet it.

    rollout, u = correct_end(scene, kernel, u)

What a solver's plan misses the goal by in its replay is taken out by steps on the true rollout.
Each step is the smallest change of the inputs that moves the end state where it should be, by the
adjoint of the time step (Levenberg and Marquardt: a Newton step where that works, as it does for a
miss of 1e-9; a shorter one, along which contacts may begin and end, from further off). Inputs on a
bound are not pushed across it.

    # closed: the modes of a rollout, whatever it ends at
    answer = continue_to_goal(problem, closed, stride, is_over)

The modes of a rollout always have a plan if the goal need not be met. Its cost is sum_t cost +
|z[T] - goal|^2 / (2 softness); mode sequences are searched for less of it, the softness falls,
until the modes found have a plan that meets the goal. Correcting one rollout stops where a contact
would have to begin or end; here that is a neighbour like any other, and the multipliers of touching
pairs say which.
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

_GOOD_ENOUGH = (
    1e-13  # relative to the size of the goal: what a rollout of some hundred steps rounds to
)
# steps tried; the plan of a solver needs one or two, a softplus plan with many contacts up to a
# hundred
_MOST = 150
# Damping after the first failure (part of the largest eigenvalue); its factor after failure and
# success.
_FIRST_DAMPING = 1e-4
_CALMER = 4.0
_BOLDER = 0.2
# damping below which it is none at all, and above which nothing is left to try
_LEAST = 1e-10
_LARGEST = 1e8

# By softplus: factor between two sharpnesses b L, the last (eps = exp(-b L) must be a number),
# steps tried at each, and the miss that is enough there.
_SHARPER = 1.25
_SHARPEST = 700.0
_EACH = 25
_ON_THE_WAY = 1e-7

_FIRST = 0.05  # the first miss is worth twenty times the cost of the inputs
_FALL = 0.02
_LEVELS = 4
_TRIES = 120  # modes tried at a level


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
    """Change inputs as little as needed for their rollout to end on the goal.

    Parameters
    ----------
    u : (steps, nu) [N, N m], inputs to begin with
    law, eps : contact law of the rollouts, and the eps of softplus [-]
    most : most steps tried
    enough : miss that counts as none, in parts of the goal's size [-]
    scale : (2*nq,) [m, rad, m/s, rad/s], by which each component of the miss is divided

    Returns
    -------
    The rollout and its inputs (steps, nu) [N, N m]. It ends nearer to the goal than that of u, or
        is that of u.

    Raises
    ------
    KernelError
        Where the mass matrix is not positive definite along the rollout.
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
    aimed = np.flatnonzero(~np.isnan(goal))  # a free component does not ask for anything
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
    """Do the same by way of softplus contact that grows sharper in small steps.

    A contact that begins or ends on the way bends the path of the true law, and a miss may be
    smallest at such a bend; softplus has none.

    Parameters
    ----------
    u : (steps, nu) [N, N m], inputs to begin with
    sharpness : b L [-], L the scene's length, at which u nearly ends where it should

    Returns
    -------
    The rollout through the true contact law and its inputs (steps, nu) [N, N m].

    Raises
    ------
    KernelError
        Where the mass matrix is not positive definite along the rollout.
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
    """The damped step of the inputs (steps, nu).

    Those on a bound that it would push outwards are left out of it.
    """
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
    """Find modes that meet the goal, from modes that miss it.

    Parameters
    ----------
    closed : (steps, nc) [-], modes that need not have a plan that meets the goal
    stride : first stride of the searches [steps]
    is_over : whether to stop

    Returns
    -------
    The optimum of the modes found, or None where none were found.

    Raises
    ------
    ValueError
        For modes of another shape.
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
            found = search_sequences(
                answer,
                problem.solve,
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

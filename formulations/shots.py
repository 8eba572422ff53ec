"""Motions through true contact that end on the goal, found by shooting alone.

    near = allowed_miss(scene)
    pushes = nearest_pushes(scene, kernel, near, seed=0, count=320)   # the nearest first
    shot = corrected(scene, kernel, pushes[0], near)
    shot, steps = cheaper(scene, kernel, shot, near, is_over)

A shot is the rollout of its own inputs. It solves the equations of its grid by construction, with
friction, damping and many contacts too, and costs milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from formulations.contact_modes.goal import correct_end
from formulations.contact_modes.starts import input_range
from formulations.grids import input_bounds
from models.codegen.kernel import Kernel, Rollout
from models.scene import Scene
from models.scene.goal import goal_state, miss

# Pushes are constant in so many pieces, and use this share of the bounds, in turn: what is cheap is
# rarely near its bounds.
_PIECES = (1, 2, 4, 8)
_SHARES = (1.0, 0.5, 0.25, 0.125)
# Most Newton steps of a correction, and of one after a step towards less cost, where the goal is
# near.
_CORRECTIONS = 40
_NEAR_CORRECTIONS = 10
# Steps towards less cost, until one gains less than this share of it.
_DESCENTS = 40
_GAIN = 1e-4
# A step that gains nothing is shortened by this factor, at most so often.
_SHORTER = 0.25
_SHORTENINGS = 5
# Share of what is allowed that a corrected motion may miss the goal by. Where a damped contact or
# friction begins, the end jumps with the inputs, and the goal may lie within a jump.
_ARRIVED = 0.1
# The same of a motion that ends on the goal.
_EXACT = 1e-7
# Relative change of the inputs that stands for rounding, and how far the motion may differ by it: a
# millionth of a nominal in each step, as the judge allows.
_ROUNDING = 1e-12
_DEFECT = 1e-6
# Shares of the inputs' range by which inputs are moved off an edge.
_OFF_EDGE = (1e-6, 1e-5, 1e-4, 1e-3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """Inputs u (steps, nu) [N, N m], their rollout, its cost, and its miss of the goal in units of what is allowed."""

    u: np.ndarray
    rollout: Rollout
    cost: float
    missed: float

    @property
    def has_arrived(self) -> bool:
        """Whether it ends near enough to the goal."""
        return self.missed <= _ARRIVED


def allowed_miss(scene: Scene) -> np.ndarray:
    """Return what is near enough of each component of the end, (2*nq,) [m, rad, m/s, rad/s].

    A component whose limit is waived is measured by its nominal.
    """
    sizes = []
    for part in ("position", "velocity"):
        limit = scene.limit(f"terminal_{part}_error")
        value = None if limit is None else limit.value
        sizes += [value or item.nominal for item in scene.coordinates]
    return np.array(sizes)


def nearest_pushes(
    scene: Scene, kernel: Kernel, near: np.ndarray, seed: int, count: int
) -> list[np.ndarray]:
    """Return random inputs with a finite motion, those that end nearest to the goal first.

    Parameters
    ----------
    near
        What is near enough of each component of the end, (2*nq,) [m, rad, m/s, rad/s].
    seed
        Of the inputs.
    count
        Inputs that are tried.

    Returns
    -------
    list of np.ndarray
        Inputs (steps, nu) [N, N m].

    Raises
    ------
    KernelError
        If the mass matrix is not positive definite along a motion.
    """
    random, steps = np.random.default_rng(seed), scene.task.steps
    (low, high), bounds = input_range(scene), input_bounds(scene)
    start = np.array(scene.task.start)
    found: list[tuple[float, int, np.ndarray]] = []
    for number in range(count):
        pieces = _PIECES[number % len(_PIECES)]
        share = _SHARES[number // len(_PIECES) % len(_SHARES)]
        levels = np.clip(share * random.uniform(low, high, (pieces, scene.nu)), *bounds)
        u = levels[np.arange(steps) * pieces // steps]
        rollout = kernel.rollout(start, u, scene.task.step)
        if not rollout.diverged:
            found.append((_missed(scene, rollout, near), number, u))
    return [u for *_, u in sorted(found, key=lambda item: item[:2])]


@np.errstate(over="ignore", invalid="ignore")
def corrected(
    scene: Scene, kernel: Kernel, u: np.ndarray, near: np.ndarray, most: int = _CORRECTIONS
) -> Shot:
    """Change inputs as little as needed for their motion to end on the goal, as far as it goes.

    Parameters
    ----------
    u
        Inputs (steps, nu) [N, N m].
    near
        What is near enough of each component of the end, (2*nq,) [m, rad, m/s, rad/s].
    most
        Newton steps.

    Returns
    -------
    Shot
        It ends nearer to the goal than the motion of u, or is that motion.

    Raises
    ------
    KernelError
        If the mass matrix is not positive definite along a motion.
    """
    rollout, u = correct_end(scene, kernel, u, scale=near, most=most)
    if rollout.diverged:
        return Shot(u=u, rollout=rollout, cost=np.inf, missed=np.inf)
    return Shot(
        u=u,
        rollout=rollout,
        cost=kernel.cost(rollout.q, rollout.v, u),
        missed=_missed(scene, rollout, near),
    )


def cheaper(
    scene: Scene, kernel: Kernel, shot: Shot, near: np.ndarray, is_over: Callable[[], bool]
) -> tuple[Shot, int]:
    """Descend in the cost along motions that end on the goal.

    Projected gradients, with the step lengths of Barzilai and Borwein; after each step the inputs
    are corrected again.

    Parameters
    ----------
    shot
        It has arrived.
    near
        What is near enough of each component of the end, (2*nq,) [m, rad, m/s, rad/s].
    is_over
        Whether to stop.

    Returns
    -------
    The last shot, and the number of steps.

    Raises
    ------
    KernelError
        If the mass matrix is not positive definite along a motion.
    """
    before: tuple[np.ndarray, np.ndarray] | None = None
    length = 0.0
    for number in range(_DESCENTS):
        if is_over():
            return shot, number
        slope = kernel.adjoint(shot.rollout, shot.u, cost_bar=1.0)[0]
        downhill = _projected(scene, kernel, shot, -slope)
        if before is None:
            # A cost that is quadratic in the inputs alone is least along u after this step.
            moved, turned = shot.u, slope
        else:
            moved, turned = shot.u - before[0], before[1] - downhill
        along = float((moved * turned).sum())
        length = float((moved * moved).sum()) / along if along > 0.0 else length
        before = shot.u, downhill
        found = _step(scene, kernel, shot, length * downhill, near)
        if found is None:
            return shot, number
        gained, shot = shot.cost - found.cost, found
        if gained <= _GAIN * abs(shot.cost):
            return shot, number + 1
    return shot, _DESCENTS


def off_the_edge(scene: Scene, kernel: Kernel, shot: Shot, near: np.ndarray) -> Shot | None:
    """Return a shot beside this one whose motion does not depend on rounding; the shot itself if it does not.

    Where a damped contact or friction begins, motions jump with the inputs, and optima lie at
    jumps: there the last digit decides which motion the inputs have.

    Parameters
    ----------
    shot
        It has arrived.
    near
        What is near enough of each component of the end, (2*nq,) [m, rad, m/s, rad/s].

    Returns
    -------
    Shot | None
        It has arrived; None if there is none.

    Raises
    ------
    KernelError
        If the mass matrix is not positive definite along a motion.
    """
    if is_motion(scene, kernel, shot.u, shot.rollout.q):
        return shot
    (low, high), random = input_range(scene), np.random.default_rng(0)
    for share in _OFF_EDGE:
        noise = random.uniform(-1.0, 1.0, shot.u.shape) * (high - low) / 2.0
        found = corrected(scene, kernel, shot.u + share * noise, near)
        if found.has_arrived and is_motion(scene, kernel, found.u, found.rollout.q):
            return found
    return None


@np.errstate(over="ignore", invalid="ignore")
def is_motion(scene: Scene, kernel: Kernel, u: np.ndarray, q: np.ndarray) -> bool:
    """Return whether inputs move the scene along these positions, whatever the rounding.

    Parameters
    ----------
    u
        Inputs (steps, nu) [N, N m].
    q
        Positions (steps + 1, nq) [m, rad].

    Raises
    ------
    KernelError
        If the mass matrix is not positive definite along a motion.
    """
    nominal = min(item.nominal for item in scene.coordinates)
    most, start = len(u) * _DEFECT * nominal, np.array(scene.task.start)
    for change in (0.0, _ROUNDING, -_ROUNDING):
        moved = kernel.rollout(start, u * (1.0 + change), scene.task.step)
        if moved.diverged or np.abs(moved.q - q).max() > most:
            return False
    return True


def _step(
    scene: Scene, kernel: Kernel, shot: Shot, step: np.ndarray, near: np.ndarray
) -> Shot | None:
    """The first shot along a step, ever shorter, that ends on the goal and costs less."""
    for _ in range(_SHORTENINGS if step.any() else 0):
        tried = corrected(scene, kernel, shot.u + step, near, _NEAR_CORRECTIONS)
        if tried.missed <= max(shot.missed, _EXACT) and tried.cost < shot.cost:
            return tried
        step = _SHORTER * step
    return None


def _projected(scene: Scene, kernel: Kernel, shot: Shot, direction: np.ndarray) -> np.ndarray:
    """The part of a direction (steps, nu) that neither moves the end nor leaves the bounds."""
    aimed = np.flatnonzero(~np.isnan(goal_state(scene.task)))
    slopes = np.stack(
        [
            kernel.adjoint(shot.rollout, shot.u, end_bar=end)[0]
            for end in np.eye(2 * scene.nq)[aimed]
        ]
    )
    lower, upper = input_bounds(scene)
    free, along = np.ones(shot.u.shape, dtype=bool), direction
    for _ in range(2):
        matrix, part = (slopes * free).reshape(len(slopes), -1), (direction * free).ravel()
        weights = np.linalg.lstsq(matrix @ matrix.T, matrix @ part, rcond=1e-12)[0]
        along = (part - matrix.T @ weights).reshape(shot.u.shape)
        free &= ~(((shot.u <= lower) & (along < 0.0)) | ((shot.u >= upper) & (along > 0.0)))
    return along * free


@np.errstate(over="ignore", invalid="ignore")
def _missed(scene: Scene, rollout: Rollout, near: np.ndarray) -> float:
    end = np.concatenate([rollout.q[-1], rollout.v[-1]])
    return float(np.linalg.norm(miss(end, goal_state(scene.task)) / near))

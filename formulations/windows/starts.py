"""Starts, the same on every machine: rollouts of seeded random inputs, a softplus shooting solution, a plan in the mirror of the scene."""

from __future__ import annotations

import numpy as np

from models.codegen.kernel import Kernel
from models.contact_law import ContactLaw
from models.goal import goal_state, miss
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid

_PIECES = 10  # of constant input over the horizon
_DESCENTS = 40  # L-BFGS iterations at each eps; the paper's plain gradient descent takes 15, 14 and 11
_COST_WEIGHT = 5e-6  # of the cost in the paper's loss
_DIVERGED = 1e30  # loss of a rollout that is not finite
_SAMPLES = 8  # positions at which a mirror is tried
_SHARE, _UNBOUNDED = 0.3, 1.0  # part of the bounds that is used [1], and what stands for a missing bound [N, N m]


def random_plan(scene: Scene, kernel: Kernel, seed: tuple[int, ...]) -> Trajectory | None:
    """Piecewise constant random inputs through softplus contact at eps = 1e-3; None where the rollout diverges."""
    random, task = np.random.default_rng(seed), scene.task
    lower, upper = input_range(scene)
    pieces = 0.5 * (lower + upper) + _SHARE * 0.5 * (upper - lower) * random.uniform(-1.0, 1.0, (_PIECES, scene.nu))
    u = pieces[np.arange(task.steps) * _PIECES // task.steps]
    rollout = kernel.rollout(np.array(task.start), u, task.step, ContactLaw.SOFTPLUS, 1e-3)
    if rollout.diverged:
        return None
    return Trajectory(
        t=uniform_grid(task.step, task.steps), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, scheme=Scheme.SEMI_IMPLICIT_EULER
    )


def input_range(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the inputs, (nu,) each [N, N m], with a number where one is missing."""
    far = _UNBOUNDED / _SHARE
    lower = np.array([-far if np.isinf(item.lower) else item.lower for item in scene.inputs])
    upper = np.array([far if np.isinf(item.upper) else item.upper for item in scene.inputs])
    return lower, upper


def descended_plan(scene: Scene, kernel: Kernel) -> Trajectory | None:
    """Shooting on softplus contact at eps = 1e-3, 1e-5, 1e-7, each from the inputs before, with the loss of the paper's gradient descent
    (mean square miss of the goal + 5e-6 cost) and L-BFGS in its place; None where a rollout diverges."""
    from scipy.optimize import minimize

    task, goal = scene.task, goal_state(scene.task)
    shape = (task.steps, scene.nu)
    bounds = [(item.lower, item.upper) for item in scene.inputs] * task.steps

    def loss(flat: np.ndarray, eps: float) -> tuple[float, np.ndarray]:
        u = flat.reshape(shape)
        rollout = kernel.rollout(np.array(task.start), u, task.step, ContactLaw.SOFTPLUS, eps)
        if rollout.diverged:
            return _DIVERGED, np.zeros_like(flat)
        missed = miss(np.concatenate([rollout.q[-1], rollout.v[-1]]), goal)
        q_bar, v_bar = np.zeros_like(rollout.q), np.zeros_like(rollout.v)
        q_bar[-1], v_bar[-1] = np.split(2.0 * missed / len(goal), 2)
        u_bar, _ = kernel.adjoint(rollout, u, q_bar, v_bar, cost_bar=_COST_WEIGHT)
        return float(np.mean(missed**2)) + _COST_WEIGHT * kernel.cost(rollout.q, rollout.v, u), u_bar.ravel()

    flat = np.clip(np.zeros(shape), *(np.array([getattr(item, side) for item in scene.inputs]) for side in ("lower", "upper"))).ravel()
    for eps in (1e-3, 1e-5, 1e-7):
        flat = minimize(loss, flat, args=(eps,), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _DESCENTS}).x
    u = flat.reshape(shape)
    rollout = kernel.rollout(np.array(task.start), u, task.step, ContactLaw.SOFTPLUS, 1e-7)
    if rollout.diverged:
        return None
    return Trajectory(
        t=uniform_grid(task.step, task.steps), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, scheme=Scheme.SEMI_IMPLICIT_EULER
    )


def mirrored(scene: Scene, kernel: Kernel, plan: Trajectory) -> Trajectory | None:
    """The plan run backwards and seen in a mirror: q'(t) = c - q(T - t) with the coordinates in reverse order, and c such that the start
    becomes the goal. Three carts pushed from left to right are then again pushed from left to right, first contact last. Without damping
    that is a plan too, with it a start. None where the contacts of the scene are not the same ones in the mirror."""
    start, goal = np.array(scene.task.start), goal_state(scene.task)
    centre = start[: scene.nq] + goal[: scene.nq][::-1]
    if not np.all(np.isfinite(centre)) or not scene.nc:
        return None
    random = np.random.default_rng(0)
    q = start[: scene.nq] + random.normal(size=(_SAMPLES, scene.nq))
    here, there = kernel.penetration(q), kernel.penetration(centre - q[:, ::-1])
    same = np.isclose(here[:, :, None], there[:, None, :], rtol=1e-9, atol=1e-9).all(axis=0)  # [i, j]: contact j mirrored is contact i
    if not (np.all(same.sum(axis=0) == 1) and np.all(same.sum(axis=1) == 1)):
        return None
    lam = np.zeros_like(plan.lam)
    lam[:, : scene.nc] = plan.lam[::-1, : scene.nc][:, same.argmax(axis=1)]
    return Trajectory(
        t=plan.t,
        q=centre - plan.q[::-1, ::-1],
        v=plan.v[::-1, ::-1].copy(),
        u=-plan.u[::-1, ::-1],
        lam=lam,
        scheme=Scheme.SEMI_IMPLICIT_EULER,
    )

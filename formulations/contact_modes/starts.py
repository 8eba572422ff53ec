"""Motions to start from, the same on every machine: seeded random inputs, a softplus shooting solution, the mirror of a plan, throws by constant inputs."""

from __future__ import annotations

import numpy as np

from formulations.grids import input_bounds, plan_of, rolled_plan
from models.codegen.kernel import Kernel, Rollout
from models.contact_law import ContactLaw
from models.scene import Scene
from models.scene.goal import goal_state, miss
from models.schemes import Scheme
from models.trajectory import Trajectory

_PIECES = 10  # of constant input over the horizon
_DESCENTS = (
    40  # L-BFGS iterations at each eps; the paper's plain gradient descent takes 15, 14 and 11
)
_COST_WEIGHT = 5e-6  # of the cost in the paper's loss
_DIVERGED = 1e30  # loss of a rollout that is not finite
_MIRROR_SAMPLES = 8  # positions at which a mirror is tried
# part of the bounds that is used [1], and what stands for a missing bound [N, N m]
_SHARE = 0.3
_UNBOUNDED = 1.0
# constant inputs tried: of two discs and a wall about 35 of them bring the disc nearer to its goal,
# in 0.1 CPU s
_THROWS = 2048
# powers of two by which they are made smaller, in turn: what is cheap is rarely near its bounds
_SIZES = 4


def random_plan(scene: Scene, kernel: Kernel, seed: tuple[int, ...]) -> Trajectory | None:
    """Draw piecewise constant inputs, and roll them out through softplus contact at eps = 1e-3.

    None where the rollout diverges.
    """
    random, task = np.random.default_rng(seed), scene.task
    lower, upper = input_range(scene)
    pieces = 0.5 * (lower + upper) + _SHARE * 0.5 * (upper - lower) * random.uniform(
        -1.0, 1.0, (_PIECES, scene.nu)
    )
    u = pieces[np.arange(task.steps) * _PIECES // task.steps]
    return rolled_plan(scene, kernel, u, ContactLaw.SOFTPLUS, 1e-3)


def input_range(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Give the bounds of the inputs, (nu,) each [N, N m], with a number where one is missing."""
    far = _UNBOUNDED / _SHARE
    lower, upper = input_bounds(scene)
    return np.where(np.isinf(lower), -far, lower), np.where(np.isinf(upper), far, upper)


def descended_plan(scene: Scene, kernel: Kernel) -> Trajectory | None:
    """Shoot on softplus contact at eps = 1e-3, 1e-5, 1e-7, each from the inputs before.

    None where a rollout diverges.

    The loss is that of the paper's gradient descent (mean square miss of the goal + 5e-6 cost),
    with L-BFGS in its place.
    """
    from scipy.optimize import minimize  # 0.2 s, which only a run of several starts needs

    task, goal = scene.task, goal_state(scene.task)
    shape = (task.steps, scene.nu)
    bounds = [(item.lower, item.upper) for item in scene.inputs] * task.steps

    def loss(flat: np.ndarray, eps: float) -> tuple[float, np.ndarray]:
        """Give the loss and its gradient (steps*nu,) [1/N, 1/N/m] at inputs (steps*nu,) [N, N m].

        Raises KernelError where the mass matrix is not positive definite.
        """
        u = flat.reshape(shape)
        rollout = kernel.rollout(np.array(task.start), u, task.step, ContactLaw.SOFTPLUS, eps)
        if rollout.diverged:
            return _DIVERGED, np.zeros_like(flat)
        missed = miss(np.concatenate([rollout.q[-1], rollout.v[-1]]), goal)
        q_bar, v_bar = np.zeros_like(rollout.q), np.zeros_like(rollout.v)
        q_bar[-1], v_bar[-1] = np.split(2.0 * missed / len(goal), 2)
        u_bar, _ = kernel.adjoint(rollout, u, q_bar, v_bar, cost_bar=_COST_WEIGHT)
        return float(np.mean(missed**2)) + _COST_WEIGHT * kernel.cost(
            rollout.q, rollout.v, u
        ), u_bar.ravel()

    flat = np.clip(np.zeros(shape), *input_bounds(scene)).ravel()
    for eps in (1e-3, 1e-5, 1e-7):
        flat = minimize(
            loss,
            flat,
            args=(eps,),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": _DESCENTS},
        ).x
    return rolled_plan(scene, kernel, flat.reshape(shape), ContactLaw.SOFTPLUS, 1e-7)


def mirrored(scene: Scene, kernel: Kernel, plan: Trajectory) -> Trajectory | None:
    """Run the plan backwards and see it in a mirror.

    None where the contacts of the scene are not the same ones there.

    q'(t) = c - q(T - t) with the coordinates in reverse order, and c such that the start becomes
    the goal. Three carts pushed from left to right are then again pushed from left to right, first
    contact last. Without damping that is a plan too, with it a start.
    """
    start, goal = np.array(scene.task.start), goal_state(scene.task)
    centre = start[: scene.nq] + goal[: scene.nq][::-1]
    if not np.all(np.isfinite(centre)) or not scene.nc:
        return None
    random = np.random.default_rng(0)
    q = start[: scene.nq] + random.normal(size=(_MIRROR_SAMPLES, scene.nq))
    here, there = kernel.penetration(q), kernel.penetration(centre - q[:, ::-1])
    same = np.isclose(here[:, :, None], there[:, None, :], rtol=1e-9, atol=1e-9).all(
        axis=0
    )  # [i, j]: contact j mirrored is contact i
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


def thrown_plans(
    scene: Scene, kernel: Kernel, seed: tuple[int, ...], idle: np.ndarray, below: float
) -> list[Trajectory]:
    """Give motions under constant inputs that bring a new contact about and end at less final cost, the cheapest first.

    The inputs are a seeded lattice (Kronecker's: steps of 1/g, 1/g^2, .. with g^(nu+1) = g + 1)
    over their bounds, a half, a quarter and an eighth of them.

    Parameters
    ----------
    idle : (nc,) [-], contacts that are pressed anyway
    below : final cost that they have to end below

    Raises
    ------
    ValueError
        For another number of contacts.
    """
    task, (lower, upper) = scene.task, input_range(scene)
    roots = np.roots([1.0, *[0.0] * (scene.nu - 1), -1.0, -1.0])
    ratio = float(roots[np.isreal(roots)].real.max())
    count = np.arange(_THROWS)[:, None]
    places = (
        np.random.default_rng(seed).uniform(size=scene.nu)
        + count * ratio ** -np.arange(1.0, scene.nu + 1)
    ) % 1.0
    found: list[tuple[float, Trajectory]] = []
    for force in np.clip(
        0.5 ** (count % _SIZES) * (lower + places * (upper - lower)), lower, upper
    ):
        u = np.tile(force, (task.steps, 1))
        rollout = kernel.rollout(np.array(task.start), u, task.step)
        pressed = (rollout.lam[:, : scene.nc] > 0.0).any(axis=0)
        if (
            rollout.diverged
            or not (pressed & ~idle).any()
            or not final_cost(kernel, rollout) < below
        ):
            continue
        plan = plan_of(scene, rollout, u)
        found.append((kernel.cost(rollout.q, rollout.v, u), plan))
    return [plan for _, plan in sorted(found, key=lambda pair: pair[0])]


def final_cost(kernel: Kernel, rollout: Rollout) -> float:
    """Give the cost of the last state alone."""
    return kernel.cost(rollout.q[-1:], rollout.v[-1:], np.zeros((0, kernel.scene.nu)))

"""Deterministic start motions: random, softplus shooting, mirrored plans, constant inputs."""

from __future__ import annotations

import numpy as np

from formulations.grids import input_bounds, plan_of, rolled_plan
from models.codegen.kernel import Kernel, Rollout
from models.contact_law import ContactLaw
from models.scene import Scene
from models.scene.goal import goal_state, miss
from models.schemes import Scheme
from models.trajectory import Trajectory

# Pieces of constant input over the horizon.
_PIECES = 10
# L-BFGS iterations at each eps; the paper's gradient descent takes 15, 14 and 11.
_DESCENTS = 40
# Weight of the cost in the paper's loss.
_COST_WEIGHT = 5e-6
# Loss of a rollout that is not finite.
_DIVERGED = 1e30
# Positions that test a mirror symmetry.
_MIRROR_SAMPLES = 8
# Used share of the input bounds.
_SHARE = 0.3
# Replaces a missing bound [N, N m].
_UNBOUNDED = 1.0
# Constant inputs tried; with two discs and a wall about 35 of these move the disc closer to its
# goal, in 0.1 CPU s.
_THROWS = 2048
# Powers of two that scale the inputs down in turn: cheap inputs are rarely near their bounds.
_SIZES = 4


def random_plan(scene: Scene, kernel: Kernel, seed: tuple[int, ...]) -> Trajectory | None:
    """Roll out random piecewise constant inputs through softplus contact at eps = 1e-3.

    None if the rollout diverges.
    """
    random, task = np.random.default_rng(seed), scene.task
    lower, upper = input_range(scene)
    pieces = 0.5 * (lower + upper) + _SHARE * 0.5 * (upper - lower) * random.uniform(
        -1.0, 1.0, (_PIECES, scene.nu)
    )
    u = pieces[np.arange(task.steps) * _PIECES // task.steps]
    return rolled_plan(scene, kernel, u, ContactLaw.SOFTPLUS, 1e-3)


def input_range(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the input bounds (nu,), (nu,) [N, N m], finite for missing ones. Raises nothing."""
    far = _UNBOUNDED / _SHARE
    lower, upper = input_bounds(scene)
    return np.where(np.isinf(lower), -far, lower), np.where(np.isinf(upper), far, upper)


def descended_plan(scene: Scene, kernel: Kernel) -> Trajectory | None:
    """Shoot on softplus contact at eps = 1e-3, 1e-5, 1e-7; None if a rollout diverges.

    The loss is the paper's (mean square error of the goal + 5e-6 cost), minimised by L-BFGS.
    """
    from scipy.optimize import minimize  # 0.2 s, used only with several starts

    task, goal = scene.task, goal_state(scene.task)
    shape = (task.steps, scene.nu)
    bounds = [(item.lower, item.upper) for item in scene.inputs] * task.steps

    def loss(flat: np.ndarray, eps: float) -> tuple[float, np.ndarray]:
        """Return loss and gradient (steps*nu,) [1/N, 1/N/m] at inputs (steps*nu,) [N, N m].

        Raises KernelError if the mass matrix is not positive definite.
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
    """Mirror a plan in time and space; None if the mirrored contacts differ.

    q'(t) = c - q(T - t) with reversed coordinates, and c such that the start becomes the goal.
    Without damping the result is a plan, otherwise a start.
    """
    start, goal = np.array(scene.task.start), goal_state(scene.task)
    centre = start[: scene.nq] + goal[: scene.nq][::-1]
    if not np.all(np.isfinite(centre)) or not scene.nc:
        return None
    random = np.random.default_rng(0)
    q = start[: scene.nq] + random.normal(size=(_MIRROR_SAMPLES, scene.nq))
    original, mirror = kernel.penetration(q), kernel.penetration(centre - q[:, ::-1])
    # same[i, j]: contact j mirrored is contact i.
    same = np.isclose(original[:, :, None], mirror[:, None, :], rtol=1e-9, atol=1e-9).all(axis=0)
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
    """Return constant-input motions that press a new contact and end below a final cost.

    The cheapest is first. The inputs are a seeded Kronecker lattice (steps 1/g, 1/g^2, .. with
    g^(nu+1) = g + 1). The lattice covers the bounds, and a half, a quarter and an eighth of them.
    idle (nc,) [-]: contacts that are pressed without inputs. Raises ValueError for a wrong number
    of contacts.
    """
    task, (lower, upper) = scene.task, input_range(scene)
    roots = np.roots([1.0, *[0.0] * (scene.nu - 1), -1.0, -1.0])
    ratio = float(roots[np.isreal(roots)].real.max())
    count = np.arange(_THROWS)[:, None]
    places = (
        np.random.default_rng(seed).uniform(size=scene.nu)
        + count * ratio ** -np.arange(1.0, scene.nu + 1)
    ) % 1.0
    motions: list[tuple[float, Trajectory]] = []
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
        motions.append((kernel.cost(rollout.q, rollout.v, u), plan))
    return [plan for _, plan in sorted(motions, key=lambda pair: pair[0])]


def final_cost(kernel: Kernel, rollout: Rollout) -> float:
    """Return the cost of the last state."""
    return kernel.cost(rollout.q[-1:], rollout.v[-1:], np.zeros((0, kernel.scene.nu)))

"""The scene that is measured: carts in a row (models.scenes.cart_chain) at any size, as a Scene for us and as plain numbers for peers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.measure import Size

if TYPE_CHECKING:
    from models.scene import Scene
    from models.trajectory import Trajectory

# The relaxation's schedule: three eps, one after the other, each from the plan of the one before.
SOFTPLUS_EPS = (1e-3, 1e-5, 1e-7)
# The loss of gradient descent: mean((x_T - goal)^2) + INPUT_WEIGHT sum u^2.
INPUT_WEIGHT = 5e-6


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """n carts of `length` [m], mass [kg], damping [N s/m], contact stiffness [N/m], |u| <= limit [N] on the outer two; start, goal (2n,);
    T = steps of h = step [s].
    """

    n: int
    steps: int
    step: float
    mass: float
    damping: float
    stiffness: float
    length: float
    limit: float
    start: np.ndarray
    goal: np.ndarray


def scene_of(size: Size) -> Scene:
    """Five seconds in T steps.

    Beyond ten carts n/2 seconds, because twenty cannot be pushed to rest in five.
    """
    from models.scenes.cart_chain import cart_chain

    return cart_chain(size.n).with_task(steps=size.steps, step=max(5.0, size.n / 2) / size.steps)


def numbers_of(size: Size) -> Numbers:
    """What `scene_of` is made of."""
    scene = scene_of(size)
    values = {str(parameter.symbol): parameter.value for parameter in scene.parameters}
    upper = scene.inputs[0].upper
    if upper is None or scene.task.goal is None or None in scene.task.goal:
        raise ValueError(f"{scene.name}: peers need bounds and a whole goal")
    return Numbers(
        n=size.n,
        steps=size.steps,
        step=scene.task.step,
        mass=values["m"],
        damping=values["c"],
        stiffness=values["k"],
        length=values["d"],
        limit=upper,
        start=np.array(scene.task.start),
        goal=np.array(scene.task.goal, dtype=float),
    )


def push(steps: int) -> np.ndarray:
    """u (steps, 2) [N]: both ends driven inwards by a sine, so that contacts close and open at any T."""
    force = 8.0 * np.sin(np.linspace(0.0, 2 * np.pi, steps, endpoint=False))
    return np.stack([force, -force], axis=1)


def pushed_plan(size: Size) -> Trajectory:
    """The motion under `push`, by the scene's own time step."""
    from models.codegen.kernel import load_kernel
    from models.schemes import Scheme
    from models.trajectory import Trajectory, uniform_grid

    scene, u = scene_of(size), push(size.steps)
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, scene.task.step)
    return Trajectory(
        t=uniform_grid(scene.task.step, size.steps),
        q=rollout.q,
        v=rollout.v,
        u=u,
        lam=rollout.lam,
        scheme=Scheme.SEMI_IMPLICIT_EULER,
    )

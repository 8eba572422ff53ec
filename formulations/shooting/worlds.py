"""Inputs for several worlds at once: L-BFGS on the true contact law, whose loss counts how far the same inputs end from the goal where numbers are otherwise.

    loss = cost + weight * C * mean over worlds of (sqrt(1 + m) - 1)  +
        the goal of the scene itself, met by multipliers
    m    = |position error|^2 / limit^2 + |velocity error|^2 / limit^2, at the end of a world; C:
         what the first inputs cost, in size

A world that misses by far counts by its distance, not by its square: it is lost, and the plan is
not bent for it. On `transport`, whose friction no inputs undo, the square leaves feedback 67 % of
the worlds instead of 89 % (weight 3). Parameters, gains of the inputs, the start, noise and a delay
are otherwise by up to the sizes of models.scene.uncertainty, all at once. A delay of a part of a
step is what it does to the mean over each step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from formulations.grids import input_bounds, scene_of
from formulations.method import Clock, Method
from formulations.shooting.objective import Objective, Weights
from formulations.shooting.options import RobustOptions
from formulations.shooting.rollout import rollout
from formulations.shooting.session import ShootingSession
from formulations.solution import Solution
from models.codegen.kernel import Kernel
from models.contact_law import ContactLaw
from models.scene import Scene
from models.scene.goal import goal_state
from models.scene.uncertainty import DELAY, GAIN, NOISE, START, size_of
from models.trajectory import Trajectory

# What a mean square of a miss of the goal itself weighs, in squares of its smaller limit and in C,
# before multipliers meet it.
_NOMINAL = 120.0


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnWorld:
    """A world to plan for: kernel of its parameters; start (2*nq,).

    Gain (nu,) [-], noise (steps, nu) [N, N m] and delay [steps] of the inputs.
    """

    kernel: Kernel
    start: Tensor
    gain: Tensor
    noise: Tensor
    delay: float

    def end(self, u: Tensor) -> Tensor:
        """Last state (2*nq,) by inputs u (steps, nu) [N, N m].

        Raises ShootingError for a tensor of another shape or type.
        """
        late = torch.cat([u[:1], u[:-1]])
        driven = ((1.0 - self.delay) * u + self.delay * late) * self.gain + self.noise
        return rollout(self.kernel, driven, self.start).end


def drawn(kernel: Kernel, u: np.ndarray, samples: int, seed: int) -> list[DrawnWorld]:
    """Worlds spread evenly over what may be otherwise: a scrambled Sobol sequence. u (steps, nu) [N, N m]: how large inputs without bounds are. Raises ValueError for a negative seed."""
    from scipy.stats import qmc  # half a second, which other methods need not pay

    scene = kernel.scene
    parts = [len(scene.parameters), scene.nu, 2 * scene.nq, 1]
    points = (
        2.0
        * qmc.Sobol(sum(parts), seed=seed).random_base2(int(np.ceil(np.log2(samples))))[:samples]
        - 1.0
    )
    lower, upper = input_bounds(scene)
    width = np.where(
        np.isfinite(upper - lower), upper - lower, 2.0 * np.abs(u).max(axis=0, initial=0.0)
    )
    away = START * np.tile([item.nominal for item in scene.coordinates], 2)
    noise = NOISE * width * np.random.default_rng(seed).standard_normal((samples, *u.shape))
    worlds = []
    for number, point in enumerate(points):
        values, gains, starts, delay = np.split(point, np.cumsum(parts)[:-1])
        moved = {
            item.name: item.value + size_of(item.value, item.uncertainty) * float(by)
            for item, by in zip(scene.parameters, values, strict=True)
        }
        worlds.append(
            DrawnWorld(
                kernel=Kernel(scene.with_parameters(**moved), kernel.path),
                start=torch.from_numpy(np.array(scene.task.start) + away * starts),
                gain=torch.from_numpy(1.0 + GAIN * gains),
                noise=torch.from_numpy(noise[number]),
                delay=DELAY * (1.0 + delay.item()) / 2.0,
            )
        )
    return worlds


class WorldsObjective(Objective):
    """The loss of the module docstring. u (steps, nu) [N, N m]: the first inputs."""

    def __init__(self, kernel: Kernel, u: np.ndarray, options: RobustOptions) -> None:
        scene = kernel.scene
        goal, limits = (
            goal_state(scene.task),
            [scene.limit(f"replay_terminal_{name}_error") for name in ("position", "velocity")],
        )
        scale = np.repeat(
            [1.0 / limit.value if limit and limit.value else 0.0 for limit in limits], scene.nq
        )
        self._goal, self._shares = (
            torch.from_numpy(np.nan_to_num(goal)),
            torch.from_numpy(np.where(np.isnan(goal), 0.0, scale)),
        )
        self._worlds = drawn(kernel, u, options.worlds, options.seed)
        motion = kernel.rollout(np.array(scene.task.start), u, scene.task.step)
        price = abs(kernel.cost(motion.q, motion.v, u)) or 1.0
        self._price = options.weight * price
        super().__init__(
            kernel,
            law=ContactLaw.RELU,
            weights=Weights(terminal=_NOMINAL * price * float(scale.max()) ** 2, running=1.0),
        )

    def __call__(self, u: Tensor) -> Tensor:
        """Return the loss at inputs u (steps, nu), over all worlds."""
        ends = torch.stack([world.end(u) for world in self._worlds])
        squares = ((ends - self._goal) * self._shares).square().sum(-1)
        return super().__call__(u) + self._price * (torch.sqrt(1.0 + squares) - 1.0).mean()


class WorldsSession(ShootingSession):
    """A session whose worlds are drawn when it is solved: how large inputs without bounds are, the first ones say."""

    def __init__(self, method: Method, scene: Scene, options: RobustOptions, clock: Clock) -> None:
        def objective(kernel: Kernel, _: float | None, u0: np.ndarray) -> Objective:
            return WorldsObjective(kernel, u0, options)

        super().__init__(method, scene, options, clock, objective)

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Descend from the inputs of the warm start, on its own steps where those are finer.

        Raises TrajectoryError for a plan of another scene or grid.
        """
        scene = self._scene if warm_start is None else scene_of(self._scene, warm_start)
        if scene is self._scene:
            return super().solve(eps=eps, warm_start=warm_start, time_limit=time_limit)
        with self._method.open(scene, self._options) as finer:
            return finer.solve(eps=eps, warm_start=warm_start, time_limit=time_limit)

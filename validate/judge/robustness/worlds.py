"""The worlds a plan is tried in: what may be otherwise than the scene says, by how much, and samples of it.

    causes = perturbations(scene, plan)                  # parameters, start, gains of the inputs, noise, delay
    worlds = sample(causes, plan, samples=1000, seed=0)
    WorldInputs(plan, worlds[0], feedback=None)          # what the inputs of the plan become there

Sizes are those of docs/robustness.md: a parameter's own uncertainty, else a twentieth of its value; the start by a hundredth of nominal; each
input's gain by a fiftieth; noise of a hundredth of an input's range, new in every step; a delay of up to a step. A world is told in these sizes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from models.scene import Scene
from models.scene.uncertainty import DELAY, GAIN, NOISE, PARAMETER, START, size_of
from models.trajectory import Trajectory
from validate.judge.replay.tracking import input_scale, nominals
from validate.judge.replay.wiring import Feedback, HeldInputs

# Breaks of the inputs that are nearer to one another than this share of a step are one.
_SAME = 1e-9


class PerturbationKind(Enum):
    """What is perturbed."""

    PARAMETERS = "parameters"
    START = "start"
    GAIN = "gain"
    NOISE = "noise"
    DELAY = "delay"


@dataclass(frozen=True, kw_only=True)
class Perturbation:
    """One number of a world that may be otherwise.

    index: its place among those of its kind; nominal, size: its value in the scene and how far it may be from that [unit]; below, above: how many
    sizes it may be moved down and up at most.
    """

    kind: PerturbationKind
    name: str
    index: int
    nominal: float
    size: float
    unit: str
    reason: str
    below: float = math.inf
    above: float = math.inf


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A perturbed world: parameters (np,) and start (2*nq,) [units of the scene], gain (nu,) [-], noise (steps, nu) [unit of each input], delay [s]."""

    parameters: np.ndarray
    start: np.ndarray
    gain: np.ndarray
    noise: np.ndarray
    delay: float = 0.0


def perturbations(scene: Scene, plan: Trajectory, kinds: Sequence[PerturbationKind] = tuple(PerturbationKind)) -> tuple[Perturbation, ...]:
    """What may be otherwise in the worlds of a plan; what has no size (a parameter of value 0 without a stated uncertainty) is left out."""
    found = []
    for index, item in enumerate(scene.parameters):
        stated = item.uncertainty is not None
        size = size_of(item)
        if size > 0.0:
            found.append(
                Perturbation(
                    kind=PerturbationKind.PARAMETERS, name=item.name, index=index, nominal=item.value, size=size, unit=item.unit,
                    reason=item.uncertainty_reason if stated else f"{PARAMETER:.0%} of its value",
                    below=(item.value - item.lower) / size, above=(item.upper - item.value) / size,
                )
            )  # fmt: skip
    names = [(item.name, item.unit) for item in scene.coordinates] + [(item.velocity_name, f"{item.unit}/s") for item in scene.coordinates]
    for index, ((name, unit), size) in enumerate(zip(names, START * nominals(scene), strict=True)):
        found.append(
            Perturbation(
                kind=PerturbationKind.START, name=f"start of {name}", index=index, nominal=float(plan.start[index]), size=float(size), unit=unit,
                reason=f"{START:.0%} of nominal",
            )
        )  # fmt: skip
    for index, item in enumerate(scene.inputs):
        found.append(
            Perturbation(
                kind=PerturbationKind.GAIN, name=f"gain of {item.name}", index=index, nominal=1.0, size=GAIN, unit="1", reason=f"{GAIN:.0%}", below=1 / GAIN
            )
        )  # fmt: skip
    ranges = 2.0 * _half_ranges(scene, plan)
    for index, item in enumerate(scene.inputs):
        found.append(
            Perturbation(
                kind=PerturbationKind.NOISE, name=f"noise of {item.name}", index=index, nominal=0.0, size=NOISE * float(ranges[index]), unit=item.unit,
                reason=f"{NOISE:.0%} of its range as standard deviation, new in every step", below=0.0,
            )
        )  # fmt: skip
    step = plan.duration / plan.steps
    if scene.nu:
        found.append(
            Perturbation(
                kind=PerturbationKind.DELAY, name="delay", index=0, nominal=0.0, size=DELAY * step, unit="s", reason="a step", below=0.0
            )
        )
    return tuple(item for item in found if item.kind in kinds)


def _half_ranges(scene: Scene, plan: Trajectory) -> np.ndarray:
    lower, upper = np.array([item.lower for item in scene.inputs]), np.array([item.upper for item in scene.inputs])
    return input_scale(lower, upper, plan.u) if scene.nu else np.zeros(0)


def nominal_world(scene: Scene, plan: Trajectory) -> World:
    """The world as the scene says it is."""
    return World(
        parameters=np.array([item.value for item in scene.parameters]),
        start=np.array(plan.start, dtype=float),
        gain=np.ones(scene.nu),
        noise=np.zeros((plan.steps, scene.nu)),
    )


def moved(world: World, causes: Sequence[Perturbation], sizes: np.ndarray, noise: np.ndarray | None = None) -> World:
    """Another world.

    Parameters
    ----------
    sizes : (causes,) by how many sizes each is moved; kept within what it may be moved by
    noise : (steps, nu) [-] of standard deviation 1; None: without

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    parameters, start, gain = world.parameters.copy(), world.start.copy(), world.gain.copy()
    added, delay = world.noise.copy(), world.delay
    into = {PerturbationKind.PARAMETERS: parameters, PerturbationKind.START: start, PerturbationKind.GAIN: gain}
    for cause, size in zip(causes, np.asarray(sizes, dtype=float), strict=True):
        change = cause.size * float(np.clip(size, -cause.below, cause.above))
        if cause.kind is PerturbationKind.DELAY:
            delay += change
        elif cause.kind is PerturbationKind.NOISE:
            added[:, cause.index] += 0.0 if noise is None else change * noise[:, cause.index]
        else:
            into[cause.kind][cause.index] += change
    return replace(world, parameters=parameters, start=start, gain=gain, noise=added, delay=delay)


@dataclass(frozen=True, kw_only=True, eq=False)
class Draw:
    """Sampled worlds in sizes: points (samples, causes), each in [-1, 1], of noise and delay in [0, 1]; seed: of the noise of each."""

    causes: tuple[Perturbation, ...]
    points: np.ndarray
    seed: int

    def world(self, number: int, nominal: World, scale: float = 1.0) -> World:
        """One of the worlds, all its sizes times `scale`; its noise is the same at every scale. Raises IndexError."""
        noise = np.random.default_rng([self.seed, number]).standard_normal(nominal.noise.shape)
        return moved(nominal, self.causes, scale * self.points[number], noise)


def draw(causes: Sequence[Perturbation], samples: int, seed: int) -> Draw:
    """Worlds spread evenly: a scrambled Sobol sequence over all causes but noise, whose size is always its own.

    Raises
    ------
    ValueError : for no cause, or more than Sobol's sequence has numbers for.
    """
    # Half a second, which a replay need not pay.
    from scipy.stats import qmc

    spread = [item for item in causes if item.kind is not PerturbationKind.NOISE]
    points = np.ones((samples, len(causes)))
    if spread:
        numbers = qmc.Sobol(len(spread), seed=seed).random_base2(max(0, math.ceil(math.log2(samples))))[:samples]
        both = np.array([item.below > 0.0 for item in spread])
        points[:, [item.kind is not PerturbationKind.NOISE for item in causes]] = np.where(both, 2.0 * numbers - 1.0, numbers)
    return Draw(causes=tuple(causes), points=points, seed=seed)


class WorldInputs(HeldInputs):
    """What a plan's inputs become in a world: later, by another gain, with noise; with feedback, its commands do.

    A command given at a node arrives `delay` later; until the first arrives it is that of the start. rows (nodes,): where the plan's nodes are among the times.
    """

    def __init__(self, plan: Trajectory, world: World, feedback: Feedback | None = None) -> None:
        """Raises ValueError if the shapes of plan, world and feedback do not fit."""
        super().__init__(plan, feedback)
        self._commands, self._world = HeldInputs(plan, feedback), world
        arrivals, shortest = plan.t[:-1] + world.delay, _SAME * float(np.diff(plan.t).min())
        between = arrivals[(arrivals < plan.t[-1] - shortest) & (_to_nearest(arrivals, plan.t) > shortest)]
        self.times = np.union1d(plan.t, between)
        self.rows = np.searchsorted(self.times, plan.t)
        begins = self.times[:-1]
        # Of each step of these times: the plan's step in which it lies, that whose command is in force, and since when it is [s].
        self._lies_in = np.searchsorted(plan.t, begins + shortest, side="right") - 1
        self._command = np.maximum(np.searchsorted(arrivals, begins + shortest, side="right") - 1, 0)
        self._since = np.maximum(begins - arrivals[self._command], 0.0)
        arrived = begins + shortest >= arrivals[self._command]
        self.slopes = np.where(arrived[:, None], self._commands.slopes[self._command], 0.0) * world.gain
        self.linear = bool(self.slopes.any())
        self._added = self._since[:, None] * self._commands.slopes[self._command] * world.gain + world.noise[self._lies_in]
        self.values = self._commands.values[self._command] * world.gain + self._added
        self.breaks, self._stops = np.full(len(begins), True), list(range(1, len(self.times)))

    @property
    def commands(self) -> np.ndarray:
        """(steps, nu) what is commanded at the plan's nodes [unit of each input]: what an actuator makes of it, and when, is the world's. Raises nothing."""
        return self._commands.values

    def begin(self, step: int, state: np.ndarray | None) -> np.ndarray:
        """The input at the start of a step of these times: at a node a command is given, from its arrival on it is in force (`HeldInputs.begin`): (nu,) [unit of each], state (2*nq,). Raises nothing."""
        if self.feedback is not None:
            node = int(self._lies_in[step])
            if self.rows[node] == step:
                self._commands.begin(node, self._world.start if state is None else state)
            self.values[step] = self._commands.values[self._command[step]] * self._world.gain + self._added[step]
        return self.values[step]


def _to_nearest(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(n,) distance of each point from the nearest node [s]."""
    after = np.clip(np.searchsorted(nodes, points), 1, len(nodes) - 1)
    return np.minimum(np.abs(points - nodes[after]), np.abs(points - nodes[after - 1]))

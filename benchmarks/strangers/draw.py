"""Draw scenes by seed: numbers, a family, and a goal that random pushes reach.

    drawn = stranger(seed=1, number=0)
    drawn.scene, drawn.witness       # the witness is a plan of inputs alone that reaches the goal

The pushes act in a fine simulation: the scene's own time step, so short that a closed contact
turns through 0.02 rad in it, and half of that. A goal is kept if both simulations agree on it to a
tenth of what the task allows, so that it is a goal of the continuous motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.strangers.families import FAMILIES, Dice, Draft, Implausible, Size
from models.codegen.kernel import Kernel, Rollout, load_kernel
from models.scene import Scene, goal_limits
from models.scene.checks import check_expressions

# Ranges of a scene: centimetres to metres, grams to tens of kilograms, 50 to 50,000 N/m.
_LENGTH = (0.02, 2.0)  # [m]
_MASS = (0.005, 30.0)  # [kg]
_STIFFNESS = (50.0, 5e4)  # [N/m]
_HORIZON = (0.15, 4.0)  # [s]
_STEPS = (60, 400)
_SPEED = (0.02, 5.0)  # [m/s]
# omega h of a closed contact: half of the scenes fine, a third coarse, the rest near or past 2, the
# limit of stability of semi-implicit Euler.
_TURNS = ((0.5, (0.1, 0.5)), (0.8, (0.5, 1.0)), (1.0, (1.0, 2.2)))

_PIECES = 6  # of constant pushes
_TRIES = 60  # of pushes, until the numbers are drawn again
_SHARE = 0.8  # of the input range that pushes use
_FINE = 0.02  # omega h of the fine simulation
# Allowed errors of the goal: a share of the way, and a share of the mean speed.
_NEAR = 0.02
_SLOW = 0.1
_LOOSER = 2.0  # of the replay's limits
_MOVED = 5.0  # least distance of a goal from the end without pushes, in limits
_FAR = 2.0  # largest way to a goal, in lengths of the scene


@dataclass(frozen=True, kw_only=True, eq=False)
class Stranger:
    """A drawn scene. witness: inputs (steps, nu) [N, N m] whose motion reaches the goal."""

    family: str
    size: Size
    scene: Scene
    witness: np.ndarray


def stranger(seed: int, number: int) -> Stranger:
    """Draw a scene; families take turns."""
    names = list(FAMILIES)
    family = names[number % len(names)]
    attempt = 0
    while True:
        dice = Dice((seed, number, attempt))
        try:
            size = _size(dice)
            draft = FAMILIES[family](f"{family}_{seed}_{number}", dice, size)
            found = _with_goal(draft, dice, size)
        except Implausible:
            found = None
        if found is not None:
            return Stranger(family=family, size=size, scene=found[0], witness=found[1])
        attempt += 1


def _size(dice: Dice) -> Size:
    share = dice.random.uniform()
    turn = dice.between(*next(turns for below, turns in _TURNS if share <= below))
    length, mass = dice.spread(*_LENGTH), dice.spread(*_MASS)
    steps, horizon = round(dice.spread(*_STEPS)), dice.spread(*_HORIZON)
    step = float(f"{horizon / steps:.2g}")
    stiffness = float(f"{mass * (turn / step) ** 2:.2g}")
    speed = length / (step * steps)
    if not (_STIFFNESS[0] <= stiffness <= _STIFFNESS[1] and _SPEED[0] <= speed <= _SPEED[1]):
        raise Implausible
    return Size(length=length, mass=mass, stiffness=stiffness, step=step, steps=steps)


def _with_goal(draft: Draft, dice: Dice, size: Size) -> tuple[Scene, np.ndarray] | None:
    """Return the scene with a goal, and the pushes that reach it; None if no pushes do."""
    scene = draft.scene
    check_expressions(scene)
    position, velocity = _NEAR * draft.reach, _SLOW * draft.reach / size.horizon
    simulation = Simulation(scene, size)
    rest = np.tile(draft.rest, (scene.task.steps, 1))
    idle = simulation.run(rest)
    aims = list(draft.aims)
    for _ in range(_TRIES):
        u = _pushes(scene, dice, np.array(draft.rest))
        motion = simulation.run(u)
        if motion is None or not simulation.is_possible(motion):
            continue
        if np.abs(motion.q[-1] - motion.q[0])[aims].max() > _FAR * draft.reach:
            continue
        if idle is not None:
            touched = (motion.lam[:, : scene.nc] > 0) != (idle.lam[:, : scene.nc] > 0)
            moved = np.abs(motion.q[-1] - idle.q[-1])[aims].max()
            if not touched.any() or moved < _MOVED * position:
                continue
        again = simulation.run(u, 2)
        if again is None or np.abs(again.q[-1] - motion.q[-1])[aims].max() > 0.1 * position:
            continue
        if np.abs(again.v[-1] - motion.v[-1])[aims].max() > 0.1 * velocity:
            continue
        return _asked(draft, dice, again, position, velocity), u
    return None


def _pushes(scene: Scene, dice: Dice, rest: np.ndarray) -> np.ndarray:
    """Return inputs (steps, nu) that are constant in pieces, around those of rest."""
    lower = np.array([item.lower for item in scene.inputs])
    upper = np.array([item.upper for item in scene.inputs])
    pieces = rest + _SHARE * (upper - lower) / 2 * dice.random.uniform(-1, 1, (_PIECES, scene.nu))
    steps = scene.task.steps
    return np.clip(pieces, lower, upper)[np.arange(steps) * _PIECES // steps]


def _asked(draft: Draft, dice: Dice, motion: Rollout, position: float, velocity: float) -> Scene:
    """Return the scene with the end of a motion as its goal: always the aims' positions."""
    scene = draft.scene
    goal: list[float | None] = [None] * (2 * scene.nq)
    with_speed = dice.chance(0.5)
    for index in draft.aims:
        goal[index] = float(motion.q[-1, index])
        if with_speed:
            goal[scene.nq + index] = float(motion.v[-1, index])
    limits = goal_limits(
        position=position, velocity=velocity if with_speed else None, reason="as near as is asked"
    )
    looser = tuple(
        replace(limit, value=_LOOSER * limit.value)
        if limit.metric.startswith("replay_") and limit.value is not None
        else limit
        for limit in limits
    )
    return replace(scene, task=replace(scene.task, goal=tuple(goal)), limits=looser)


class Simulation:
    """The scene's own time step, so many times in a step of the task that contact is resolved."""

    def __init__(self, scene: Scene, size: Size) -> None:
        self._scene, self._kernel = scene, load_kernel(scene)
        # Two bodies of the least mass turn sqrt(2) times as fast.
        self.parts = max(4, math.ceil(math.sqrt(2.0) * size.turn / _FINE))

    @property
    def kernel(self) -> Kernel:
        """The compiled scene."""
        return self._kernel

    def run(self, u: np.ndarray, finer: int = 1) -> Rollout | None:
        """Return the motion under inputs (steps, nu); None if it diverges."""
        parts = finer * self.parts
        start, h = np.array(self._scene.task.start), self._scene.task.step / parts
        motion = self._kernel.rollout(start, np.repeat(u, parts, axis=0), h)
        return None if motion.diverged else motion

    def is_possible(self, motion: Rollout) -> bool:
        """Return whether no contact is deeper than its model reaches."""
        deepest = self._kernel.penetration(motion.q).max(axis=0)
        return bool((deepest < np.array(self._scene.depths)).all())

"""How far the contacts of a motion depart from those of the plan that it follows.

    contact_departure(scene, plan)      # 1: as much as the scene allows

Two motions that stay near each other may push at other times: a block that is 1 mm early is hit a
step early. So the judge also compares impulses and depths, and a planner that refines its grid must
measure both.
"""

from __future__ import annotations

import numpy as np

from formulations.grids import finer_scene, motion_on_finer_steps, plan_of
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scene.default_limits import IMPULSE, impulse_yardstick, limit_of, replay_limits
from models.scene.goal import goal_state, miss
from models.scene.typical_force import typical_force
from models.trajectory import Trajectory

# Steps in one of the plan's on which it is followed, as in formulations.grids.
_PARTS = 50
# Departure of a motion that leaves every bound, as in formulations.grids.
_LOST = 1e6


def contact_departure(scene: Scene, plan: Trajectory) -> float:
    """Return the largest part of what the scene allows that contacts of the fine motion differ by.

    Parameters
    ----------
    scene
        With the plan's steps.
    plan
        A plan of exact contact on them.

    Returns
    -------
    float
        Of the impulse that the plan has and the motion has not within a step, the other way round,
        each over its limit, and of the deepest penetration over the depth of its contact [-]. Of
        the motion with feedback; of the motion by the inputs alone too if that stays near the plan.

    Raises
    ------
    KernelError
        For a plan of another scene.
    """
    if not scene.nc:
        return 0.0
    followed = motion_on_finer_steps(scene, plan, _PARTS)
    if followed is None:
        return _LOST
    alone = _by_inputs_alone(scene, plan)
    motions = [followed, *([alone] if alone is not None and _is_near(scene, plan, alone) else [])]
    return min(_LOST, max(_departs(scene, plan, motion) for motion in motions))


def _by_inputs_alone(scene: Scene, plan: Trajectory) -> Trajectory | None:
    u, finer = np.repeat(plan.u, _PARTS, axis=0), finer_scene(scene, _PARTS)
    motion = load_kernel(scene).rollout(plan.start, u, finer.task.step)
    return None if motion.diverged else plan_of(finer, motion, u)


def _is_near(scene: Scene, plan: Trajectory, motion: Trajectory) -> bool:
    """Return whether a motion keeps the limits on its distance from the plan and from the goal."""
    off = np.abs(motion.q[::_PARTS] - plan.q).max(axis=0)
    if (off > replay_limits(scene)).any():
        return False
    missed = np.split(miss(motion.end, goal_state(scene.task)), 2)
    for part, values in zip(("position", "velocity"), missed, strict=True):
        most = limit_of(scene, f"replay_terminal_{part}_error")
        if most is not None and np.linalg.norm(values) > most:
            return False
    return True


def _departs(scene: Scene, plan: Trajectory, motion: Trajectory) -> float:
    planned = plan.lam[:, : scene.nc]
    forces = motion.lam[:, : scene.nc].reshape(plan.steps, _PARTS, scene.nc)
    least, most = _around(forces.min(axis=1), np.minimum), _around(forces.max(axis=1), np.maximum)
    step = scene.task.step
    common = step * float(np.minimum(np.abs(planned), most).sum())
    yardstick = impulse_yardstick(common, typical_force(scene, load_kernel(scene)), plan.duration)
    found = [float((_depths(scene, motion) / np.array(scene.depths)).max())]
    for name, excess in (("ghost_impulse", planned - most), ("missed_impulse", least - planned)):
        own = scene.limit(name)
        limit = IMPULSE * yardstick if own is None else own.value
        impulse = step * float(np.maximum(excess, 0.0).sum())
        if limit is not None and impulse > 0.0:
            found.append(impulse / limit if limit > 0.0 else _LOST)
    return max(found)


def _around(values: np.ndarray, choose: np.ufunc) -> np.ndarray:
    """Return the extreme (steps, nc) [N] of each step, the one before and the one after."""
    before, after = np.vstack([values[:1], values[:-1]]), np.vstack([values[1:], values[-1:]])
    return choose(choose(before, values), after)


def _depths(scene: Scene, motion: Trajectory) -> np.ndarray:
    return load_kernel(scene).penetration(motion.q).max(axis=0)

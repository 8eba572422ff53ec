"""Compare the contacts of the motion with those of its plan.

    contact_departure(scene, plan)  # 1: as much as the scene allows

Motions close to each other may have contact at other times, so the judge compares impulses and
depths, and a planner that refines its grid must too.
"""

from __future__ import annotations

import numpy as np

from formulations.grids import LOST, PARTS, finer_scene, motion_on_finer_steps, plan_of
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scene.default_limits import IMPULSE, impulse_yardstick, limit_of, replay_limits
from models.scene.goal import goal_state, miss
from models.scene.typical_force import typical_force
from models.trajectory import Trajectory


def contact_departure(scene: Scene, plan: Trajectory) -> float:
    """Return the largest contact difference of the fine motion, in parts of what the scene allows.

    It includes impulses that only the plan or only the motion has within a step, and the deepest
    penetration over the depth of its contact. The motion has feedback; the one without counts too
    if it stays close to the plan. Raises KernelError for a plan of another scene.
    """
    if not scene.nc:
        return 0.0
    followed = motion_on_finer_steps(scene, plan, PARTS)
    if followed is None:
        return LOST
    open_loop = _by_inputs_alone(scene, plan)
    motions = [
        followed,
        *([open_loop] if open_loop is not None and _is_near(scene, plan, open_loop) else []),
    ]
    return min(LOST, max(_departs(scene, plan, motion) for motion in motions))


def _by_inputs_alone(scene: Scene, plan: Trajectory) -> Trajectory | None:
    u, finer = np.repeat(plan.u, PARTS, axis=0), finer_scene(scene, PARTS)
    motion = load_kernel(scene).rollout(plan.start, u, finer.task.step)
    return None if motion.diverged else plan_of(finer, motion, u)


def _is_near(scene: Scene, plan: Trajectory, motion: Trajectory) -> bool:
    """Return whether a motion stays within its limits of distance from the plan and the goal."""
    off = np.abs(motion.q[::PARTS] - plan.q).max(axis=0)
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
    forces = motion.lam[:, : scene.nc].reshape(plan.steps, PARTS, scene.nc)
    least, most = _around(forces.min(axis=1), np.minimum), _around(forces.max(axis=1), np.maximum)
    step = scene.task.step
    common = step * float(np.minimum(np.abs(planned), most).sum())
    yardstick = impulse_yardstick(common, typical_force(scene, load_kernel(scene)), plan.duration)
    parts = [float((_depths(scene, motion) / np.array(scene.depths)).max())]
    for name, excess in (("ghost_impulse", planned - most), ("missed_impulse", least - planned)):
        own = scene.limit(name)
        limit = IMPULSE * yardstick if own is None else own.value
        impulse = step * float(np.maximum(excess, 0.0).sum())
        if limit is not None and impulse > 0.0:
            parts.append(impulse / limit if limit > 0.0 else LOST)
    return max(parts)


def _around(values: np.ndarray, choose: np.ufunc) -> np.ndarray:
    before, after = np.vstack([values[:1], values[:-1]]), np.vstack([values[1:], values[-1:]])
    return choose(choose(before, values), after)


def _depths(scene: Scene, motion: Trajectory) -> np.ndarray:
    return load_kernel(scene).penetration(motion.q).max(axis=0)

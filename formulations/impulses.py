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
from models.scene.default_limits import IMPULSE, limit_of, replay_limits
from models.scene.goal import goal_state, miss
from models.scene.impulses import (
    common_impulse,
    excess_impulse,
    force_window,
    impulse_yardstick,
)
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
    kernel, h = load_kernel(scene), np.full(plan.steps, scene.task.step)
    planned, forces = plan.lam[:, : scene.nc], motion.lam[:, : scene.nc]
    # The motion's forces are those at the starts of its steps; the last one stands for its end too.
    ends = np.concatenate([forces, forces[-1:]])
    least, most = force_window(ends, np.repeat(np.arange(plan.steps), PARTS), plan.steps)
    common = common_impulse(planned, most, h)
    yardstick = impulse_yardstick(common, typical_force(scene, kernel), plan.duration)
    depths = kernel.penetration(motion.q).max(axis=0)
    parts = [float((depths / np.array(scene.depths)).max())]
    for name, one, other in (("ghost_impulse", planned, most), ("missed_impulse", least, planned)):
        own = scene.limit(name)
        limit = IMPULSE * yardstick if own is None else own.value
        impulse = excess_impulse(one, other, h)
        if limit is not None and impulse > 0.0:
            parts.append(impulse / limit if limit > 0.0 else LOST)
    return max(parts)

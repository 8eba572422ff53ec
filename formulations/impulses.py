"""Compare the contacts of the motion with those of its plan.

    contact_departure(scene, plan)  # 1: as much as the scene allows

Motions close to each other may have contact at other times, so the judge compares impulses and
depths, and a planner that refines its grid must too.
"""

from __future__ import annotations

import numpy as np

from formulations.grids import (
    LOST,
    PARTS,
    distance_share,
    driven_motion,
    motion_on_finer_steps,
)
from models.codegen.kernel import load_kernel
from models.scene import Scene
from models.scene.default_limits import IMPULSE, impulse_yardstick
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
    driven = driven_motion(scene, plan)
    is_near = driven is not None and distance_share(scene, plan, driven) <= 1.0
    motions = [followed, *([driven] if driven is not None and is_near else [])]
    return min(LOST, max(_departs(scene, plan, motion) for motion in motions))


def _departs(scene: Scene, plan: Trajectory, motion: Trajectory) -> float:
    planned = plan.lam[:, : scene.nc]
    forces = motion.lam[:, : scene.nc].reshape(plan.steps, PARTS, scene.nc)
    least, most = _around(forces.min(axis=1), np.minimum), _around(forces.max(axis=1), np.maximum)
    step = scene.task.step
    common = step * float(np.minimum(np.abs(planned), most).sum())
    yardstick = impulse_yardstick(common, typical_force(scene, load_kernel(scene)), plan.duration)
    deepest = float((_depths(scene, motion) / np.array(scene.depths)).max())
    # A plan may use the whole depth, so what is below it is no difference.
    parts = [deepest if deepest > 1.0 else 0.0]
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

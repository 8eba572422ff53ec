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
from models.scene.default_limits import IMPULSE
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
    driven = driven_motion(scene, plan)
    is_near = driven is not None and distance_share(scene, plan, driven) <= 1.0
    motions = [followed, *([driven] if driven is not None and is_near else [])]
    return min(LOST, max(_departs(scene, plan, motion) for motion in motions))


def _departs(scene: Scene, plan: Trajectory, motion: Trajectory) -> float:
    kernel, h = load_kernel(scene), np.full(plan.steps, scene.task.step)
    planned, forces = plan.lam[:, : scene.nc], motion.lam[:, : scene.nc]
    # The motion's forces are those at the starts of its steps; the last one stands for its end too.
    ends = np.concatenate([forces, forces[-1:]])
    least, most = force_window(ends, np.repeat(np.arange(plan.steps), PARTS), plan.steps)
    common = common_impulse(planned, most, h)
    yardstick = impulse_yardstick(common, typical_force(scene, kernel), plan.duration)
    deepest = float((kernel.penetration(motion.q).max(axis=0) / np.array(scene.depths)).max())
    # A plan may use the whole depth, so what is below it is no difference.
    parts = [deepest if deepest > 1.0 else 0.0]
    for name, one, other in (("ghost_impulse", planned, most), ("missed_impulse", least, planned)):
        own = scene.limit(name)
        limit = IMPULSE * yardstick if own is None else own.value
        impulse = excess_impulse(one, other, h)
        if limit is not None and impulse > 0.0:
            parts.append(impulse / limit if limit > 0.0 else LOST)
    return max(parts)

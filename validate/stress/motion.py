"""Plans and replays as the hard cases need them: a scene's own compiled step for the plan, its FMU for the replay.

plan = rolled(scene, start=..., u=..., step=..., steps=...)       # a Trajectory by the compiled step
told = replayed(scene, plan)                                      # a Replay by the scene's FMU
"""

from __future__ import annotations

from typing import Any

import numpy as np

from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.fmu import build_fmu
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid
from validate.judge.replay import Replay
from validate.judge.replay.run import replay


def rolled(
    scene: Scene,
    *,
    start: Any = None,
    u: np.ndarray | None = None,
    step: float | None = None,
    steps: int | None = None,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
    every: int = 1,
) -> Trajectory:
    """The motion by the compiled step: start (2*nq,), u (steps, nu) (zeros unless given), step [s], those of the task unless given.

    every: nodes kept, one in so many; the inputs must then be constant between them.
    """
    h = scene.task.step if step is None else step
    count = (scene.task.steps if steps is None else steps) if u is None else len(u)
    inputs = np.zeros((count, scene.nu)) if u is None else u
    plan = load_kernel(scene).rollout(np.array(scene.task.start if start is None else start, dtype=float), inputs, h, law, eps)
    return Trajectory(
        t=uniform_grid(h * every, count // every),
        q=plan.q[::every],
        v=plan.v[::every],
        u=inputs[::every],
        lam=plan.lam[::every],
        scheme=Scheme.SEMI_IMPLICIT_EULER,
    )


def replayed(scene: Scene, plan: Trajectory, like: Scene | None = None, **settings: Any) -> Replay:
    """Replay of a plan, without feedback, by the FMU of the scene, or of `like`: one with other parameter values, which the FMU is told."""
    return replay(scene, build_fmu(scene if like is None else like), plan, **{"track": False, **settings})


def at_nodes(told: Replay) -> np.ndarray:
    """(nodes, 2*nq) states of a replay at the plan's nodes."""
    return np.hstack([told.q[told.knots], told.v[told.knots]])

"""Plans that are motions: what the scene's own time step makes of inputs."""

import numpy as np

from formulations.grids import plan_of
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.scene import Scene
from models.trajectory import Trajectory


def rolled_out(
    scene: Scene, u: np.ndarray, law: ContactLaw = ContactLaw.RELU, eps: float | None = None
) -> Trajectory:
    return plan_of(
        scene,
        load_kernel(scene).rollout(np.array(scene.task.start), u, scene.task.step, law, eps),
        u,
    )

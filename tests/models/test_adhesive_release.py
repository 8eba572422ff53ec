"""Released at phi = 0 (a contact that may pull) or where its force is gone (ours): both restitutions measured by the compiled step."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.scene import Scene

STEP = 5e-7  # s: of a contact of 0.07 s; the step is of first order, w h = 3e-5
TOLERANCE = 1e-4


def touching(ratio: float) -> tuple[Scene, float]:
    """The two discs at the touch, closing, with damping ratio z = ratio, and how long half a damped swing takes [s]."""
    scene = load_scene("damped_collision")
    values = {parameter.name: parameter.value for parameter in scene.parameters}
    mass = values["m1"] * values["m2"] / (values["m1"] + values["m2"])
    rate = math.sqrt(values["k"] / mass)
    scene = replace(scene, answers=(), limits=()).with_parameters(c=2.0 * ratio * math.sqrt(values["k"] * mass))
    return scene.with_task(start=(1.0, 1.0 + 2.0 * values["r"], 2.1, -1.0), step=STEP), math.pi / (rate * math.sqrt(1.0 - ratio**2))


def glued(scene: Scene) -> Scene:
    """The same spring and damper between the discs, as a force that also pulls; no contact."""
    pair = scene.contacts[0]
    moved = dict(zip((item.symbol for item in scene.coordinates), (item.velocity for item in scene.coordinates), strict=True))
    rate = sum(sp.diff(pair.penetration, q) * v for q, v in moved.items())
    push = pair.stiffness * pair.penetration + pair.damping * rate
    return replace(
        scene, contacts=(), forces=tuple(force + sp.diff(-pair.penetration, q) * push for force, q in zip(scene.forces, moved, strict=True))
    )


def restitution(scene: Scene, seconds: float, radius: float) -> float:
    """Speed at which phi comes back to zero, over the closing speed."""
    steps = round(1.6 * seconds / STEP)
    found = load_kernel(scene).rollout(np.array(scene.task.start), np.zeros((steps, 0)), STEP)
    phi = 2.0 * radius - (found.q[:, 1] - found.q[:, 0])
    last = 10 + int(np.argmax(phi[10:] <= 0.0))  # the first node after the contact; glued discs swing on
    assert 1000 < last < steps, "the contact is over within the motion"
    return float((found.v[last, 1] - found.v[last, 0]) / (found.v[0, 0] - found.v[0, 1]))


@pytest.mark.parametrize("z", [0.05, 0.2, 0.5])
def test_a_contact_that_may_pull_is_released_at_phi_0_and_loses_more(z: float):
    scene, seconds = touching(z)
    radius = next(parameter.value for parameter in scene.parameters if parameter.name == "r")
    pulling, ours = restitution(glued(scene), seconds, radius), restitution(scene, seconds, radius)
    angle = math.acos(z)
    assert pulling == pytest.approx(math.exp(-math.pi * z / math.sqrt(1.0 - z**2)), rel=TOLERANCE)
    assert ours == pytest.approx(math.exp(-2.0 * angle / math.tan(angle)), rel=TOLERANCE)
    assert pulling < ours - 0.01 * z

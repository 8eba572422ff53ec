"""How deep contacts go between the rows of a world's motion: a ball of a gram on a floor, whose bounces have a closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from models.scene import Contact, Coordinate, Input, Limit, Parameter, Scene, Task
from models.trajectory import Trajectory
from validate.judge.replay.wiring import World
from validate.judge.robustness.trials import SceneArena
from validate.judge.robustness.worlds import draw, nominal_world, perturbations

STEP = 0.01
STEPS = 60
LIMITS = {"replay_cost": 1e5}


def ball(stiffness: float) -> Scene:
    z, vz, u = sp.symbols("z vz u", real=True)
    m, g, k = sp.symbols("m g k", positive=True)
    return Scene(
        name="falling_gram", title="A gram falls on a floor", source="Newton",
        coordinates=(Coordinate(symbol=z, velocity=vz, unit="m", description="height"),),
        inputs=(Input(symbol=u, unit="N", lower=-1.0, upper=1.0, description="lift"),),
        parameters=(
            Parameter(symbol=m, value=1e-3, unit="kg", lower=1e-6, description="its mass"),
            Parameter(symbol=g, value=9.81, unit="m/s^2", lower=0.0, description="gravity"),
            Parameter(symbol=k, value=stiffness, unit="N/m", lower=1e-6,
                      description="of the floor"),
        ),
        kinetic_energy=m * vz**2 / 2, potential_energy=m * g * z, forces=(u,),
        contacts=(Contact(name="floor", bodies=("ball", "floor"), penetration=-z, stiffness=k,
                          depth=1e-4, depth_reason="paint", nominal=1e-5,
                          description="ball on floor"),),
        task=Task(start=(0.2, 0.0), goal=(None, None), running_cost=u**2, step=STEP, steps=STEPS),
        limits=(Limit(metric="cost", value=1e5, reason="none"),
                Limit(metric="replay_cost", value=1e5, reason="none")),
    )  # fmt: skip


def falling(u: np.ndarray) -> Trajectory:
    """A plan of inputs alone, (steps,) [N]."""
    still = np.zeros((STEPS + 1, 1))
    return Trajectory(
        t=STEP * np.arange(STEPS + 1),
        q=still + 0.2,
        v=still,
        u=u[:, None],
        lam=still[1:],
        missing=frozenset({"q", "v", "lam"}),
    )


def bounced(world: World, until: float, lift: float) -> tuple[float, float, float]:
    """Depth of the first contact [m], and height and speed at a time after it and before the next [m, m/s]."""
    (m, g, k), (z, v) = world.parameters.tolist(), world.start.tolist()
    g, w = g - world.gain.item() * lift / m, math.sqrt(k / m)
    speed = math.sqrt(v * v + 2.0 * g * z)  # where it meets the floor
    sag, swing = g / w**2, math.hypot(speed / w, g / w**2)
    lasts = 2.0 * (math.pi - math.atan2(speed / w, sag)) / w
    rises = until - (v + speed) / g - lasts
    return sag + swing, speed * rises - g * rises**2 / 2.0, speed - g * rises


def deepest(world: World, switch: float, lifts: tuple[float, float]) -> float:
    """Of both contacts, the second with the other lift from `switch` on [m]."""
    first, *state = bounced(world, switch, lifts[0])
    return max(first, bounced(replace(world, start=np.array(state)), switch, lifts[1])[0])


# With the first floor a contact lasts 0.1 ms, a hundredth of a step; with the other three steps,
# and no row of it comes within 1 % of the deepest.
@pytest.mark.parametrize("stiffness", [1e6, 12.0])
@pytest.mark.parametrize("lifts", [(-0.002, -0.002), (0.002, -0.006)])
def test_the_depth_of_a_world_is_that_of_the_closed_form(
    stiffness: float, lifts: tuple[float, float]
):
    scene, switch = ball(stiffness), 30
    plan = falling(np.where(np.arange(STEPS) < switch, *lifts))
    limit = deepest(nominal_world(scene, plan), switch * STEP, lifts)
    scene = replace(
        scene, contacts=(replace(scene.contacts[0], depth=limit, nominal=limit / 10.0),)
    )
    worlds, shares = draw(perturbations(scene, plan, ["parameters", "start", "gain"]), 16, 3), []
    with SceneArena.of(scene, plan, LIMITS) as arena:
        for number in range(16):
            world = worlds.world(number, arena.nominal)
            shares.append(deepest(world, switch * STEP, lifts) / limit)
            assert arena.trial(world).shares["max_penetration"] == pytest.approx(
                shares[-1], abs=1e-3
            )
            exact = arena.checked(world)
            assert exact.shares["max_penetration"] == pytest.approx(shares[-1], rel=1e-4)
    assert min(shares) < 0.99, "some worlds arrive"
    assert max(shares) > 1.01, "and some do not"

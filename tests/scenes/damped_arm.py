"""For tests: an arm on a cart with a damped foot, a damped hand and an undamped bumper.

Penetrations curved, mass matrix not constant, friction below.
"""

import sympy as sp

from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.contacts import Contact, DampingLaw, Friction

x, a, z, vx, va, vz, push, twist = sp.symbols("x a z vx va vz push twist", real=True)
m, k, c, d, mu, g, l = sp.symbols("m k c d mu g l", positive=True)  # noqa: E741 - l is the field's name for a length

SCENE = Scene(
    name="damped_arm",
    title="An arm on a cart with damped contacts",
    source="own",
    coordinates=(
        Coordinate(symbol=x, velocity=vx, unit="m"),
        Coordinate(symbol=a, velocity=va, unit="rad"),
        Coordinate(symbol=z, velocity=vz, unit="m"),
    ),
    inputs=(
        Input(symbol=push, unit="N", lower=-40.0, upper=40.0),
        Input(symbol=twist, unit="N m", lower=-10.0, upper=10.0),
    ),
    parameters=(
        Parameter(symbol=m, value=1.3, unit="kg"),
        Parameter(symbol=k, value=300.0, unit="N/m"),
        Parameter(symbol=c, value=6.0, unit="N s/m"),
        Parameter(symbol=d, value=0.8, unit="s/m"),
        Parameter(symbol=mu, value=0.3, unit="1"),
        Parameter(symbol=g, value=9.81, unit="m/s^2"),
        Parameter(symbol=l, value=1.0, unit="m"),
    ),
    kinetic_energy=m
    * (
        (vx + l * va * sp.cos(a)) ** 2
        + (l * va * sp.sin(a)) ** 2
        + vx**2
        + vz**2
        + l**2 * va**2 / 3
    )
    / 2,
    potential_energy=m * g * (l * sp.cos(a) + z),
    forces=(push, twist, sp.Integer(0)),
    contacts=(
        Contact(
            name="foot",
            bodies=("arm", "ground"),
            depth=1.0,
            depth_reason="the length of the arm",
            penetration=-z - x**2 / 20,
            stiffness=k,
            damping=c * (1 + mu),
            nominal=0.05,
        ),
        Contact(
            name="bumper",
            bodies=("cart", "wall"),
            depth=1.0,
            depth_reason="the length of the arm",
            penetration=x - sp.Rational(1, 20),
            stiffness=2 * k,
            nominal=0.05,
        ),
        Contact(
            name="hand",
            bodies=("arm", "wall"),
            depth=1.0,
            depth_reason="the length of the arm",
            penetration=x + l * sp.sin(a) - sp.Rational(1, 2),
            stiffness=k,
            damping=d,
            damping_law=DampingLaw.HUNT_CROSSLEY,
            nominal=0.05,
        ),
    ),
    frictions=(Friction(name="sole", slip=vx, coefficient=mu, contact="foot"),),
    task=Task(
        start=(0.0, 0.1, 0.02, 0.8, 0.3, -0.5),
        goal=(None,) * 6,
        running_cost=push**2 + twist**2,
        step=0.005,
        steps=120,
    ),
)

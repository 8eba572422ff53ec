"""A planar arm of two uniform rods, driven at both joints, beside a soft wall: the mass matrix depends on q, and so does the
direction of the contact force.

q1 is the angle of the first rod above the horizontal, q2 that of the second rod relative to the
first. The tip touches the wall at x = w. Without torques, damping and contact the energy is kept.
"""

import sympy as sp

from models.scene import Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.parts import goal_limits

q1, q2 = sp.symbols("q1 q2", real=True)
v1, v2 = sp.symbols("v1 v2", real=True)
u1, u2 = sp.symbols("u1 u2", real=True)
m1, m2, l1, l2, g, c, k, w = sp.symbols("m1 m2 l1 l2 g c k w", positive=True)

X1 = l1 * sp.cos(q1)
Y1 = l1 * sp.sin(q1)
X2 = X1 + l2 * sp.cos(q1 + q2)
Y2 = Y1 + l2 * sp.sin(q1 + q2)


def _rod_energy(
    mass: sp.Symbol, length: sp.Symbol, x: sp.Expr, y: sp.Expr, rate: sp.Expr
) -> sp.Expr:
    """Kinetic energy of a uniform rod with its centre at (x, y), turning at `rate` [J]."""
    speed = [sp.diff(position, q1) * v1 + sp.diff(position, q2) * v2 for position in (x, y)]
    return mass * (speed[0] ** 2 + speed[1] ** 2) / 2 + mass * length**2 / 12 * rate**2 / 2


FIRST = _rod_energy(m1, l1, X1 / 2, Y1 / 2, v1)
SECOND = _rod_energy(m2, l2, (X1 + X2) / 2, (Y1 + Y2) / 2, v1 + v2)

SCENE = Scene(
    name="two_link_arm",
    title="A two-link arm presses its tip against a wall",
    source="Lagrange's equations of two uniform rods, derived by computer algebra from the energies in this file",
    coordinates=(
        Coordinate(
            symbol=q1,
            velocity=v1,
            unit="rad",
            description="angle of the first rod above the horizontal",
        ),
        Coordinate(
            symbol=q2,
            velocity=v2,
            unit="rad",
            description="angle of the second rod relative to the first",
        ),
    ),
    inputs=(
        Input(symbol=u1, unit="N m", lower=-60.0, upper=60.0, description="torque at the base"),
        Input(symbol=u2, unit="N m", lower=-30.0, upper=30.0, description="torque at the elbow"),
    ),
    parameters=(
        Parameter(symbol=m1, value=1.0, unit="kg", lower=1e-6, description="mass of the first rod"),
        Parameter(
            symbol=m2, value=0.8, unit="kg", lower=1e-6, description="mass of the second rod"
        ),
        Parameter(
            symbol=l1, value=1.0, unit="m", lower=1e-6, description="length of the first rod"
        ),
        Parameter(
            symbol=l2, value=0.9, unit="m", lower=1e-6, description="length of the second rod"
        ),
        Parameter(symbol=g, value=9.81, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(
            symbol=c,
            value=0.3,
            unit="N m s/rad",
            lower=0.0,
            description="viscous damping of each joint",
        ),
        Parameter(symbol=k, value=400.0, unit="N/m", lower=1e-6, description="contact stiffness"),
        Parameter(
            symbol=w,
            value=1.2,
            unit="m",
            lower=0.0,
            description="distance of the wall from the base",
        ),
    ),
    kinetic_energy=sp.simplify(sp.expand(FIRST + SECOND)),
    potential_energy=g * (m1 * Y1 / 2 + m2 * (Y1 + Y2) / 2),
    forces=(u1 - c * v1, u2 - c * v2),
    contacts=(
        Contact(
            name="wall",
            bodies=("second rod", "wall"),
            penetration=X2 - w,
            stiffness=k,
            depth=l1 + l2 - w,
            depth_reason="the tip of a stretched arm: no arm reaches deeper",
            nominal=0.05,
            description="tip against wall",
        ),
    ),
    task=Task(
        start=(1.4, -0.3, 0.0, 0.0),
        goal=(1.1, -0.5, 0.0, 0.0),
        running_cost=u1**2 + u2**2,
        step=0.01,
        steps=100,
    ),
    limits=goal_limits(
        position=0.01, velocity=0.01, reason="half a degree, and half a degree a second"
    ),
    shapes=(
        Shape(name="first rod", kind="line", x=X1 / 2, y=Y1 / 2, size=(l1,), angle=q1),
        Shape(
            name="second rod",
            kind="line",
            x=(X1 + X2) / 2,
            y=(Y1 + Y2) / 2,
            size=(l2,),
            angle=q1 + q2,
        ),
        Shape(name="wall", kind="wall", x=w, y=sp.Integer(0), size=(4.0,), angle=sp.pi / 2),
    ),
)

"""A finger pushes a drawer shut over a rough rail: it must glide the last part by itself and stop at the closed place."""

import sympy as sp

from models.scene import Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.contacts import Friction
from models.scene.parts import goal_limits

x, f = sp.symbols("x f", real=True)
vx, vf = sp.symbols("vx vf", real=True)
u = sp.Symbol("u", real=True)
m, mf, mu, g, k = sp.symbols("m mf mu g k", positive=True)

SCENE = Scene(
    name="drawer", title="A finger pushes a drawer shut over a rough rail",
    source="Newton's equations of two masses on a line",
    coordinates=(
        Coordinate(symbol=x, velocity=vx, unit="m", description="position of the drawer"),
        Coordinate(symbol=f, velocity=vf, unit="m", description="position of the finger"),
    ),
    inputs=(Input(symbol=u, unit="N", lower=-30.0, upper=30.0, description="force on the finger"),),
    parameters=(
        Parameter(symbol=m, value=2.0, unit="kg", lower=1e-6, description="mass of the drawer"),
        Parameter(symbol=mf, value=0.5, unit="kg", lower=1e-6, description="mass of the finger"),
        Parameter(symbol=mu, value=0.15, unit="1", lower=0.0,
                  description="coefficient of friction"),
        Parameter(symbol=g, value=9.81, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(symbol=k, value=2000.0, unit="N/m", lower=1e-6,
                  description="stiffness of the finger tip"),
    ),
    kinetic_energy=(m * vx**2 + mf * vf**2) / 2, potential_energy=sp.Integer(0),
    forces=(sp.Integer(0), u),
    contacts=(
        Contact(
            name="tip", bodies=("finger", "drawer"), penetration=f - x, stiffness=k,
            depth=sp.Rational(2, 100), depth_reason="the tip is 2 cm long",
            description="finger against the drawer",
        ),
    ),
    frictions=(Friction(name="rail", slip=vx, coefficient=mu, normal_force=m * g,
                        description="drawer on its rail"),),
    task=Task(start=(0.3, 0.0, 0.0, 0.0), goal=(0.8, 0.3, 0.0, 0.0),
              running_cost=sp.Float("1e-2") * u**2, step=0.01, steps=200),
    limits=goal_limits(position=0.01, velocity=0.02,
                       reason="a drawer that is a centimetre open is open"),
    length=1.0,
    shapes=(
        Shape(name="drawer", kind="box", x=x + sp.Rational(1, 10), y=0,
              size=(sp.Rational(1, 5), sp.Rational(1, 5))),
        Shape(name="finger", kind="box", x=f - sp.Rational(1, 20), y=0,
              size=(sp.Rational(1, 10), sp.Rational(1, 20))),
    ),
)  # fmt: skip

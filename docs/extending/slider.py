"""A mass on a damped slide is pushed against a soft wall and must press it in by 2 cm."""

import sympy as sp

from models.scene import Contact, Coordinate, Input, Limit, Parameter, Scene, Shape, Task

q, v, u = sp.symbols("q v u", real=True)
m, c, k = sp.symbols("m c k", positive=True)

SCENE = Scene(
    name="slider",
    title="A mass is pushed against a soft wall",
    source="Newton's second law",
    coordinates=(Coordinate(symbol=q, velocity=v, unit="m", description="position of the mass"),),
    inputs=(Input(symbol=u, unit="N", lower=-5.0, upper=5.0, description="push"),),
    parameters=(
        Parameter(symbol=m, value=1.0, unit="kg", lower=1e-6, description="mass"),
        Parameter(symbol=c, value=2.0, unit="N s/m", lower=0.0, description="damping"),
        Parameter(
            symbol=k, value=100.0, unit="N/m", lower=1e-6, description="stiffness of the wall"
        ),
    ),
    kinetic_energy=m * v**2 / 2,
    potential_energy=sp.Integer(0),
    forces=(u - c * v,),
    contacts=(
        Contact(
            name="wall",
            bodies=("mass", "wall"),
            penetration=q - 1,
            stiffness=k,
            depth=0.1,
            depth_reason="the length of the mass: beyond it the whole mass is in the wall",
            nominal=0.05,
            description="mass against the wall at 1 m",
        ),
    ),
    task=Task(start=(0.0, 0.0), goal=(1.02, None), running_cost=u**2, step=0.005, steps=400),
    limits=(
        Limit(
            metric="terminal_position_error",
            value=0.002,
            reason="a tenth of the required penetration",
        ),
        Limit(
            metric="replay_terminal_position_error",
            value=0.005,
            reason="the limit of the plan, and 3 mm for the time step",
        ),
    ),
    shapes=(
        Shape(
            name="mass", kind="box", x=q - sp.Rational(1, 20), y=sp.Rational(1, 20), size=(0.1, 0.1)
        ),
    ),
)

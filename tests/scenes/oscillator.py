"""The smallest scene there can be: q'' = -q.

No input, no parameter, no contact, no damping; q = cos t, v = -sin t.

Every back end must leave out what is not here.
"""

import sympy as sp

from models.scene import Coordinate, Scene, Task
from models.scene.parts import goal_limits

q, v = sp.symbols("q v", real=True)

SCENE = Scene(
    name="oscillator", title="A unit mass on a unit spring", source="q = cos t",
    coordinates=(Coordinate(symbol=q, velocity=v, unit="m", description="position of the mass"),),
    inputs=(), parameters=(),
    kinetic_energy=v**2 / 2, potential_energy=q**2 / 2, forces=(sp.Integer(0),), contacts=(),
    task=Task(start=(1.0, 0.0), goal=(-1.0, 0.0), running_cost=sp.Integer(0), step=0.01, steps=314),
    limits=goal_limits(position=0.01, velocity=0.01, reason="a step of the time"),
)  # fmt: skip

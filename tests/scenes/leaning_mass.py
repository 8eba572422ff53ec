"""A mass on a hill that rolls away from the top: q'' = 4 q + u.

Linear, unstable at 2/s, no contact; the least cost is a quadratic program.

With semi-implicit steps of h the growth is that of the larger root z of z^2 - (2 + 4 h^2) z + 1 = 0
a step.
"""

import sympy as sp

from models.scene import Coordinate, Input, Scene, Task
from models.scene.parts import goal_limits

q, v, u = sp.symbols("q v u", real=True)

SCENE = Scene(
    name="leaning_mass",
    title="A unit mass on a round hill",
    source="q'' = 4 q + u",
    coordinates=(Coordinate(symbol=q, velocity=v, unit="m", description="position of the mass"),),
    inputs=(Input(symbol=u, unit="N", lower=-6.0, upper=6.0, description="force"),),
    parameters=(),
    kinetic_energy=v**2 / 2,
    potential_energy=-2 * q**2,
    forces=(u,),
    contacts=(),
    task=Task(
        start=(0.5, 0.0),
        goal=(0.0, 0.0),
        running_cost=u**2 + q**2 / 2 + q * v / 10 + v**2 / 10,
        step=0.02,
        steps=50,
    ),
    limits=goal_limits(
        position=0.01,
        velocity=0.02,
        reason="what leans as far or as fast is 0.01 m off, twice over, after 0.35 s",
    ),
)

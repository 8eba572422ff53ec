"""A ball flies through the place of a pane that is far thinner than its way in a time step; energy to break through is not there."""

import sympy as sp

from models.scene import Contact, Coordinate, Input, Parameter, Scene, Task, goal_limits

q, v, u = sp.symbols("q v u", real=True)
m, w, k, c = sp.symbols("m w k c", positive=True)

SCENE = Scene(
    name="thin_pane",
    title="A ball and a thin pane",
    source="a parabola of penetration across the pane: in the middle it takes k/2 (w/4)^2 to be there",
    coordinates=(Coordinate(symbol=q, velocity=v, unit="m", description="place of the ball"),),
    inputs=(Input(symbol=u, unit="N", lower=-5.0, upper=5.0, description="push"),),
    parameters=(
        Parameter(symbol=m, value=1.0, unit="kg", lower=1e-6, description="mass"),
        Parameter(symbol=w, value=4e-4, unit="m", lower=1e-15, description="thickness of the pane"),
        Parameter(symbol=k, value=1e11, unit="N/m", lower=1e-6, description="stiffness of the pane"),
        Parameter(symbol=c, value=1.091, unit="m", lower=0.0, description="where the middle of the pane is"),
    ),
    kinetic_energy=m * v**2 / 2,
    potential_energy=sp.Integer(0),
    forces=(u,),
    contacts=(
        Contact(
            name="pane",
            bodies=("ball", "pane"),
            penetration=(w**2 / 4 - (q - c) ** 2) / w,
            stiffness=k,
            depth=1e-4,
            depth_reason="a quarter of the thickness, in the middle of the pane",
            nominal=1e-3,
            description="ball against the pane",
        ),
    ),
    task=Task(start=(0.0, 10.0), goal=(2.0, 10.0), running_cost=u**2, step=0.02, steps=10),
    limits=goal_limits(position=0.005, velocity=0.005, reason="a thousandth of the way"),
)

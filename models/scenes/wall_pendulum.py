"""An inverted pendulum, linearised, is thrown at a soft wall: twenty steps, a provable optimum.

Source: hybrid MPC benchmark in Marcucci, Tedrake, "Warm Start of Mixed-Integer Programs for Model
Predictive Control of Hybrid Systems" (IEEE TAC, 2021), and Deits, Koolen, Tedrake, "LVIS" (ICRA
2019): mass, length, gravity, k = 100 N/m, wall at l*theta = 0.1 m, h = 0.01 s, T = 20, bounds of 4
N m and 1.5 rad/s (at the start of every step), start (0, 0.8), Q = I, R = 1. Differences: the cost
is the sum over t = 0..T-1 of theta^2 + omega^2 + u^2, with a free end without weight (there: the
value of a controller that ignores the wall, and its safe set); one wall. Without contact the
cheapest plan brakes with up to 4 N m and costs 148.06 instead of 13.62.
"""

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.parts import limits

theta, omega = sp.symbols("theta omega", real=True)
u = sp.Symbol("u", real=True)
m, l, g, k, w = sp.symbols("m l g k w", positive=True)  # noqa: E741 - l is the field's name for a length

SCENE = Scene(
    name="wall_pendulum",
    title="A linear inverted pendulum is thrown at a soft wall",
    source="Marcucci and Tedrake, Warm Start of Mixed-Integer Programs for Model Predictive Control of Hybrid Systems; Deits, Koolen and Tedrake, LVIS",
    coordinates=(
        Coordinate(
            symbol=theta,
            velocity=omega,
            unit="rad",
            nominal=0.1,
            velocity_lower=-1.5,
            velocity_upper=1.5,
            description="angle from upright",
        ),
    ),
    inputs=(Input(symbol=u, unit="N m", lower=-4.0, upper=4.0, description="torque at the base"),),
    parameters=(
        Parameter(symbol=m, value=1.0, unit="kg", lower=1e-6, description="mass at the tip"),
        Parameter(symbol=l, value=1.0, unit="m", lower=1e-6, description="length"),
        Parameter(symbol=g, value=10.0, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(
            symbol=k, value=100.0, unit="N/m", lower=1e-6, description="stiffness of the wall"
        ),
        Parameter(
            symbol=w,
            value=0.1,
            unit="m",
            lower=0.0,
            description="distance of the wall from the upright tip",
        ),
    ),
    kinetic_energy=m * l**2 * omega**2 / 2,
    potential_energy=-m * g * l * theta**2 / 2,  # m g l cos(theta) to second order
    forces=(u,),
    contacts=(
        Contact(
            name="wall",
            bodies=("tip", "wall"),
            penetration=l * theta - w,
            stiffness=k,
            depth=l,
            depth_reason="the length of the pendulum: l theta stands for l sin(theta), which is l at most, so that no tip is as far out",
            nominal=0.05,
            description="tip against wall",
        ),
    ),
    task=Task(
        start=(0.0, 0.8),
        goal=(None, None),
        running_cost=theta**2 + omega**2 + u**2,
        step=0.01,
        steps=20,
    ),
    limits=limits(
        replay_cost=(
            13.6634,
            "what doing nothing costs, 13.66347: the wall throws the pendulum back by itself, and a torque has to be worth its price",
        ),
        replay_error=(
            5e-4,
            "six times what a semi-implicit step of 0.01 s drifts from the continuous motion over the 0.2 s (measured under the true law: "
            "2e-5 to 8e-5 rad; softplus plans leave theirs by 0.04 to 0.14 rad)",
        ),
    ),
    answers=(
        Answer(
            quantity="best known cost of an exact plan",
            value=13.622851470202807,
            tolerance=1e-9,
            source="convex QP with the wall pushing on steps 13..19; proved global to a relative gap of 1e-5: convex bounds (Clarabel 0.11.1) decide all 19 contact decisions of any plan that is not dearer, and branch and bound without a start (SCIP 6.3.0, 420 nodes) ends at the same cost",
        ),
        Answer(
            quantity="least cost of a plan that never touches the wall",
            value=148.0553656203583,
            tolerance=1e-7,
            source="convex QP with the wall open on all steps",
        ),
    ),
    length=1.0,  # as in the paper
    shapes=(
        Shape(
            name="pendulum",
            kind="line",
            x=l * theta / 2,
            y=l / 2,
            size=(l,),
            angle=sp.pi / 2 - theta,
        ),
        Shape(name="tip", kind="disc", x=l * theta, y=l, size=(sp.Rational(1, 50),)),
        Shape(
            name="wall",
            kind="wall",
            x=w + sp.Rational(1, 50),
            y=l,
            size=(sp.Rational(3, 10),),
            angle=sp.pi / 2,
        ),
    ),
)

"""Three carts in a row: the outer ones push the middle one through soft contacts.

Source: H.J. Terry Suh, Yanwei Wang, "Comparing Effectiveness of Relaxation Methods for Warm
    Starting
Trajectory Optimization through Soft Contact", section V. The paper has no start, goal, cart length
and bounds; those below reproduce its softplus collocation rows to the printed digits. The sign of
the penetration in its (14) is corrected.
"""

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.parts import limits

q1, q2, q3 = sp.symbols("q1 q2 q3", real=True)
v1, v2, v3 = sp.symbols("v1 v2 v3", real=True)
u1, u3 = sp.symbols("u1 u3", real=True)
m, c, k, d = sp.symbols("m c k d", positive=True)

_PASSED = "the length of a cart: there the centres of the two coincide, and beyond it they have passed through each other"

SCENE = Scene(
    name="three_cart",
    title="Three carts: the outer two push the middle one",
    source="Suh and Wang, Comparing Effectiveness of Relaxation Methods for Warm Starting Trajectory Optimization through Soft Contact, section V",
    coordinates=tuple(
        Coordinate(symbol=q, velocity=v, unit="m", description=f"position of the {which} cart")
        for q, v, which in ((q1, v1, "left"), (q2, v2, "middle"), (q3, v3, "right"))
    ),
    inputs=(
        Input(symbol=u1, unit="N", lower=-10.0, upper=10.0, description="force on the left cart"),
        Input(symbol=u3, unit="N", lower=-10.0, upper=10.0, description="force on the right cart"),
    ),
    parameters=(
        Parameter(symbol=m, value=1.0, unit="kg", lower=1e-6, description="mass of each cart"),
        Parameter(
            symbol=c, value=2.0, unit="N s/m", lower=0.0, description="viscous damping of each cart"
        ),
        Parameter(symbol=k, value=30.0, unit="N/m", lower=1e-6, description="contact stiffness"),
        Parameter(symbol=d, value=0.5, unit="m", lower=1e-6, description="length of a cart"),
    ),
    kinetic_energy=m * (v1**2 + v2**2 + v3**2) / 2,
    potential_energy=sp.Integer(0),
    forces=(u1 - c * v1, -c * v2, u3 - c * v3),
    contacts=tuple(
        Contact(
            name=name,
            bodies=(left, right),
            penetration=d - distance,
            stiffness=k,
            depth=d,
            depth_reason=_PASSED,
            nominal=0.1,
            description=f"{left} cart against {right} cart",
        )
        for name, left, right, distance in (
            ("left", "left", "middle", q2 - q1),
            ("right", "middle", "right", q3 - q2),
        )
    ),
    task=Task(
        start=(2.0, 3.0, 4.0, 0.0, 0.0, 0.0),
        goal=(2.5, 3.5, 4.5, 0.0, 0.0, 0.0),
        running_cost=u1**2 + u3**2,
        step=0.01,
        steps=500,
    ),
    limits=limits(
        terminal_position_error=(
            0.05,
            "a tenth of a cart's length, as the largest miss the paper calls successful (0.05, its Table I, direct methods)",
        ),
        terminal_velocity_error=(
            0.1,
            "with 0.1 m/s a cart coasts another m/c * 0.1 = 0.05 m, the limit of its position",
        ),
        replay_terminal_position_error=(
            0.06,
            "the plan's limit of 0.05 m plus the grid's own error: with h = 0.01 s the time step ends up to 9e-3 from the continuous motion",
        ),
        replay_terminal_velocity_error=(
            0.11,
            "the plan's limit of 0.1 m/s plus the same 9e-3 of the grid",
        ),
        replay_error=(
            0.02,
            "twice what a semi-implicit step of 0.01 s drifts from the continuous motion over the 5 s (measured under the true law: 4e-3 to "
            "1.1e-2 m, 6.9e-3 for strict plans; softplus plans leave theirs by 0.09 to 0.35 m): more than that is not the grid",
        ),
    ),
    answers=(
        Answer(
            quantity="best known cost of an exact plan",
            value=490.5495305,
            tolerance=1e-6,
            source="convex QP with fixed contact windows (steps 131..178 and 276..306), local search over the four window ends; not proved global",
        ),
    ),
    length=1.0,  # as in the paper
    shapes=tuple(
        Shape(name=name, kind="box", x=q, y=d / 2, size=(d, d))
        for name, q in (("left", q1), ("middle", q2), ("right", q3))
    ),
)

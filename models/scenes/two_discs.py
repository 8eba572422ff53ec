"""One disc is thrown at another, which must glide past the goal at the end, elastic, frictionless.

    two_discs()  # starts (-1, -2) and (-1, -1)
    two_discs(wall=True)  # starts (0.25, -0.3) and (-0.5, 0.6), off a wall at y = 1

The cost is |q2(T)|^2 + 0.01 int |u|^2 dt. For k -> infinity contact tends to rigid impact, with
speed s along the line of centres n; the least work to a place d away within t, per unit of mass and
weight, is 12 (d.n)^2/t^3 - 12 (d.n) s/t^2 + 4 s^2/t + 3 |d - (d.n) n|^2/t^3. Its minimum over n, t,
s is the optimum: 0.3114169, with the wall (goal mirrored at y = 1 - r) 0.3736364. The limit of the
cost is the cheapest rigid throw onto the goal: 0.4079873, with the wall 0.5911108; doing nothing
costs 2 and 0.61.
"""

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.parts import limits

RADIUS = 0.2
MASS = 1.0
WEIGHT = 0.01
STEPS = 480
STEP = 1.0 / STEPS
WALL = 1.0
RIGID_OPTIMUM = 0.3114169
RIGID_OPTIMUM_WALL = 0.3736364
RIGID_HIT = 0.4079873
RIGID_HIT_WALL = 0.5911108
# Smooths the distance sqrt(|q2 - q1|^2 + BLUR^2) [m] of coincident centres; touching discs are
# 1e-12 m off.
BLUR = 1e-6

x1, y1, x2, y2 = q = sp.symbols("x1 y1 x2 y2", real=True)
vx1, vy1, vx2, vy2 = v = sp.symbols("vx1 vy1 vx2 vy2", real=True)
ux, uy = sp.symbols("ux uy", real=True)
m, r, k, y_w = sp.symbols("m r k y_w", positive=True)


def two_discs(wall: bool = False, name: str = "two_discs") -> Scene:
    """Return the scene with or without the wall at y = 1."""
    distance = sp.sqrt((x2 - x1) ** 2 + (y2 - y1) ** 2 + BLUR**2)
    contacts = [
        Contact(
            name="pair",
            bodies=("disc 1", "disc 2"),
            penetration=2 * r - distance,
            stiffness=k,
            depth=r,
            depth_reason="the radius: there the rim of each disc has reached the centre of the other, and the line of centres soon turns over from one step to the next",
            nominal=0.02,
            description="disc 1 against disc 2",
        )
    ]
    parameters = [
        Parameter(symbol=m, value=MASS, unit="kg", lower=1e-6, description="mass of each disc"),
        Parameter(symbol=r, value=RADIUS, unit="m", lower=1e-6, description="radius of each disc"),
        Parameter(symbol=k, value=5000.0, unit="N/m", lower=1e-6, description="contact stiffness"),
    ]
    shapes = [
        Shape(name="disc 1", kind="disc", x=x1, y=y1, size=(r,)),
        Shape(name="disc 2", kind="disc", x=x2, y=y2, size=(r,)),
    ]
    start = (-1.0, -2.0, -1.0, -1.0)
    if wall:
        start = (0.25, -0.3, -0.5, 0.6)
        parameters.append(
            Parameter(symbol=y_w, value=WALL, unit="m", description="height of the wall")
        )
        for index, height in ((1, y1), (2, y2)):
            contacts.append(
                Contact(
                    name=f"wall_{index}",
                    bodies=(f"disc {index}", "wall"),
                    penetration=height + r - y_w,
                    stiffness=k,
                    depth=r,
                    depth_reason="the radius: there the centre of the disc is in the wall, and beyond it the nearer way out is behind it",
                    nominal=0.02,
                    description=f"disc {index} against the wall",
                )
            )
        shapes.append(Shape(name="wall", kind="wall", x=sp.Integer(0), y=y_w, size=(4.0,)))
    optimum, hit = (RIGID_OPTIMUM_WALL, RIGID_HIT_WALL) if wall else (RIGID_OPTIMUM, RIGID_HIT)
    return Scene(
        name=name,
        title="A disc is thrown at another, towards a goal" + (", off a wall" if wall else ""),
        source="Newton's second law; task after the two-ball examples of optimal control through contact (480 steps of 1/480 s, radius 0.2 m)",
        quick=False,  # its two pipelines find no throw
        coordinates=tuple(
            Coordinate(
                symbol=place,
                velocity=speed,
                unit="m",
                description=f"{axis} of the centre of disc {index}",
            )
            for place, speed, axis, index in zip(q, v, "xyxy", (1, 1, 2, 2), strict=True)
        ),
        inputs=(
            Input(
                symbol=ux, unit="N", lower=-50.0, upper=50.0, description="force on disc 1 along x"
            ),
            Input(
                symbol=uy, unit="N", lower=-50.0, upper=50.0, description="force on disc 1 along y"
            ),
        ),
        parameters=tuple(parameters),
        kinetic_energy=m * (vx1**2 + vy1**2 + vx2**2 + vy2**2) / 2,
        potential_energy=sp.Integer(0),
        forces=(ux, uy, sp.Integer(0), sp.Integer(0)),
        contacts=tuple(contacts),
        task=Task(
            start=(*start, 0.0, 0.0, 0.0, 0.0),
            goal=(None,) * 8,
            running_cost=WEIGHT * STEP * (ux**2 + uy**2),
            final_cost=x2**2 + y2**2,
            step=STEP,
            steps=STEPS,
        ),
        limits=limits(
            replay_cost=(
                hit,
                "the cheapest throw of rigid discs that brings disc 2 onto the goal itself: who pays more neither hits nor saves",
            ),
            law_error=(
                0.01,
                "a tenth of the width of the contact that matters: discs that glide 1 m after the impact must hit within 0.01 m",
            ),
            replay_error=(
                0.02,
                "the contact law's 0.01 m and as much for the grid: at 5 m/s a step of 1/480 s is 0.01 m long",
            ),
        ),
        answers=(
            Answer(
                quantity="least cost in the limit of rigid discs",
                value=optimum,
                tolerance=1e-7,
                source="minimum of the rigid cost over direction, time and speed of the impact, see the docstring",
            ),
        ),
        length=1.0,  # as in the paper
        shapes=tuple(shapes),
    )


SCENE = two_discs()

"""One disc is thrown at another, which then glides on and has to pass close by the goal when the time is over: elastic, without friction.

    two_discs()                                          # starts (-1, -2) and (-1, -1)
    # starts (0.25, -0.3) and (-0.5, 0.6), a wall at y = 1: off the wall, to the goal
    two_discs(wall=True)

The cost is |q2(T)|^2 + 0.01 int |u|^2 dt, with nothing asked of the end; disc 1 starts at rest and
must be at the right place of the rim of disc 2 with the right speed. As k grows the soft contact
tends to the impact of rigid discs. There, equal masses hand over the speed s along the line of
centres n, and the least work that brings disc 1 from rest to a place d away, with speed s along n
and any speed across, within time t is (per unit of mass and weight)

    12 (d.n)^2/t^3 - 12 (d.n) s/t^2 + 4 s^2/t + 3 |d - (d.n) n|^2/t^3

so that the optimum is a minimum over n, t and s alone: 0.3114169, and 0.3736364 with the wall, where
disc 2 heads for the goal's mirror image behind the line of its reflected centre, y = 1 - r.

To hold, a plan costs no more than the cheapest throw of rigid discs that brings disc 2 onto the
goal itself: 0.4079873, and 0.5911108 with the wall. Doing nothing costs the square of its distance
from there, 2 and 0.61.
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
# Centres closer than this [m] have no direction of contact between them: the distance sqrt(|q2 -
# q1|^2 + BLUR^2) is smooth even there, its gradient zero; where discs touch it is 1e-12 m off.
BLUR = 1e-6

x1, y1, x2, y2 = q = sp.symbols("x1 y1 x2 y2", real=True)
vx1, vy1, vx2, vy2 = v = sp.symbols("vx1 vy1 vx2 vy2", real=True)
ux, uy = sp.symbols("ux uy", real=True)
m, r, k, y_w = sp.symbols("m r k y_w", positive=True)


def two_discs(wall: bool = False, name: str = "two_discs") -> Scene:
    """The scene with or without the wall at y = 1."""
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
        length=1.0,  # the paper's metre
        shapes=tuple(shapes),
    )


SCENE = two_discs()

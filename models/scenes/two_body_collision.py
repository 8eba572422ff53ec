"""Two free masses collide through a linear spring, in closed form: restitution 1, momentum kept.

With mu = m1 m2/(m1 + m2) and the closing speed s:

    contact time         pi sqrt(mu/k)
    largest compression  s sqrt(mu/k)
    afterwards           v1' = v1 - 2 mu s/m1,   v2' = v2 + 2 mu s/m2
"""

import math

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Parameter, Scene, Shape, Task
from models.scene.parts import known_motion_limits, limits

q1, q2 = sp.symbols("q1 q2", real=True)
v1, v2 = sp.symbols("v1 v2", real=True)
m1, m2, k, r = sp.symbols("m1 m2 k r", positive=True)

MASS_1 = 1.0
MASS_2 = 3.0
STIFFNESS = 2000.0
RADIUS = 0.1
START = (0.0, 1.0, 2.0, -1.0)
CLOSING_SPEED = START[2] - START[3]
REDUCED_MASS = MASS_1 * MASS_2 / (MASS_1 + MASS_2)
FIRST_CONTACT = (START[1] - START[0] - 2 * RADIUS) / CLOSING_SPEED
CONTACT_TIME = math.pi * math.sqrt(REDUCED_MASS / STIFFNESS)
COMPRESSION = CLOSING_SPEED * math.sqrt(REDUCED_MASS / STIFFNESS)
V1_AFTER = START[2] - 2 * REDUCED_MASS * CLOSING_SPEED / MASS_1
V2_AFTER = START[3] + 2 * REDUCED_MASS * CLOSING_SPEED / MASS_2

SCENE = Scene(
    name="two_body_collision",
    title="Two free discs collide head-on",
    source="Newton's second law; the closed forms are derived in the docstring of this file",
    coordinates=(
        Coordinate(symbol=q1, velocity=v1, unit="m", description="position of the left disc"),
        Coordinate(symbol=q2, velocity=v2, unit="m", description="position of the right disc"),
    ),
    inputs=(),
    parameters=(
        Parameter(
            symbol=m1, value=MASS_1, unit="kg", lower=1e-6, description="mass of the left disc"
        ),
        Parameter(
            symbol=m2, value=MASS_2, unit="kg", lower=1e-6, description="mass of the right disc"
        ),
        Parameter(
            symbol=k, value=STIFFNESS, unit="N/m", lower=1e-6, description="contact stiffness"
        ),
        Parameter(symbol=r, value=RADIUS, unit="m", lower=1e-6, description="radius of each disc"),
    ),
    kinetic_energy=(m1 * v1**2 + m2 * v2**2) / 2,
    potential_energy=sp.Integer(0),
    forces=(sp.Integer(0), sp.Integer(0)),
    contacts=(
        Contact(
            name="pair",
            bodies=("left", "right"),
            penetration=2 * r - (q2 - q1),
            stiffness=k,
            depth=2 * r,
            depth_reason="two radii: there the centres of the discs coincide, and beyond it the line between them has turned over",
            nominal=0.05,
            description="left disc against right disc",
        ),
    ),
    task=Task(start=START, goal=(None,) * 4, running_cost=sp.Integer(0), step=0.001, steps=600),
    limits=(
        *known_motion_limits(
            "nothing drives and nothing dissipates: of the 3.5 J that the discs have, all is kept to what the replay resolves"
        ),
        *limits(
            replay_error=(
                0.003,
                "the first force comes up to one step of 1 ms late, in which the discs close by 3 mm; what is left of it is at most that",
            )
        ),
    ),
    answers=tuple(
        Answer(quantity=quantity, value=value, tolerance=1e-9, source=source, measure=measure)
        for quantity, value, source, measure in (
            (
                "contact time [s]",
                CONTACT_TIME,
                "half a period of the reduced mass on the spring",
                "contact time",
            ),
            ("largest compression [m]", COMPRESSION, "energy of the relative motion", "depth"),
            ("restitution", 1.0, "the spring is elastic", "restitution"),
            (
                "velocity of the left disc afterwards [m/s]",
                V1_AFTER,
                "momentum and energy kept",
                "",
            ),
            (
                "velocity of the right disc afterwards [m/s]",
                V2_AFTER,
                "momentum and energy kept",
                "",
            ),
        )
    ),
    shapes=(
        Shape(name="left", kind="disc", x=q1, y=r, size=(r,)),
        Shape(name="right", kind="disc", x=q2, y=r, size=(r,)),
    ),
)

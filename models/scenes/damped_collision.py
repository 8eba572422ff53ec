"""Two discs collide through a damped spring, and one hits a bumper: two laws in closed form.

Discs, Kelvin-Voigt, lam = max(k phi + c phi', 0). With mu = m1 m2/(m1 + m2), w = sqrt(k/mu),
z = c/(2 sqrt(k mu)) = cos(a), closing speed s: phi = s/(w sin a) exp(-z w t) sin(w t sin a)

    largest compression  s/w exp(-a/tan a)                       (phi' = 0 at w t sin a = a)
    restitution          e = exp(-2 a/tan a)                     (lam = 0 at w t sin a = 2 a)
    contact time         2 a/(w sin a) + 2 z/w                   (the discs part at e s)

With pulling the restitution is exp(-pi/tan a): 0.54 instead of 0.58. Bumper, Hunt-Crossley, lam =
b phi max(1 + d phi', 0): x - ln x = y - ln y, y = 1 + d v_in, x = 1 - d v_out = -W(-y exp(-y)).
"""

import math

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Parameter, Scene, Shape, Task
from models.scene.contacts import DampingLaw
from models.scene.parts import known_motion_limits, limits

q1, q2 = sp.symbols("q1 q2", real=True)
v1, v2 = sp.symbols("v1 v2", real=True)
m1, m2, k, c, b, d, r = sp.symbols("m1 m2 k c b d r", positive=True)

MASS_1 = 1.0
MASS_2 = 3.0
STIFFNESS = 2000.0
DAMPING = 15.0
BUMPER = 1000.0
BUMPER_DAMPING = 0.5
RADIUS = 0.1
START = (0.0, 1.0, 2.1, -1.0)
CLOSING_SPEED = START[2] - START[3]
REDUCED_MASS = MASS_1 * MASS_2 / (MASS_1 + MASS_2)
FIRST_CONTACT = (START[1] - START[0] - 2 * RADIUS) / CLOSING_SPEED
RATE = math.sqrt(STIFFNESS / REDUCED_MASS)
ANGLE = math.acos(DAMPING / (2 * math.sqrt(STIFFNESS * REDUCED_MASS)))
CONTACT_TIME = 2 * ANGLE / (RATE * math.sin(ANGLE)) + 2 * math.cos(ANGLE) / RATE
COMPRESSION = CLOSING_SPEED / RATE * math.exp(-ANGLE / math.tan(ANGLE))
RESTITUTION = math.exp(-2 * ANGLE / math.tan(ANGLE))
MEAN = (MASS_1 * START[2] + MASS_2 * START[3]) / (MASS_1 + MASS_2)
V1_BETWEEN = MEAN - REDUCED_MASS * RESTITUTION * CLOSING_SPEED / MASS_1
V2_AFTER = MEAN + REDUCED_MASS * RESTITUTION * CLOSING_SPEED / MASS_2
_Y = 1 - BUMPER_DAMPING * V1_BETWEEN
V1_AFTER = (1 + float(sp.LambertW(-_Y * math.exp(-_Y)))) / BUMPER_DAMPING
_SWING = "damped swing of the reduced mass until its force is gone, then free flight"

SCENE = Scene(
    name="damped_collision",
    title="Two discs collide, one is thrown onto a bumper: contacts with damping",
    source="Newton's second law; Hunt and Crossley (1975) for the bumper's law; the closed forms are derived in the docstring of this file",
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
            symbol=k,
            value=STIFFNESS,
            unit="N/m",
            lower=1e-6,
            description="stiffness between the discs",
        ),
        Parameter(
            symbol=c,
            value=DAMPING,
            unit="N s/m",
            lower=0.0,
            description="damping between the discs",
        ),
        Parameter(
            symbol=b, value=BUMPER, unit="N/m", lower=1e-6, description="stiffness of the bumper"
        ),
        Parameter(
            symbol=d,
            value=BUMPER_DAMPING,
            unit="s/m",
            lower=0.0,
            description="damping of the bumper",
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
            damping=c,
            depth=2 * r,
            depth_reason="two radii: there the centres of the discs coincide, and beyond it the line between them has turned over",
            nominal=0.05,
            description="left disc against right disc",
        ),
        Contact(
            name="bumper",
            bodies=("left", "bumper"),
            penetration=-(q1 + sp.Rational(1, 2) - r),
            stiffness=b,
            damping=d,
            damping_law=DampingLaw.HUNT_CROSSLEY,
            depth=r,
            depth_reason="the radius: there the centre of the disc is in the face of the bumper, and beyond it the nearer way out is behind it",
            nominal=0.05,
            description="left disc against the bumper at -0.5 m",
        ),
    ),
    task=Task(start=START, goal=(None,) * 4, running_cost=sp.Integer(0), step=0.001, steps=1200),
    limits=(
        *limits(
            **dict.fromkeys(
                ("ghost_impulse", "missed_impulse"),
                (
                    0.1,
                    "the push of the discs jumps to 46 N; it comes up to one step of 1 ms late, and goes as late: twice 46 mN s",
                ),
            )
        ),
        *known_motion_limits(
            "nothing drives: of the 3.7 J that the discs have, what the dampers do not take is kept to what the replay resolves"
        ),
        *limits(
            replay_error=(
                0.01,
                "the push of the discs jumps to 46 N and comes up to one step of 1 ms late: 0.05 m/s of the left disc, carried for 0.9 s; a quarter of that",
            )
        ),
    ),
    answers=tuple(
        Answer(quantity=quantity, value=value, tolerance=tolerance, source=source, measure=measure)
        for quantity, value, tolerance, source, measure in (
            ("contact time of the discs [s]", CONTACT_TIME, 1e-8, _SWING, "contact time"),
            (
                "restitution of the discs",
                RESTITUTION,
                1e-8,
                "the same swing, see the docstring",
                "restitution",
            ),
            (
                "time of the first contact [s]",
                FIRST_CONTACT,
                1e-9,
                "the discs are free until then",
                "closing time",
            ),
            (
                "largest compression of the discs [m]",
                COMPRESSION,
                1e-8,
                "the same swing, see the docstring",
                "",
            ),
            (
                "velocity of the right disc afterwards [m/s]",
                V2_AFTER,
                1e-8,
                "momentum kept, and the restitution",
                "",
            ),
            (
                "velocity of the left disc between its contacts [m/s]",
                V1_BETWEEN,
                1e-8,
                "momentum kept, and the restitution",
                "",
            ),
            (
                "velocity of the left disc after the bumper [m/s]",
                V1_AFTER,
                1e-8,
                "energy of the disc over the bumper's depth",
                "",
            ),
        )
    ),
    shapes=(
        Shape(name="left", kind="disc", x=q1, y=r, size=(r,)),
        Shape(name="right", kind="disc", x=q2, y=r, size=(r,)),
        Shape(
            name="bumper", kind="wall", x=sp.Rational(-1, 2), y=r, angle=sp.pi / 2, size=(4 * r,)
        ),
    ),
)

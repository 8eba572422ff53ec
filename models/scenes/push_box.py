"""A point finger pushes a box over a table to a goal that needs two faces or a turn.

The goal is 39.8 degrees off the left face's normal; the friction cone is atan(mu) = 26.6 degrees.
Friction under the box is the ellipsoid of Goyal, Ruina and Papadopoulos (1991) in linear form,
d v = F, d c^2 omega = torque, c the footprint's mean distance. The finger has such a damper too.
Without inertia this is M dv/dt = F - D v with M = tau D: tau is the time step of a plan, which
gives v' = D^-1 F, and nearly 0 for the judge (models.scene.quasi_static). The rim is D(p) = log(sum
of exp(beta d_i))/beta of the distances d_i from the faces; the slip is weighted by abs(grad D), as
the force is. Size, friction, step and horizon are from our scene bank; chosen: damping, rim, start,
goal, and k = 150 N/m for a stable step: h k/d (1 + (a/c)^2) + h k/d = 1.45 of at most 2.
"""

import math

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.contacts import Friction
from models.scene.parts import limits

STEP = 0.02
STEPS = 100
HALF_LENGTH = 0.5
HALF_WIDTH = 0.25
FRICTION = 0.5
DAMPING = 10.0
GOAL = (0.3, 0.25)

x, y, theta, p_x, p_y = q = sp.symbols("x y theta p_x p_y", real=True)
v_x, v_y, omega, w_x, w_y = v = sp.symbols("v_x v_y omega w_x w_y", real=True)
u_x, u_y = sp.symbols("u_x u_y", real=True)
a, b, c, d, beta, k, mu, tau = sp.symbols("a b c d beta k mu tau", positive=True)


def mean_distance(half_length: float, half_width: float) -> float:
    """Return the mean distance [m] of a rectangle's points from its centre, from half sides [m]."""
    s, w = half_length, half_width
    return (
        math.hypot(s, w) / 3
        + s**2 / (6 * w) * math.asinh(w / s)
        + w**2 / (6 * s) * math.asinh(s / w)
    )


# The finger and its velocity in the frame of the box.
_cos = sp.cos(theta)
_sin = sp.sin(theta)
_along = _cos * (p_x - x) + _sin * (p_y - y)
_across = _cos * (p_y - y) - _sin * (p_x - x)
_slip_along = _cos * (w_x - v_x) + _sin * (w_y - v_y) + omega * _across
_slip_across = _cos * (w_y - v_y) - _sin * (w_x - v_x) - omega * _along
_ends = 2 * sp.exp(-beta * a)
_sides = 2 * sp.exp(-beta * b)
_sum = _ends * sp.cosh(beta * _along) + _sides * sp.cosh(beta * _across)
_normal_along = _ends * sp.sinh(beta * _along) / _sum
_normal_across = _sides * sp.sinh(beta * _across) / _sum

SCENE = Scene(
    name="push_box",
    title="A finger pushes a box over a table, face by face",
    source="quasi-static pushing with an ellipsoidal limit surface, as the overdamped limit of Newton's second law (see the file)",
    quick=False,  # its two pipelines find no plan that holds on this grid
    unstable="a box pushed from behind turns away from the push, as one may try with a finger: a turn by da moves the centre of friction off the line of the push, which turns it further",
    coordinates=tuple(
        Coordinate(symbol=place, velocity=speed, unit=unit, description=words)
        for place, speed, unit, words in zip(
            q,
            v,
            ("m", "m", "rad", "m", "m"),
            (
                "x of the box",
                "y of the box",
                "turn of the box",
                "x of the finger",
                "y of the finger",
            ),
            strict=True,
        )
    ),
    inputs=(
        Input(
            symbol=u_x, unit="N", lower=-20.0, upper=20.0, description="force on the finger along x"
        ),
        Input(
            symbol=u_y, unit="N", lower=-20.0, upper=20.0, description="force on the finger along y"
        ),
    ),
    parameters=(
        Parameter(
            symbol=a,
            value=HALF_LENGTH,
            unit="m",
            lower=1e-3,
            description="half the length of the box",
        ),
        Parameter(symbol=b, value=HALF_WIDTH, unit="m", lower=1e-3, description="half its width"),
        Parameter(
            symbol=c,
            value=mean_distance(HALF_LENGTH, HALF_WIDTH),
            unit="m",
            lower=1e-3,
            description="mean distance of the footprint from its centre",
        ),
        Parameter(
            symbol=d,
            value=DAMPING,
            unit="N s/m",
            lower=1e-3,
            description="drag of the table, and of the finger's drive",
        ),
        Parameter(
            symbol=beta, value=20.0, unit="1/m", lower=1.0, description="sharpness of the corners"
        ),
        Parameter(symbol=k, value=150.0, unit="N/m", lower=1e-6, description="contact stiffness"),
        Parameter(
            symbol=mu,
            value=FRICTION,
            unit="1",
            lower=0.0,
            description="coefficient of friction, finger on box",
        ),
    ),
    relaxation_time=tau,
    kinetic_energy=tau * d * (v_x**2 + v_y**2 + c**2 * omega**2 + w_x**2 + w_y**2) / 2,
    potential_energy=sp.Integer(0),
    forces=(-d * v_x, -d * v_y, -d * c**2 * omega, u_x - d * w_x, u_y - d * w_y),
    contacts=(
        Contact(
            name="rim",
            bodies=("finger", "box"),
            penetration=-sp.log(_sum) / beta,
            stiffness=k,
            depth=b - 1 / beta,
            depth_reason="nearer than 1/beta to the middle line of the box its two long faces push against each other: the normal fades, and on the line turns over",
            nominal=0.02,
            description="finger against the box",
        ),
    ),
    frictions=(
        Friction(
            name="rim",
            slip=_normal_along * _slip_across - _normal_across * _slip_along,
            coefficient=mu,
            contact="rim",
            nominal=0.3,
            description="finger along the rim",
        ),
    ),
    task=Task(
        start=(0.0, 0.0, 0.0, -0.7, -0.4, 0.0, 0.0, 0.0, 0.0, 0.0),
        goal=(*GOAL, 0.0, None, None, None, None, None, None, None),
        running_cost=u_x**2 + u_y**2,
        step=STEP,
        steps=STEPS,
    ),
    limits=limits(
        terminal_position_error=(
            0.01,
            "a fortieth of the 0.39 m that the box has to go; as a turn 0.6 degrees",
        ),
        replay_terminal_position_error=(
            0.05,
            "the plan's limit plus 0.04 for the grid: a step of h = 0.02 s lets a finger at 0.4 m/s pass 8 mm before contact answers, and a box "
            "pushed off its centre turns with it",
        ),
        replay_error=(
            0.05,
            "as at the end: plans whose finger pushes or pulls at a distance leave theirs by more",
        ),
    ),
    answers=(
        Answer(
            quantity="least turn on the way with which one face alone can push the box to the goal [rad]",
            value=math.atan2(GOAL[1], GOAL[0]) - math.atan(FRICTION),
            tolerance=1e-9,
            source="the pushed centre moves along the force, which lies within atan(mu) of the normal of the face: the displacement cannot lie outside "
            "the cone that this sweeps",
        ),
    ),
    length=1.0,  # as in the paper
    shapes=(
        Shape(name="box", kind="box", x=x, y=y, size=(2 * a, 2 * b), angle=theta),
        Shape(name="finger", kind="disc", x=p_x, y=p_y, size=(0.02,)),
    ),
)

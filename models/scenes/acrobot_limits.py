"""A double pendulum balances upside down by elbow torque, with soft stops at the shoulder.

theta1 is the angle of the first link from upright, theta2 that of the second relative to it; point
masses are at the ends of massless links. The stops act at arc length l1 d of the elbow's circle,
with k_s/l1^2 per metre, hence k_s per radian. The start leans against the right stop.
Small errors about upright grow at the rates s of

    m1 m2 l1^2 l2^2 s^4 - (m1 + m2) m2 g l1 l2 (l1 + l2) s^2 + (m1 + m2) m2 g^2 l1 l2 = 0

The faster one is 9.01/s: a factor of eight thousand over the task's 1 s.
"""

import math

import sympy as sp
from sympy.simplify.fu import TR8  # products of sines and cosines -> sums

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.parts import limits

theta1, theta2 = sp.symbols("theta1 theta2", real=True)
omega1, omega2 = sp.symbols("omega1 omega2", real=True)
u = sp.Symbol("u", real=True)
m1, m2, l1, l2, g, k_s, d = sp.symbols("m1 m2 l1 l2 g k_s d", positive=True)

M1 = 0.5
M2 = 1.0
L1 = 0.5
L2 = 1.0
G = 9.81
_HALF = (M1 + M2) * (L1 + L2) / (2 * M1 * L1 * L2) * G
_PRODUCT = (M1 + M2) * G**2 / (M1 * L1 * L2)
FAST, SLOW = (math.sqrt(_HALF + sign * math.sqrt(_HALF**2 - _PRODUCT)) for sign in (1.0, -1.0))

ELBOW = (l1 * sp.sin(theta1), l1 * sp.cos(theta1))
TIP = (ELBOW[0] + l2 * sp.sin(theta1 + theta2), ELBOW[1] + l2 * sp.cos(theta1 + theta2))

_TURNED_OVER = "where the elbow hangs straight down it is as far from either stop: beyond, the shorter way back to the top is past the other one"


def _kinetic(mass: sp.Symbol, place: tuple[sp.Expr, sp.Expr]) -> sp.Expr:
    velocity = [
        sp.diff(entry, theta1) * omega1 + sp.diff(entry, theta2) * omega2 for entry in place
    ]
    return mass * (velocity[0] ** 2 + velocity[1] ** 2) / 2


SCENE = Scene(
    name="acrobot_limits",
    title="An acrobot balances between soft stops",
    source="Lagrange's equations of two point masses on links, derived by computer algebra from the energies in this file; lengths, masses and "
    "stops as in Aydinoglu et al., Contact-Aware Controller Design for Complementarity Systems",
    coordinates=(
        Coordinate(
            symbol=theta1,
            velocity=omega1,
            unit="rad",
            description="angle of the first link from upright",
        ),
        Coordinate(
            symbol=theta2,
            velocity=omega2,
            unit="rad",
            description="angle of the second link relative to the first",
        ),
    ),
    inputs=(
        Input(symbol=u, unit="N m", lower=-20.0, upper=20.0, description="torque at the elbow"),
    ),
    parameters=(
        Parameter(symbol=m1, value=M1, unit="kg", lower=1e-6, description="mass at the elbow"),
        Parameter(symbol=m2, value=M2, unit="kg", lower=1e-6, description="mass at the tip"),
        Parameter(
            symbol=l1, value=L1, unit="m", lower=1e-6, description="length of the first link"
        ),
        Parameter(
            symbol=l2, value=L2, unit="m", lower=1e-6, description="length of the second link"
        ),
        Parameter(symbol=g, value=G, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(
            symbol=k_s,
            value=1.0,
            unit="N m/rad",
            lower=1e-6,
            description="stiffness of the stops, at the shoulder",
        ),
        Parameter(
            symbol=d, value=0.2, unit="rad", lower=0.0, description="angle at which the stops begin"
        ),
    ),
    kinetic_energy=sp.expand(TR8(sp.expand(_kinetic(m1, ELBOW) + _kinetic(m2, TIP)))),
    potential_energy=g * (m1 * ELBOW[1] + m2 * TIP[1]),
    forces=(sp.Integer(0), u),
    contacts=tuple(
        Contact(
            name=side,
            bodies=("first link", "joint"),
            penetration=l1 * beyond,
            stiffness=k_s / l1**2,
            depth=l1 * (sp.pi - d),
            depth_reason=_TURNED_OVER,
            nominal=0.05,
            description=f"shoulder against its {side} stop",
        )
        for side, beyond in (("right", theta1 - d), ("left", -d - theta1))
    ),
    task=Task(
        start=(0.3, -0.5, 0.0, 0.0),
        goal=(0.0, 0.0, 0.0, 0.0),
        running_cost=u**2 / 1000,
        step=0.001,
        steps=1000,
    ),
    limits=limits(
        terminal_position_error=(
            0.01,
            "left alone for 0.1 s, 0.01 rad with 0.09 rad/s become 0.025 rad (9.01/s), an eighth of the way to the stops",
        ),
        terminal_velocity_error=(
            0.09,
            "grows to the same: the faster rate of 9.01/s times the 0.01 rad of the angles",
        ),
        replay_terminal_position_error=(
            0.05,
            "left alone for 0.1 s, 0.05 rad with 0.45 rad/s become 0.12 rad, still off the stops at 0.2 rad",
        ),
        replay_terminal_velocity_error=(
            0.45,
            "grows to the same: the faster rate of 9.01/s times the 0.05 rad of the angles",
        ),
        replay_error=(
            0.1,
            "half the way to the stops; the time step of 1 ms leaves the continuous motion by 0.027 rad at the end of a plan of 1 s, because this "
            "scene makes its error grow",
        ),
    ),
    answers=(
        Answer(
            quantity="faster growth rate of a small error about upright [1/s]",
            value=FAST,
            tolerance=1e-9,
            source="linearised by hand, see the docstring; checked on the derived equations",
        ),
        Answer(
            quantity="slower growth rate of a small error about upright [1/s]",
            value=SLOW,
            tolerance=1e-9,
            source="the same",
        ),
    ),
    length=1.0,  # as in the paper
    shapes=(
        Shape(
            name="first link",
            kind="line",
            x=ELBOW[0] / 2,
            y=ELBOW[1] / 2,
            size=(l1,),
            angle=sp.pi / 2 - theta1,
        ),
        Shape(
            name="second link",
            kind="line",
            x=(ELBOW[0] + TIP[0]) / 2,
            y=(ELBOW[1] + TIP[1]) / 2,
            size=(l2,),
            angle=sp.pi / 2 - theta1 - theta2,
        ),
    ),
)

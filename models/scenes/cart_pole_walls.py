"""A cart balances a pole between two soft walls: unstable, underactuated, nonlinear.

x is the place of the cart, theta the angle of the pole from upright, positive to the right. The
pole is a point mass on a massless rod; its tip x + l sin(theta) touches the walls at +-w. At rest
an input u stops the fall only if (m_c + m_p) g tan(|theta|) <= u, 0.36 rad for 4 N; the start leans
out further, so a wall must throw the pole back. The end costs 100 |x_T|^2 and must be upright.
Errors grow as exp(3.67 t), rate sqrt(g (m_c + m_p)/(l m_c)), a factor of 1500 over 2 s, so plans
need feedback. The step is coarse for the wall (h w = 0.9): an impact lasts 3.5 steps.
"""

import math

import sympy as sp
from sympy.simplify.fu import TR8  # products of sines and cosines -> sums

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.parts import limits

x, theta = sp.symbols("x theta", real=True)
vx, omega = sp.symbols("vx omega", real=True)
u = sp.Symbol("u", real=True)
m_c, m_p, l, g, k, w = sp.symbols("m_c m_p l g k w", positive=True)  # noqa: E741 - l is the field's name for a length

CART = 1.0
POLE = 0.1
LENGTH = 0.8
GRAVITY = 9.8
GROWTH = math.sqrt(GRAVITY * (CART + POLE) / (LENGTH * CART))

TIP = (x + l * sp.sin(theta), l * sp.cos(theta))
TIP_VELOCITY = [sp.diff(place, x) * vx + sp.diff(place, theta) * omega for place in TIP]
_CART_BEHIND = "the length of the pole: a tip that deep behind the wall has its cart behind it as well, which no wall holds"

SCENE = Scene(
    name="cart_pole_walls",
    title="A cart-pole balances between soft walls",
    source="Lagrange's equations of a cart and a point mass on a rod, derived by computer algebra from the energies in this file",
    quick=False,  # its two pipelines find no plan that holds on this grid
    unstable="a pole falls over: an error of its angle grows as exp(3.67 t), a thousand and a half times over the 2 s, whatever the plan",
    coordinates=(
        Coordinate(symbol=x, velocity=vx, unit="m", description="place of the cart"),
        Coordinate(
            symbol=theta, velocity=omega, unit="rad", description="angle of the pole from upright"
        ),
    ),
    inputs=(Input(symbol=u, unit="N", lower=-4.0, upper=4.0, description="force on the cart"),),
    parameters=(
        Parameter(symbol=m_c, value=CART, unit="kg", lower=1e-6, description="mass of the cart"),
        Parameter(
            symbol=m_p, value=POLE, unit="kg", lower=1e-6, description="mass at the end of the pole"
        ),
        Parameter(symbol=l, value=LENGTH, unit="m", lower=1e-6, description="length of the pole"),
        Parameter(symbol=g, value=GRAVITY, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(
            symbol=k, value=200.0, unit="N/m", lower=1e-6, description="stiffness of the walls"
        ),
        Parameter(
            symbol=w,
            value=1.0,
            unit="m",
            lower=0.0,
            description="distance of each wall from the middle",
        ),
    ),
    kinetic_energy=m_c * vx**2 / 2
    + m_p * sp.expand(TR8(sp.expand(TIP_VELOCITY[0] ** 2 + TIP_VELOCITY[1] ** 2))) / 2,
    potential_energy=m_p * g * TIP[1],
    forces=(u, sp.Integer(0)),
    contacts=tuple(
        Contact(
            name=side,
            bodies=("pole", f"{side} wall"),
            penetration=penetration,
            stiffness=k,
            depth=l,
            depth_reason=_CART_BEHIND,
            nominal=0.05,
            description=f"tip against the {side} wall",
        )
        for side, penetration in (("right", TIP[0] - w), ("left", -w - TIP[0]))
    ),
    task=Task(
        start=(0.3, 0.4, 0.0, 0.0),
        goal=(0.0, 0.0, 0.0, 0.0),
        running_cost=u**2 / 1000,
        final_cost=100 * (x**2 + theta**2 + vx**2 + omega**2),
        step=0.02,
        steps=100,
    ),
    limits=limits(
        feedback_share=(
            0.4,
            "an impact of three and a half steps throws the pole back a little differently than planned, and only the cart's force catches it: "
            "exact plans need 0.07 to 0.39 of their own inputs",
        ),
        terminal_position_error=(
            0.1,
            "0.1 m of the cart, or 0.1 rad of the pole, of the 0.36 rad from which the 4 N catch it again",
        ),
        terminal_velocity_error=(
            0.1,
            "the pole falls on by omega/3.67 s, 0.03 rad, of the 0.36 rad that the 4 N can hold",
        ),
        replay_terminal_position_error=(
            0.2,
            "from 0.2 rad the 4 N still catch the pole, which they do from 0.36 rad; an impact of three and a half steps alone leaves the cart up to 0.14 m off",
        ),
        replay_terminal_velocity_error=(
            0.2,
            "the pole falls on by omega/3.67 s, 0.05 rad: with the 0.2 rad of its angle still within the 0.36 rad that the 4 N can hold",
        ),
        replay_error=(
            0.2,
            "as at the end: an impact of three and a half steps throws the pole back a little differently than planned, measured up to 0.16 m for exact plans",
        ),
    ),
    answers=(
        Answer(
            quantity="growth rate of a small error about upright [1/s]",
            value=GROWTH,
            tolerance=1e-12,
            source="linearised about upright: theta'' = (m_c + m_p) g/(l m_c) theta; checked on the derived equations",
        ),
    ),
    length=1.0,  # as in the paper
    shapes=(
        Shape(name="cart", kind="box", x=x, y=sp.Float(-0.05), size=(0.3, 0.1)),
        Shape(
            name="pole",
            kind="line",
            x=x + l * sp.sin(theta) / 2,
            y=l * sp.cos(theta) / 2,
            size=(l,),
            angle=sp.pi / 2 - theta,
        ),
        Shape(name="right wall", kind="wall", x=w, y=l / 2, size=(2.0,), angle=sp.pi / 2),
        Shape(name="left wall", kind="wall", x=-w, y=l / 2, size=(2.0,), angle=sp.pi / 2),
    ),
)

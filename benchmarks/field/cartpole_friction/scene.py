"""A cart-pole with friction swings up: the task of the published problem, with the energies of its bodies.

x is the place of the cart, theta the angle of the pole from hanging. The pole is a point mass at the
end of a massless rod. Dry friction acts on the rail, by the weight of cart and pole, and in the
hinge, by the weight of the pole; the published problem takes both normal forces as constant.
"""

import sympy as sp

from models.scene import Coordinate, Friction, Input, Parameter, Scene, Shape, Task
from models.scene.parts import limits

x, theta = sp.symbols("x theta", real=True)
vx, omega = sp.symbols("vx omega", real=True)
u = sp.Symbol("u", real=True)
m_c, m_p, l, g = sp.symbols("m_c m_p l g", positive=True)  # noqa: E741 - the field's name
mu_rail, mu_hinge = sp.symbols("mu_rail mu_hinge", nonnegative=True)

TIP = (x + l * sp.sin(theta), -l * sp.cos(theta))
TIP_SPEED_SQUARED = vx**2 + 2 * l * sp.cos(theta) * vx * omega + l**2 * omega**2
_CATCH = (
    "10 N stop a pole at rest from falling up to 0.7 rad from upright; {} leaves a third of that "
    "for the other errors"
)

SCENE = Scene(
    name="scene",
    title="A cart-pole with friction in rail and hinge swings up",
    source="Lagrange's equations of a cart and a point mass on a rod; task and parameters of InteriorPointDDP.jl, experiments/ipopt/cartpole_friction.jl",
    unstable="an upright pole falls over: an error of its angle grows as exp(4.9 t)",
    coordinates=(
        Coordinate(symbol=x, velocity=vx, unit="m", description="place of the cart"),
        Coordinate(
            symbol=theta, velocity=omega, unit="rad", description="angle of the pole from hanging"
        ),
    ),
    inputs=(Input(symbol=u, unit="N", lower=-10.0, upper=10.0, description="force on the cart"),),
    parameters=(
        Parameter(symbol=m_c, value=1.0, unit="kg", lower=1e-6, description="mass of the cart"),
        Parameter(symbol=m_p, value=0.2, unit="kg", lower=1e-6, description="mass of the pole"),
        Parameter(symbol=l, value=0.5, unit="m", lower=1e-6, description="length of the pole"),
        Parameter(symbol=g, value=9.81, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(
            symbol=mu_rail, value=0.1, unit="1", lower=0.0, description="friction of the rail"
        ),
        Parameter(
            symbol=mu_hinge, value=0.1, unit="1", lower=0.0, description="friction of the hinge"
        ),
    ),
    kinetic_energy=m_c * vx**2 / 2 + m_p * TIP_SPEED_SQUARED / 2,
    potential_energy=m_p * g * TIP[1],
    forces=(u, sp.Integer(0)),
    contacts=(),
    frictions=(
        Friction(name="rail", slip=vx, coefficient=mu_rail, normal_force=(m_c + m_p) * g),
        Friction(name="hinge", slip=l * omega, coefficient=mu_hinge, normal_force=m_p * g),
    ),
    task=Task(
        start=(0.0, 0.0, 0.0, 0.0),
        goal=(0.0, sp.pi.evalf(), 0.0, 0.0),
        running_cost=u**2 / 2000,  # 0.01 h u^2 at the published step of 0.05 s
        final_cost=200 * (vx**2 + omega**2) + 700 * (x**2 + (theta - sp.pi) ** 2),
        step=0.05,
        steps=100,
    ),
    limits=limits(
        terminal_position_error=(0.01, "the published cost of the end leaves less than 1 mrad"),
        terminal_velocity_error=(0.01, "the published cost of the end leaves less than 1 mrad/s"),
        replay_error=(0.2, _CATCH.format("0.2 m or rad")),
        replay_terminal_position_error=(0.2, _CATCH.format("0.2 m or rad")),
        replay_terminal_velocity_error=(
            1.0,
            "the pole falls on by omega/4.9 s, 0.2 rad: with the 0.2 rad of its angle within the 0.7 rad that 10 N can hold",
        ),
    ),
    shapes=(
        Shape(name="cart", kind="box", x=x, y=sp.Float(0), size=(0.3, 0.1)),
        Shape(
            name="pole",
            kind="line",
            x=x + l * sp.sin(theta) / 2,
            y=-l * sp.cos(theta) / 2,
            size=(l,),
            angle=theta - sp.pi / 2,
        ),
    ),
)

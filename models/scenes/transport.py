"""Cargo lies on a driven cart and is moved by dry friction alone: stick carries it, slip shifts it, and nothing may creep.

The cart (2 kg) is driven, the cargo (1 kg) lies on it between two soft stops, one metre either side of the middle. The cargo starts 0.5 m
ahead of the cart's middle and has to end 0.5 m behind it: it must slip, by the right amount, and friction gives it at most mu g = 1.96 m/s^2.

Source: the equations are Lagrange's of two masses; masses, friction, half-length, grid, start and goal are those of the transport
benchmark of contact-implicit planning in our scene bank, whose weights (1e5, 1e5, 10, 10) on the end are replaced by the exact end itself;
R = 1e-4 weighs the force. Chosen here: the stops (k = 1000 N/m), so that the half-length is a contact like any other, and 40 N for the drive.

Regularised friction lets the cargo creep where dry friction holds it: what a plan gains by that is what the replay shows.
"""

import sympy as sp

from models.contacts import Friction
from models.scene import Answer, Contact, Coordinate, Input, Limit, Parameter, Scene, Shape, Task

cargo, cart = sp.symbols("cargo cart", real=True)
v_cargo, v_cart = sp.symbols("v_cargo v_cart", real=True)
u = sp.Symbol("u", real=True)
m, m_c, mu, g, half, k = sp.symbols("m m_c mu g half k", positive=True)

SCENE = Scene(
    name="transport",
    title="Cargo is carried and shifted by friction on a driven cart",
    source="Lagrange's equations of two masses; data of a transport benchmark with Coulomb friction (see the file)",
    coordinates=(
        Coordinate(symbol=cargo, velocity=v_cargo, unit="m", description="position of the cargo"),
        Coordinate(symbol=cart, velocity=v_cart, unit="m", description="position of the cart"),
    ),
    inputs=(Input(symbol=u, unit="N", lower=-40.0, upper=40.0, description="force on the cart"),),
    parameters=(
        Parameter(symbol=m, value=1.0, unit="kg", lower=1e-6, description="mass of the cargo"),
        Parameter(symbol=m_c, value=2.0, unit="kg", lower=1e-6, description="mass of the cart"),
        Parameter(symbol=mu, value=0.2, unit="1", lower=0.0, description="coefficient of friction"),
        Parameter(symbol=g, value=9.81, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(symbol=half, value=1.0, unit="m", lower=1e-6, description="half the length on which the cargo may lie"),
        Parameter(symbol=k, value=1000.0, unit="N/m", lower=1e-6, description="stiffness of the stops"),
    ),
    kinetic_energy=(m * v_cargo**2 + m_c * v_cart**2) / 2,
    potential_energy=sp.Integer(0),
    forces=(sp.Integer(0), u),
    contacts=(
        Contact(name="front", penetration=cargo - cart - half, stiffness=k, nominal=0.02, description="cargo against the front stop"),
        Contact(name="rear", penetration=cart - cargo - half, stiffness=k, nominal=0.02, description="cargo against the rear stop"),
    ),
    frictions=(
        Friction(name="belt", slip=v_cargo - v_cart, coefficient=mu, normal_force=m * g, nominal=0.1, description="cargo on the cart"),
    ),
    task=Task(
        start=(3.5, 3.0, -4.0, -4.0),
        goal=(-0.5, 0.0, -2.0, -2.0),
        running_cost=sp.Float("1e-4") * u**2,
        step=0.02,
        steps=200,
    ),
    limits=(
        Limit(
            metric="physics_scaled",
            value=1e-5,
            reason="averaged over the 4 s a product of 2.5e-6 (k L)^2, L = 0.02 m: a force of 30 mN at a closed gap, where a stop gives 20 N",
        ),
        Limit(metric="defect", value=1e-6, reason="a plan that misses its own time step by more than 1e-6 was not solved to the end"),
        Limit(metric="start_error", value=1e-6, reason="a plan from another start solves another task; 1e-6 is the solvers' own tolerance"),
        Limit(metric="bound_violation", value=1e-6, reason="the drive gives at most 40 N; 1e-6 is the solvers' own tolerance"),
        Limit(
            metric="friction_violation",
            value=1e-4,
            reason="mu N is 1.962 N; more than 0.1 mN above it is force that friction does not have",
        ),
        Limit(
            metric="friction_dissipation_error",
            value=2e-5,
            reason="20 microwatts: a creep of 0.01 mm/s under all of mu N, 0.04 mm over the 4 s",
        ),
        Limit(
            metric="discrete_terminal_error",
            value=0.05,
            reason="a twentieth of the metre by which the cargo is to be shifted, and of a metre a second",
        ),
        Limit(
            metric="replay_terminal_error",
            value=0.15,
            reason="the discrete limit plus 0.1 for the grid: at 4 m/s a step of 0.02 s is 0.08 m long",
        ),
    ),
    answers=(
        Answer(
            quantity="least time in which friction alone shifts the cargo's velocity from -4 to -2 m/s [s]",
            value=2.0 / (0.2 * 9.81),
            tolerance=1e-9,
            source="mu g is the largest acceleration of the cargo away from the stops",
        ),
    ),
    shapes=(
        Shape(name="cart", kind="box", x=cart, y=sp.Rational(-1, 10), size=(2 * half, sp.Rational(1, 5))),
        Shape(name="cargo", kind="box", x=cargo, y=sp.Rational(3, 20), size=(sp.Rational(3, 10), sp.Rational(3, 10))),
    ),
)

"""Cargo lies on a driven cart between two stops, and must slip by the right amount.

The cart has 2 kg, the cargo 1 kg; the stops are 1 m from the middle. The cargo moves from 0.5 m
ahead to 0.5 m behind; friction gives it at most mu g = 1.96 m/s^2. In the cheapest plan the rear
stop pushes with up to 56 N. Regularised friction lets the cargo creep, which the replay reveals.

Source: masses, friction, half-length, grid, start, goal and R = 1e-4 are those of the transport
    benchmark
of contact-implicit planning in our scene bank; its end weights (1e5, 1e5, 10, 10) are replaced by
the exact end. Chosen: stops of 1000 N/m, a drive of 40 N.
"""

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.contacts import Friction
from models.scene.parts import limits

cargo, cart = sp.symbols("cargo cart", real=True)
v_cargo, v_cart = sp.symbols("v_cargo v_cart", real=True)
u = sp.Symbol("u", real=True)
m, m_c, mu, g, half, k = sp.symbols("m m_c mu g half k", positive=True)
# Drawn length of the cargo [m].
CARGO = sp.Rational(3, 10)
_OFF_THE_CART = "half the length of the cargo: beyond it no part of the cargo lies on the cart, and its weight presses no longer"

SCENE = Scene(
    name="transport",
    title="Cargo is carried and shifted by friction and stops on a driven cart",
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
        Parameter(
            symbol=half,
            value=1.0,
            unit="m",
            lower=1e-6,
            description="half the length on which the cargo may lie",
        ),
        Parameter(
            symbol=k, value=1000.0, unit="N/m", lower=1e-6, description="stiffness of the stops"
        ),
    ),
    kinetic_energy=(m * v_cargo**2 + m_c * v_cart**2) / 2,
    potential_energy=sp.Integer(0),
    forces=(sp.Integer(0), u),
    contacts=tuple(
        Contact(
            name=end,
            bodies=("cargo", "cart"),
            penetration=penetration,
            stiffness=k,
            depth=CARGO / 2,
            depth_reason=_OFF_THE_CART,
            nominal=0.02,
            description=f"cargo against the {end} stop",
        )
        for end, penetration in (("front", cargo - cart - half), ("rear", cart - cargo - half))
    ),
    frictions=(
        Friction(
            name="belt",
            slip=v_cargo - v_cart,
            coefficient=mu,
            normal_force=m * g,
            nominal=0.1,
            description="cargo on the cart",
        ),
    ),
    task=Task(
        start=(3.5, 3.0, -4.0, -4.0),
        goal=(-0.5, 0.0, -2.0, -2.0),
        running_cost=sp.Float("1e-4") * u**2,
        step=0.02,
        steps=200,
    ),
    limits=limits(
        **dict.fromkeys(
            ("ghost_impulse", "missed_impulse"),
            (
                0.2,
                "half a step of the 20 N that a stop gives: where on the grid it comes and goes is chance",
            ),
        ),
        terminal_position_error=(
            0.05,
            "a twentieth of the metre by which the cargo is to be shifted",
        ),
        terminal_velocity_error=(
            0.05,
            "as fast the cargo shifts a twentieth of that metre in a second; one step of friction changes its speed by mu g h = 0.04 m/s",
        ),
        replay_terminal_position_error=(
            0.15,
            "the plan's limit plus 0.1 for the grid: at 4 m/s a step of 0.02 s is 0.08 m long",
        ),
        replay_terminal_velocity_error=(
            0.09,
            "the plan's limit plus one step of friction more or less, mu g h = 0.04 m/s",
        ),
        replay_error=(
            0.15,
            "as at the end: a step of 0.02 s is 0.08 m long at 4 m/s, by which the cargo meets a stop early or late; measured up to 0.12 m for exact plans",
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
    length=1.0,  # as in the paper
    shapes=(
        Shape(
            name="cart",
            kind="box",
            x=cart,
            y=sp.Rational(-1, 10),
            size=(2 * half, sp.Rational(1, 5)),
        ),
        Shape(name="cargo", kind="box", x=cargo, y=sp.Rational(3, 20), size=(CARGO, CARGO)),
    ),
)

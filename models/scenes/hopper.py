"""A vertical hopper: a body, a light foot on a driven springy leg, and a soft floor.

z is the height of the body, y that of the foot; the leg z - y has rest length l0, a spring and the
force u. Only weight and floor act on the whole, so

    floor's impulse = (m_b + m_f) g T + change of momentum

and a hop from rest to a higher rest 1 s later needs exactly (m_b + m_f) g T. Without input each
mode is linear, with an exact solution by matrix exponentials.
"""

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.parts import limits

z, y = sp.symbols("z y", real=True)
vz, vy = sp.symbols("vz vy", real=True)
u = sp.Symbol("u", real=True)
m_b, m_f, g, l0, k_l, k = sp.symbols("m_b m_f g l0 k_l k", positive=True)

BODY = 1.0
FOOT = 0.2
GRAVITY = 9.81
LEG = 1.0
STEP = 0.005
STEPS = 200
IMPULSE = (BODY + FOOT) * GRAVITY * STEP * STEPS

SCENE = Scene(
    name="hopper",
    title="A hopper jumps higher than it fell",
    source="Lagrange's equations of two masses and a spring, derived by computer algebra from the energies in this file",
    coordinates=(
        Coordinate(symbol=z, velocity=vz, unit="m", description="height of the body"),
        Coordinate(symbol=y, velocity=vy, unit="m", description="height of the foot"),
    ),
    inputs=(
        Input(
            symbol=u,
            unit="N",
            lower=-40.0,
            upper=40.0,
            description="push of the leg, beside its spring",
        ),
    ),
    parameters=(
        Parameter(symbol=m_b, value=BODY, unit="kg", lower=1e-6, description="mass of the body"),
        Parameter(symbol=m_f, value=FOOT, unit="kg", lower=1e-6, description="mass of the foot"),
        Parameter(symbol=g, value=GRAVITY, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(symbol=l0, value=LEG, unit="m", lower=1e-6, description="rest length of the leg"),
        Parameter(
            symbol=k_l, value=100.0, unit="N/m", lower=0.0, description="stiffness of the leg"
        ),
        Parameter(
            symbol=k, value=500.0, unit="N/m", lower=1e-6, description="stiffness of the floor"
        ),
    ),
    kinetic_energy=(m_b * vz**2 + m_f * vy**2) / 2,
    potential_energy=g * (m_b * z + m_f * y) + k_l * (z - y - l0) ** 2 / 2,
    forces=(u, -u),
    contacts=(
        Contact(
            name="floor",
            bodies=("foot", "floor"),
            penetration=-y,
            stiffness=k,
            depth=l0,
            depth_reason="the length of the leg at rest: a foot that deep has its body on the floor as well, which holds the foot alone",
            nominal=0.1,
            description="foot against floor",
        ),
    ),
    task=Task(
        start=(1.5, 0.5, 0.0, 0.0),
        goal=(1.8, 0.8, 0.0, 0.0),
        running_cost=u**2,
        step=STEP,
        steps=STEPS,
    ),
    limits=limits(
        terminal_position_error=(0.1, "a third of the 0.3 m that the hop has to win"),
        terminal_velocity_error=(
            0.1,
            "0.1 m/s at the top is 0.5 mm of height, and 4 mm of the foot's swing on its leg (24 rad/s)",
        ),
        replay_terminal_position_error=(0.1, "a third of the 0.3 m that the hop has to win"),
        replay_terminal_velocity_error=(
            0.3,
            "the plan's 0.1 m/s and 0.2 for the grid (exact plans end up to 0.16 m/s off): 0.3 m/s at the top is 5 mm of height, and 12 mm of the foot's swing on its leg",
        ),
        replay_error=(
            0.12,
            "three times what the time step of 5 ms leaves the continuous motion by under the true law (0.040 and 0.041 m for two exact plans: "
            "light foot and stiff floor swing at h w = 0.26); plans whose floor acts at a distance leave theirs by metres",
        ),
    ),
    answers=(
        Answer(
            quantity="impulse of the floor on every plan that reaches the goal [N s]",
            value=IMPULSE,
            tolerance=1e-9,
            source="momentum from rest to rest: (m_b + m_f) g T",
        ),
    ),
    length=1.0,  # as in the paper
    shapes=(
        Shape(name="body", kind="disc", x=sp.Integer(0), y=z, size=(0.15,)),
        Shape(name="leg", kind="line", x=sp.Integer(0), y=(z + y) / 2, size=(l0,), angle=sp.pi / 2),
        Shape(name="foot", kind="disc", x=sp.Integer(0), y=y, size=(0.05,)),
        Shape(name="floor", kind="wall", x=sp.Integer(0), y=sp.Integer(0), size=(2.0,)),
    ),
)

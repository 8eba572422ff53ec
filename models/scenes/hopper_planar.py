"""A planar hopper hops 2 m to the side: a body, a light foot on a springy leg, friction.

A thrust acts along the leg, with spring and damper, and a torque at the hip; the pitch must stay
small. Body and foot are points in Cartesian coordinates, so the mass matrix is constant. The foot's
plane is e = 1 cm from the hip's, so the leg sqrt(dx^2 + dz^2 + e^2) has no zero; the hip's power
hip (dz d(dx)/dt - dx d(dz)/dt - (dx^2 + dz^2) pitch rate)/leg^2 keeps the angular momentum. m = 1
kg, l0 = 1 m, h = 0.02 s, T = 200, (0, 1.5) -> (2, 1) are from our scene bank; chosen for the step:
a foot of 0.3 kg, floor 300 N/m, leg 100 N/m and 1 N s/m, so h w = 0.73 of at most 2. Errors grow at
sqrt(g/l0) = 3.1 1/s and at landings, by some 1e6 over 4 s: plans need feedback.
"""

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Scene, Shape, Task
from models.scene.contacts import Friction
from models.scene.parts import limits

BODY = 1.0
FOOT = 0.3
GRAVITY = 9.81
LEG = 1.0
STEP = 0.02
STEPS = 200

x, z, pitch, x_f, z_f = q = sp.symbols("x z pitch x_f z_f", real=True)
v_x, v_z, omega, v_xf, v_zf = v = sp.symbols("v_x v_z omega v_xf v_zf", real=True)
thrust, hip = sp.symbols("thrust hip", real=True)
m, m_f, inertia, g, l0, e, k_l, c_l, k, mu = sp.symbols(
    "m m_f inertia g l0 e k_l c_l k mu", positive=True
)

_dx = x - x_f
_dz = z - z_f
_leg = sp.sqrt(_dx**2 + _dz**2 + e**2)
_along = (
    thrust - c_l * (_dx * (v_x - v_xf) + _dz * (v_z - v_zf)) / _leg
) / _leg  # force per metre of (dx, dz)
_across = hip / _leg**2  # force per metre of (dz, -dx)
_force_x = _along * _dx + _across * _dz
_force_z = _along * _dz - _across * _dx

SCENE = Scene(
    name="hopper_planar",
    title="A hopper hops to the side",
    source="Lagrange's equations of two masses, a turning body and a spring, derived by computer algebra from the energies in this file",
    unstable="a body on one leg falls over, as exp(3.1 t) with sqrt(g/l0) = 3.1/s: 3e5 times over the 4 s if it stood all the while, and where the foot lands decides what follows",
    coordinates=tuple(
        Coordinate(symbol=place, velocity=speed, unit=unit, description=words)
        for place, speed, unit, words in zip(
            q,
            v,
            ("m", "m", "rad", "m", "m"),
            (
                "x of the body",
                "height of the body",
                "pitch of the body",
                "x of the foot",
                "height of the foot",
            ),
            strict=True,
        )
    ),
    inputs=(
        Input(
            symbol=thrust,
            unit="N",
            lower=-40.0,
            upper=40.0,
            description="push along the leg, beside its spring",
        ),
        Input(
            symbol=hip,
            unit="N m",
            lower=-10.0,
            upper=10.0,
            description="torque at the hip that turns the leg, and the body the other way",
        ),
    ),
    parameters=(
        Parameter(symbol=m, value=BODY, unit="kg", lower=1e-6, description="mass of the body"),
        Parameter(symbol=m_f, value=FOOT, unit="kg", lower=1e-6, description="mass of the foot"),
        Parameter(
            symbol=inertia,
            value=0.2,
            unit="kg m^2",
            lower=1e-6,
            description="moment of inertia of the body",
        ),
        Parameter(symbol=g, value=GRAVITY, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(symbol=l0, value=LEG, unit="m", lower=1e-6, description="rest length of the leg"),
        Parameter(
            symbol=e,
            value=0.01,
            unit="m",
            lower=1e-6,
            description="distance of the foot's plane from the hip's",
        ),
        Parameter(
            symbol=k_l, value=100.0, unit="N/m", lower=0.0, description="stiffness of the leg"
        ),
        Parameter(symbol=c_l, value=1.0, unit="N s/m", lower=0.0, description="damping of the leg"),
        Parameter(
            symbol=k, value=300.0, unit="N/m", lower=1e-6, description="stiffness of the floor"
        ),
        Parameter(
            symbol=mu,
            value=1.0,
            unit="1",
            lower=0.0,
            description="coefficient of friction, foot on floor",
        ),
    ),
    kinetic_energy=(m * (v_x**2 + v_z**2) + inertia * omega**2 + m_f * (v_xf**2 + v_zf**2)) / 2,
    potential_energy=g * (m * z + m_f * z_f) + k_l * (_leg - l0) ** 2 / 2,
    forces=(_force_x, _force_z, -_across * (_dx**2 + _dz**2), -_force_x, -_force_z),
    contacts=(
        Contact(
            name="floor",
            bodies=("foot", "floor"),
            penetration=-z_f,
            stiffness=k,
            depth=l0,
            depth_reason="the length of the leg at rest: a foot that deep has its body on the floor as well, which holds the foot alone",
            nominal=0.05,
            description="foot against floor",
        ),
    ),
    frictions=(
        Friction(
            name="floor",
            slip=v_xf,
            coefficient=mu,
            contact="floor",
            nominal=0.1,
            description="foot along the floor",
        ),
    ),
    task=Task(
        start=(0.0, 1.5, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0),
        goal=(2.0, 1.0, 0.0, 2.0, None, 0.0, 0.0, 0.0, 0.0, None),
        running_cost=thrust**2 + hip**2,
        step=STEP,
        steps=STEPS,
    ),
    limits=limits(
        feedback_share=(
            0.75,
            "the leg's spring pays for the hops: the plan's own inputs are 7 % of half their range, so that a share of them is next to nothing; exact plans "
            "need 0.34 to 0.66 of them (5 % of the half-range), averaged over a fiftieth of the plan",
        ),
        terminal_position_error=(
            0.05,
            "a fortieth of the 2 m; what the solvers leave (1e-9) grows 1e6 times in the open loop and is still far below",
        ),
        terminal_velocity_error=(
            0.05,
            "who falls over at sqrt(g/l0) = 3.1/s is carried another 0.05/3.1 = 0.016 m by it, a third of the position's limit",
        ),
        replay_terminal_position_error=(
            0.1,
            "a twentieth of the 2 m; at 3.6 m/s the foot lands up to 0.07 m early or late on a step of 0.02 s",
        ),
        replay_terminal_velocity_error=(
            0.3,
            "who falls over at sqrt(g/l0) = 3.1/s is carried another 0.3/3.1 = 0.1 m by it, the limit of the position",
        ),
        replay_error=(
            0.12,
            "1.7 times the 0.07 m of a step at landing speed; plans whose floor acts at a distance leave theirs by metres",
        ),
    ),
    answers=(
        Answer(
            quantity="impulse of floor against weight over the horizon, for body and foot from rest to rest [N s]",
            value=(BODY + FOOT) * GRAVITY * STEP * STEPS,
            tolerance=1e-9,
            source="momentum: (m + m_f) g T",
        ),
    ),
    quick=False,
    length=1.0,  # as in the paper
    shapes=(
        Shape(name="body", kind="box", x=x, y=z, size=(0.4, 0.2), angle=-pitch),
        Shape(
            name="leg",
            kind="line",
            x=(x + x_f) / 2,
            y=(z + z_f) / 2,
            size=(l0,),
            angle=sp.atan2(_dz, _dx),
        ),
        Shape(name="foot", kind="disc", x=x_f, y=z_f, size=(0.05,)),
        Shape(name="floor", kind="wall", x=sp.Integer(1), y=sp.Integer(0), size=(4.0,)),
    ),
)

"""A mass falls on a spring floor and bounces forever, without input and damping, in closed form.

With w = sqrt(k/m) and the speed s at the floor (s^2 = 2 g q(0) from rest):

    largest depth   m g/k + sqrt((m g/k)^2 + s^2 m/k)
    contact time    (2 pi - 2 atan2(s/w, m g/k))/w

In contact the mass swings about its static depth m g/k, and leaves at the same speed.
"""

import math

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Limit, Parameter, Scene, Shape, Task
from models.scene.parts import known_motion_limits

q, v = sp.symbols("q v", real=True)
m, g, k = sp.symbols("m g k", positive=True)

MASS = 1.0
GRAVITY = 9.81
STIFFNESS = 1000.0
DROP = 0.5
SAG = MASS * GRAVITY / STIFFNESS
SPEED = math.sqrt(2 * GRAVITY * DROP)
RATE = math.sqrt(STIFFNESS / MASS)
DEPTH = SAG + math.hypot(SAG, SPEED / RATE)
CONTACT_TIME = (2 * math.pi - 2 * math.atan2(SPEED / RATE, SAG)) / RATE
FALL_TIME = SPEED / GRAVITY

SCENE = Scene(
    name="bouncing_mass",
    title="A mass bounces on a spring floor",
    source="Newton's second law; the closed forms are derived in the docstring of this file",
    coordinates=(
        Coordinate(
            symbol=q,
            velocity=v,
            unit="m",
            nominal=0.5,
            description="height of the mass above the floor",
        ),
    ),
    inputs=(),
    parameters=(
        Parameter(symbol=m, value=MASS, unit="kg", lower=1e-6, description="mass"),
        Parameter(symbol=g, value=GRAVITY, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(
            symbol=k, value=STIFFNESS, unit="N/m", lower=1e-6, description="stiffness of the floor"
        ),
    ),
    kinetic_energy=m * v**2 / 2,
    potential_energy=m * g * q,
    forces=(sp.Integer(0),),
    contacts=(
        Contact(
            name="floor",
            bodies=("mass", "floor"),
            penetration=-q,
            stiffness=k,
            depth=DROP,
            depth_reason="the springs of the floor, chosen here to be as long as the mass falls, 0.5 m, are pressed flat",
            nominal=0.1,
            description="mass against floor",
        ),
    ),
    task=Task(
        start=(DROP, 0.0), goal=(None,) * 2, running_cost=sp.Integer(0), step=0.001, steps=1000
    ),
    limits=(
        *known_motion_limits(
            "nothing drives and nothing dissipates: of the 4.9 J that the mass has, all is kept to what the replay resolves"
        ),
        Limit(
            metric="replay_error",
            value=0.005,
            reason="the time step of 1 ms is g t h/2 = 1.6 mm off when the mass has fallen for t = 0.32 s, and keeps that over the one bounce; three times that",
        ),
    ),
    answers=(
        Answer(
            quantity="largest depth [m]",
            value=DEPTH,
            tolerance=1e-9,
            source="energy balance, see the docstring",
            measure="depth",
        ),
        Answer(
            quantity="contact time [s]",
            value=CONTACT_TIME,
            tolerance=1e-9,
            source="harmonic motion about the static depth",
            measure="contact time",
        ),
        Answer(
            quantity="time of the first contact [s]",
            value=FALL_TIME,
            tolerance=1e-9,
            source="free fall",
            measure="closing time",
        ),
    ),
    shapes=(
        Shape(name="mass", kind="disc", x=sp.Integer(0), y=q, size=(0.05,)),
        Shape(name="floor", kind="wall", x=sp.Integer(0), y=sp.Integer(0), size=(1.0,)),
    ),
)

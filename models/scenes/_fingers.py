"""Equations of two planar fingers and a disc, shared by `two_finger` and `two_finger_lift`.

A finger is two uniform bars (length l, width w, mass m_l), hinged at a base `reach` from the middle
and at an elbow. Angles are absolute: 0 points at the other finger, pi/2 up. With the angle a
    between
its links and c = l^2 + w^2 (a bar's squared diagonal)

    M = m_l [[c/12 + l^2/4 + l^2,  l^2/2 cos a],  [l^2/2 cos a,  c/12 + l^2/4]]
    phi = R + w/2 - d,      d = sqrt(|disc - tip|^2 + BLUR^2)      (BLUR: see `two_discs`)

The surfaces meet at the shares R : w/2 of d, so friction keeps the angular momentum
    (`tip_frictions`).
"""

from __future__ import annotations

import math

import sympy as sp

from models.scene import Answer, Contact, Coordinate, Input, Parameter, Shape
from models.scene.contacts import Friction

BLUR = 1e-6
NEAR = 0.002
LENGTH = 0.1
WIDTH = 0.02
LINK_MASS = 0.1
RADIUS = 0.05
BASE = 0.13
DAMPING = 1.0
STIFFNESS = 100.0

ANGLES = (left1, left2, right1, right2) = sp.symbols("left1 left2 right1 right2", real=True)
RATES = (w_left1, w_left2, w_right1, w_right2) = sp.symbols(
    "w_left1 w_left2 w_right1 w_right2", real=True
)
x, y, theta = sp.symbols("x y theta", real=True)
vx, vy, w_theta = sp.symbols("vx vy w_theta", real=True)
TORQUES = (u_left1, u_left2, u_right1, u_right2) = sp.symbols(
    "u_left1 u_left2 u_right1 u_right2", real=True
)
long, w, m_l, m_d, R, reach, c_d, k = sp.symbols("l w m_l m_d R reach c_d k", positive=True)

Q = (*ANGLES, x, y, theta)
V = (*RATES, vx, vy, w_theta)
# side -> (sign of its base's x and of its sense of rotation, angles).
_SIDES = {"left": (-1, (left1, left2)), "right": (1, (right1, right2))}


def joints(side: str) -> tuple[tuple[sp.Expr, sp.Expr], ...]:
    """Return base, elbow and tip of a finger [m]."""
    sign, (first, second) = _SIDES[side]
    base = (sign * reach, sp.Integer(0))
    elbow = (base[0] - sign * long * sp.cos(first), base[1] + long * sp.sin(first))
    tip = (elbow[0] - sign * long * sp.cos(second), elbow[1] + long * sp.sin(second))
    return base, elbow, tip


def _rate(expression: sp.Expr) -> sp.Expr:
    return sum(
        (sp.diff(expression, position) * velocity for position, velocity in zip(Q, V, strict=True)),
        start=sp.Integer(0),
    )


def _middle(
    one: tuple[sp.Expr, sp.Expr], other: tuple[sp.Expr, sp.Expr]
) -> tuple[sp.Expr, sp.Expr]:
    return (one[0] + other[0]) / 2, (one[1] + other[1]) / 2


def bars() -> list[tuple[tuple[sp.Expr, sp.Expr], sp.Symbol]]:
    """Return centre [m] and angle of the four links."""
    links = []
    for side, (_, angles) in _SIDES.items():
        base, elbow, tip = joints(side)
        links += [(_middle(base, elbow), angles[0]), (_middle(elbow, tip), angles[1])]
    return links


def kinetic_energy() -> sp.Expr:
    """Return the energy of four bars and a uniform disc [J].

    The centre of a second link moves with l w1 and long/2 w2, at the links' relative angle.
    """
    energy = m_d * (vx**2 + vy**2) / 2 + m_d * R**2 / 2 * w_theta**2 / 2
    for (first, second), (w_first, w_second) in ((ANGLES[:2], RATES[:2]), (ANGLES[2:], RATES[2:])):
        speeds = (
            long**2 / 4 * w_first**2,
            long**2 * w_first**2
            + long**2 / 4 * w_second**2
            + long**2 * w_first * w_second * sp.cos(first - second),
        )
        energy += (
            m_l * sum(speeds) / 2 + m_l * (long**2 + w**2) / 12 * (w_first**2 + w_second**2) / 2
        )
    return energy


def forces() -> tuple[sp.Expr, ...]:
    """Return the generalised forces.

    The disc has drag c_d, and torque c_d R^2 per rad/s by the same drag at its rim.
    """
    return (
        u_left1 - u_left2,
        u_left2,
        u_right1 - u_right2,
        u_right2,
        -c_d * vx,
        -c_d * vy,
        -c_d * R**2 * w_theta,
    )


def _centres(side: str) -> tuple[sp.Expr, sp.Expr, sp.Expr]:
    """Return the vector from the tip to the centre of the disc (2), and its length [m]."""
    tip = joints(side)[2]
    along = (x - tip[0], y - tip[1])
    return (*along, sp.sqrt(along[0] ** 2 + along[1] ** 2 + BLUR**2))


def running_cost(x_goal: float, y_goal: float, pull: float) -> sp.Expr:
    """Return squared torques plus `pull` [1/m] times the goal distance, smooth within NEAR."""
    return sum(torque**2 for torque in TORQUES) + pull * sp.sqrt(
        (x - x_goal) ** 2 + (y - y_goal) ** 2 + NEAR**2
    )


def tip_contacts(nominal: float) -> tuple[Contact, ...]:
    return tuple(
        Contact(
            name=side,
            bodies=(f"{side} tip", "disc"),
            penetration=R + w / 2 - _centres(side)[2],
            stiffness=k,
            depth=R,
            depth_reason="the radius of the disc: there the rim of the tip has reached its centre, and soon nothing tells on which side the tip is",
            nominal=nominal,
            description=f"{side} finger tip against the disc",
        )
        for side in _SIDES
    )


def tip_frictions(coefficient: sp.Expr, nominal: float) -> tuple[Friction, ...]:
    """Return Coulomb friction between tip and disc.

    slip = t . (v_disc - v_tip) - d (R omega_disc + w/2 omega_tip)/(R + w/2), the velocity of the
    disc's surface relative to the tip's along t, the line of centres turned left.
    """
    frictions = []
    for side, (sign, angles) in _SIDES.items():
        dx, dy, distance = _centres(side)
        tip = joints(side)[2]
        across = (dx * (vy - _rate(tip[1])) - dy * (vx - _rate(tip[0]))) / distance
        turning = distance * (R * w_theta - sign * w / 2 * _rate(angles[1])) / (R + w / 2)
        frictions.append(
            Friction(
                name=side,
                slip=across - turning,
                coefficient=coefficient,
                contact=side,
                nominal=nominal,
                description=f"{side} finger tip along the rim of the disc",
            )
        )
    return tuple(frictions)


def coordinates() -> tuple[Coordinate, ...]:
    names = [
        f"angle of the {part} link of the {side} finger, inwards"
        for side in _SIDES
        for part in ("first", "second")
    ]
    turning = tuple(
        Coordinate(symbol=angle, velocity=rate, unit="rad", description=text)
        for angle, rate, text in zip(ANGLES, RATES, names, strict=True)
    )
    return (
        *turning,
        Coordinate(
            symbol=x, velocity=vx, unit="m", nominal=0.1, description="x of the centre of the disc"
        ),
        Coordinate(
            symbol=y, velocity=vy, unit="m", nominal=0.1, description="y of the centre of the disc"
        ),
        Coordinate(symbol=theta, velocity=w_theta, unit="rad", description="angle of the disc"),
    )


def inputs(largest: float) -> tuple[Input, ...]:
    names = [
        f"torque at the {joint} of the {side} finger"
        for side in _SIDES
        for joint in ("base", "elbow")
    ]
    return tuple(
        Input(symbol=torque, unit="N m", lower=-largest, upper=largest, description=text)
        for torque, text in zip(TORQUES, names, strict=True)
    )


def parameters(disc_mass: float) -> tuple[Parameter, ...]:
    return (
        Parameter(
            symbol=long, value=LENGTH, unit="m", lower=1e-3, description="length of each link"
        ),
        Parameter(
            symbol=w,
            value=WIDTH,
            unit="m",
            lower=1e-4,
            description="width of each link, twice the radius of a tip",
        ),
        Parameter(
            symbol=m_l, value=LINK_MASS, unit="kg", lower=1e-6, description="mass of each link"
        ),
        Parameter(
            symbol=m_d, value=disc_mass, unit="kg", lower=1e-6, description="mass of the disc"
        ),
        Parameter(symbol=R, value=RADIUS, unit="m", lower=1e-3, description="radius of the disc"),
        Parameter(
            symbol=reach,
            value=BASE,
            unit="m",
            lower=1e-3,
            description="distance of each base from the middle",
        ),
        Parameter(
            symbol=c_d, value=DAMPING, unit="N s/m", lower=0.0, description="damping of the disc"
        ),
        Parameter(
            symbol=k,
            value=STIFFNESS,
            unit="N/m",
            lower=1e-6,
            description="stiffness of the finger tips",
        ),
    )


def pinch(gap: float, height: float) -> tuple[float, float, float, float]:
    """Return the four angles with tips at `height` and `gap` [m] from a disc in the middle.

    The elbows point outwards.
    """
    across, up = BASE - RADIUS - WIDTH / 2 - gap, height
    direction, half = math.atan2(up, across), math.acos(math.hypot(across, up) / (2 * LENGTH))
    outwards = math.copysign(half, up)
    first, second = direction + outwards, direction - outwards
    return first, second, first, second


def stretched_answer() -> Answer:
    return Answer(
        quantity="moment of inertia of a stretched finger about its base [kg m^2]",
        value=2 * LINK_MASS * ((2 * LENGTH) ** 2 / 3 + WIDTH**2 / 12),
        tolerance=1e-15,
        source="one uniform bar of twice the length and mass, turned about its end; checked on the derived mass matrix",
    )


def shapes() -> tuple[Shape, ...]:
    parts = [Shape(name="disc", kind="disc", x=x, y=y, size=(R,))]
    spoke = (x + R / 2 * sp.cos(theta), y + R / 2 * sp.sin(theta))
    parts.append(
        Shape(name="mark on the disc", kind="line", x=spoke[0], y=spoke[1], size=(R,), angle=theta)
    )
    for (centre, angle), side in zip(bars(), ("left", "left", "right", "right"), strict=True):
        part = "first" if angle in (left1, right1) else "second"
        turned = angle if side == "left" else sp.pi - angle
        parts.append(
            Shape(
                name=f"{side} {part} link",
                kind="box",
                x=centre[0],
                y=centre[1],
                size=(long, w),
                angle=turned,
            )
        )
    for side in _SIDES:
        tip = joints(side)[2]
        parts.append(Shape(name=f"{side} tip", kind="disc", x=tip[0], y=tip[1], size=(w / 2,)))
    return tuple(parts)

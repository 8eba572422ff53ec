"""Scenes whose bodies turn, as MJCF bodies and what touches on them, by their names; every number is a parameter of the scene.

A body has the name of its first joint. MJCF's hinges turn a body relative to the one that carries it: `joints` says how the scene's angles become theirs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from models.scene import Scene

_TINY, _BALL = 1e-12, 0.1


@dataclass(frozen=True, kw_only=True)
class Pad:
    """What touches, in the frame of its body (empty: the ground) [m]: a ball by its centre and radius, or where that is 0 a plane by a point and its normal."""

    body: str
    at: tuple[float, ...]
    radius: float = 0.0
    normal: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Tree:
    """bodies: MJCF; pads by contact; gravity [m/s^2]; joints: q of the joints = joints @ q of the scene, (nq, nq), None: the same."""

    bodies: str
    pads: Mapping[str, tuple[Pad, Pad]] = field(default_factory=dict)
    gravity: float = 0.0
    joints: np.ndarray | None = None


def _numbers(scene: Scene) -> dict[str, float]:
    return {parameter.name: parameter.value for parameter in scene.parameters}


def _body(name: str, inside: str, *, at: str = "0 0 0", joints: str | None = None) -> str:
    """A body on a hinge about y, or on the joints that are given."""
    turning = f'<joint name="{name}" type="hinge" axis="0 1 0"/>' if joints is None else joints
    return f'<body name="{name}" pos="{at}">{turning}{inside}</body>'


def _point(mass: float, height: float) -> str:
    """A point mass above the joint of its body; MJCF wants some inertia of each."""
    return f'<inertial pos="0 0 {height!r}" mass="{mass!r}" diaginertia="{_TINY} {_TINY} {_TINY}"/>'


def _cart_pole(scene: Scene) -> Tree:
    """A cart on a slide, a point at the end of a rod on it, and two planes that the tip alone touches."""
    p = _numbers(scene)
    pole = _body("theta", _point(p["m_p"], p["l"]))
    tip = Pad(body="theta", at=(0.0, 0.0, p["l"]), radius=_BALL)
    pads = {}
    for name, side in (("right", 1.0), ("left", -1.0)):
        pads[name] = tip, Pad(body="", at=(side * (p["w"] + _BALL), 0.0, 0.0), normal=(-side, 0.0, 0.0))
    cart = _body("x", _point(p["m_c"], 0.0) + pole, joints='<joint name="x" type="slide" axis="1 0 0"/>')
    return Tree(bodies=cart, pads=pads, gravity=p["g"])


def _acrobot(scene: Scene) -> Tree:
    """Two points at the ends of rods, each on a hinge; its stops act on the shoulder's angle, and no ball touches anything."""
    p = _numbers(scene)
    second = _body("theta2", _point(p["m2"], p["l2"]), at=f"0 0 {p['l1']!r}")
    return Tree(bodies=_body("theta1", _point(p["m1"], p["l1"]) + second), gravity=p["g"])


def _fingers(scene: Scene) -> Tree:
    """Two fingers of two bars and a disc, upright: x to the right, z up, hinges about y. A bar lies along x; the right finger is the left one's mirror image."""
    p = _numbers(scene)
    long, w, radius, table = p["l"], p["w"], p["R"], p.get("y_t")
    found, pads = "", {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        square = p["m_l"] * (long**2 + w**2) / 12
        bar = f'<inertial pos="{sign * long / 2!r} 0 0" mass="{p["m_l"]!r}" diaginertia="{square} {square} {square}"/>'
        hinge = [f'<joint name="{side}{number}" type="hinge" axis="0 {-sign} 0"/>' for number in (1, 2)]
        link = _body(f"{side}2", bar, at=f"{sign * long!r} 0 0", joints=hinge[1])
        found += _body(f"{side}1", bar + link, at=f"{-sign * p['reach']!r} 0 0", joints=hinge[0])
        tip = Pad(body=f"{side}2", at=(sign * long, 0.0, 0.0), radius=w / 2)
        pads[side] = (tip, Pad(body="x", at=(0.0, 0.0, 0.0), radius=radius))
    slides = '<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 0 1"/><joint name="theta" type="hinge" axis="0 -1 0"/>'
    turning = p["m_d"] * radius**2 / 2
    found += _body("x", f'<inertial pos="0 0 0" mass="{p["m_d"]!r}" diaginertia="{turning} {turning} {turning}"/>', joints=slides)
    if table is not None:
        pads["table"] = (pads["left"][1], Pad(body="", at=(0.0, 0.0, -table), normal=(0.0, 0.0, 1.0)))
    joints = np.eye(scene.nq)
    joints[1, 0] = joints[3, 2] = -1.0  # the scene's angles are absolute, a hinge's relative
    return Tree(bodies=found, pads=pads, gravity=p.get("g", 0.0), joints=joints)


TREES = {"cart_pole_walls": _cart_pole, "acrobot_limits": _acrobot, "two_finger": _fingers, "two_finger_lift": _fingers}

"""A scene as bodies on joints, forces, and contacts between balls and planes, in numbers.

    mechanism = mechanism_of(scene)      # CannotExpressError for an unsupported scene
    mechanism.bodies                     # MJCF worldbody; joints have the names of coordinates
    mechanism.touches[0].pads            # ball and plane, or two balls

All numbers come from the scene's energies, forces and contacts. Each coordinate is a sliding body
or an axis of one; turning bodies are written out in `TREES`. Engines compute contacts; springs,
dampers and inputs act as forces.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import sympy as sp

from models.dynamics import derive
from models.scene import Contact, Scene
from models.scene.contacts import DampingLaw, Friction
from validate.judge.engines.simulator import CannotExpressError

# Radius of a ball that slides along a plane [m]; the motion does not depend on it.
_BALL = 0.1
# Inertia of massless bodies [kg m^2], because MJCF requires some.
_TINY = 1e-12


@dataclass(frozen=True, kw_only=True)
class Pad:
    """A ball (centre, radius), or a plane (point, normal) of radius 0, in its body's frame [m].

    Body "" is the ground.
    """

    body: str
    at: tuple[float, ...]
    radius: float = 0.0
    normal: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Touch:
    """A contact: gap = normal @ q - offset, or distance of centres - offset, or that of pads.

    - offset, stiffness, damping: in the scene's units.
    - normal (nq,), slip (nq,): direction of slip, if constant.
    - centres: the coordinates (x, y) of each body.
    - steepness: gap per distance of the pads; without pads `why` has the reason.
    """

    name: str
    normal: np.ndarray
    offset: float
    stiffness: float
    damping: float
    law: DampingLaw
    friction: float = 0.0
    slip: np.ndarray | None = None
    centres: tuple[tuple[int, int], tuple[int, int]] | None = None
    pads: tuple[Pad, Pad] | None = None
    steepness: float = 1.0
    why: str = ""

    @property
    def stops(self) -> bool:
        """Return whether the contact acts on coordinates alone, without damping and friction."""
        return self.pads is None and bool(self.normal.any()) and not (self.damping or self.friction)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rub:
    """Dry friction under a constant weight [N]: slip = direction @ v, direction (nq,)."""

    name: str
    direction: np.ndarray
    coefficient: float
    pressed: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Mechanism:
    """Bodies, forces, contacts and friction of a scene.

    - bodies: MJCF; gravity [m/s^2], downwards.
    - joints (nq, nq): q of joints = joints @ q of scene.
    - forces: smooth ones per coordinate in the symbols q, v, u.
    - weights: joint, force [N] and start [m] of each rub with a pressed body.
    """

    bodies: str
    gravity: float
    joints: np.ndarray
    forces: tuple[sp.Expr, ...]
    symbols: tuple[Sequence[sp.Symbol], ...]
    touches: tuple[Touch, ...]
    rubs: tuple[Rub, ...]
    weights: tuple[tuple[str, float, float], ...] = ()

    @property
    def steady(self) -> bool:
        """Return whether the smooth forces depend on inputs alone."""
        return not set().union(*(force.free_symbols for force in self.forces)) & {
            *self.symbols[0],
            *self.symbols[1],
        }

    def smooth(self, modules: Any = "math", *, stops: bool = False) -> Callable[..., list[float]]:
        """Return a function of q, v of the joints and u giving the smooth forces on the joints.

        modules: for `lambdify`; stops: include their forces. Raises nothing.
        """
        (q, v, u), forces = self.symbols, sp.Matrix(self.forces)
        for touch in self.touches if stops else ():
            if touch.stops:
                depth = touch.offset - sum(
                    slope * symbol for slope, symbol in zip(touch.normal, q, strict=True)
                )
                forces += touch.stiffness * sp.Max(depth, 0) * sp.Matrix(touch.normal)
        back = (
            sp.Matrix(np.linalg.inv(self.joints).tolist())
            if (self.joints != np.eye(len(q))).any()
            else sp.eye(len(q))
        )
        turned = dict(zip((*q, *v), (*(back * sp.Matrix(q)), *(back * sp.Matrix(v))), strict=True))
        return sp.lambdify(
            [*q, *v, *u], list((back.T * forces).subs(turned, simultaneous=True)), modules
        )


def mechanism_of(scene: Scene, *, weights: bool = False) -> Mechanism:
    """Return the mechanism of a scene [SI].

    weights: turn friction under a constant weight into a body pressed on a plane, for engines
    without joint friction. Raises CannotExpressError naming the unsupported part.
    """
    dynamics, values = derive(scene), scene.parameter_values
    symbols, tree = (dynamics.q, dynamics.v, dynamics.u), TREES.get(scene.name)
    forces = [force.subs(values) for force in scene.forces]
    touches, rubs = _with_friction(
        scene, [_touch(scene, contact, tree is not None) for contact in scene.contacts]
    )
    if tree is not None:
        turning = tree(scene)
        return Mechanism(
            bodies=turning.bodies, gravity=turning.gravity,
            joints=np.eye(scene.nq) if turning.joints is None else turning.joints, forces=tuple(forces),
            symbols=symbols,
            touches=tuple(replace(touch, pads=turning.pads.get(touch.name),
                                  why="its joints have no stops") for touch in touches), rubs=rubs,
        )  # fmt: skip
    if not (dynamics.structure.constant_mass and dynamics.structure.diagonal_mass):
        raise CannotExpressError(
            "its masses do not each move along a coordinate of their own (the mass matrix is no constant diagonal)"
        )
    potential = dynamics.potential_energy.subs(values)
    forces = [
        force - sp.diff(potential, symbol) for force, symbol in zip(forces, dynamics.q, strict=True)
    ]
    masses = [float(dynamics.mass_matrix[i, i].subs(values)) for i in range(scene.nq)]
    slides = _Slides(scene, masses, touches, rubs)
    pressed = [slides.press(rub) for rub in rubs] if weights else []
    return Mechanism(
        bodies=slides.text(), gravity=0.0, joints=np.eye(scene.nq), forces=tuple(forces),
        symbols=symbols,
        touches=(*(slides.padded(touch) for touch in touches), *(touch for touch, _ in pressed)),
        rubs=rubs, weights=tuple(weight for _, weight in pressed),
    )  # fmt: skip


class _Slides:
    """Bodies on slides from the origin: the axes of each body, and its pads."""

    def __init__(
        self, scene: Scene, masses: Sequence[float], touches: Sequence[Touch], rubs: Sequence[Rub]
    ) -> None:
        self.names = [coordinate.name for coordinate in scene.coordinates]
        self.masses, self.touches, self.extra = masses, touches, {}
        self.axis = dict.fromkeys(range(scene.nq), 0)
        self.owner = list(range(scene.nq))
        # For each rubbing contact the body under it (None: the ground).
        self.under: dict[str, int | None] = {}
        for touch in touches:
            for x, y in touch.centres or ():
                self._join(x, y, 1)
        for friction in scene.frictions:
            for contact in friction.pressing:
                slip, touch = (
                    _slip(scene, friction),
                    next(touch for touch in touches if touch.name == contact),
                )
                pressed, along = np.flatnonzero(touch.normal), np.flatnonzero(slip > 0.0)
                if len(pressed) != 1 or len(along) != 1 or along[0] == pressed[0]:
                    raise CannotExpressError(
                        f"friction {friction.name} is pressed by a contact of more than one coordinate"
                    )
                self._join(int(along[0]), int(pressed[0]), 2)
                below = np.flatnonzero(slip < 0.0)
                self.under[contact] = int(below[0]) if len(below) else None

    def _join(self, one: int, other: int, axis: int) -> None:
        first, second = sorted((self.owner[one], self.owner[other]))
        self.owner = [first if item == second else item for item in self.owner]
        self.axis[other] = axis

    def _body(self, coordinate: int | None) -> str:
        return "" if coordinate is None else self.names[self.owner[coordinate]]

    def padded(self, touch: Touch) -> Touch:
        """Return the contact with the balls and planes of its gap, if any."""
        if touch.centres is not None:
            # The offset is the sum of both radii; each ball gets half.
            balls = tuple(
                Pad(body=self._body(centre[0]), at=(0.0, 0.0, 0.0), radius=touch.offset / 2)
                for centre in touch.centres
            )
            return replace(touch, pads=(balls[0], balls[1]))
        moved = np.flatnonzero(touch.normal)
        slopes = touch.normal[moved]
        if (
            len(moved) > 2
            or not len(moved)
            or (
                len(moved) == 2
                and (slopes.sum() != 0.0 or self.axis[moved[0]] != self.axis[moved[1]])
            )
        ):
            return replace(touch, why="its gap is no distance of two bodies on one line")
        side, steepness = float(np.sign(slopes[0])), float(abs(slopes[0]))
        other = int(moved[1]) if len(moved) == 2 else self.under.get(touch.name)
        along = np.eye(3)[self.axis[int(moved[0])]]
        ball = Pad(body=self._body(int(moved[0])), at=tuple(side * _BALL * along), radius=_BALL)
        plane = Pad(
            body=self._body(other),
            at=tuple(side * touch.offset / steepness * along),
            normal=tuple(side * along),
        )
        return replace(touch, pads=(ball, plane), steepness=steepness)

    def press(self, rub: Rub) -> tuple[Touch, tuple[str, float, float]]:
        """Return a contact for a weight, as stiff as the scene's stiffest, with its joint.

        The joint: name, force [N], start in balance [m].
        """
        over, below = (np.flatnonzero(sign * rub.direction > 0.0) for sign in (1.0, -1.0))
        stiffness = max((touch.stiffness for touch in self.touches), default=1e4)
        body, joint = self._body(int(over[0])), f"weight_{rub.name}"
        self.extra[body] = joint
        ball = Pad(body=body, at=(0.0, 0.0, _BALL), radius=_BALL)
        plane = Pad(
            body=self._body(int(below[0]) if len(below) else None),
            at=(0.0, 0.0, 0.0),
            normal=(0.0, 0.0, 1.0),
        )
        touch = Touch(
            name=joint, normal=np.zeros(len(self.names)), offset=0.0, stiffness=stiffness,
            damping=0.0, law=DampingLaw.KELVIN_VOIGT,
            friction=rub.coefficient, pads=(ball, plane),
        )  # fmt: skip
        return touch, (joint, -rub.pressed, -rub.pressed / stiffness)

    def text(self) -> str:
        bodies = ""
        for first in dict.fromkeys(self.owner):
            axes = [place for place, item in enumerate(self.owner) if item == first]
            mass = self.masses[first]
            if not np.allclose([self.masses[place] for place in axes], mass, rtol=1e-12):
                raise CannotExpressError("a body has another mass in each direction")
            joints = [(self.names[place], self.axis[place]) for place in axes]
            joints += (
                [(self.extra[self.names[first]], 2)] if self.names[first] in self.extra else []
            )
            slides = "".join(
                f'<joint name="{name}" type="slide" axis="{["1 0 0", "0 1 0", "0 0 1"][axis]}"/>'
                for name, axis in joints
            )
            bodies += f'<body name="{self.names[first]}">{slides}<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/></body>'
        return bodies


def _affine(
    expression: sp.Expr, symbols: Sequence[sp.Symbol], otherwise: str
) -> tuple[np.ndarray, float]:
    """Return slopes (symbols,) and value at zero of an affine expression.

    Raises CannotExpressError(otherwise).
    """
    slopes = [sp.diff(sp.expand(expression), symbol) for symbol in symbols]
    if set().union(*(slope.free_symbols for slope in slopes)):
        raise CannotExpressError(otherwise)
    return np.array(slopes, dtype=float), float(expression.subs(dict.fromkeys(symbols, 0)))


def _touch(scene: Scene, contact: Contact, is_tree: bool) -> Touch:
    values = scene.parameter_values
    q = [coordinate.symbol for coordinate in scene.coordinates]
    penetration = contact.penetration.subs(values)
    touch = Touch(
        name=contact.name, normal=np.zeros(scene.nq), offset=0.0,
        stiffness=float(contact.stiffness.subs(values)),
        damping=float(contact.damping.subs(values)), law=contact.damping_law,
    )  # fmt: skip
    distances = [item for item in penetration.atoms(sp.Pow) if item.exp == sp.Rational(1, 2)]
    if not is_tree and len(distances) == 1 and not (penetration + distances[0]).free_symbols:
        return replace(
            touch,
            offset=float(penetration + distances[0]),
            centres=_centres(contact, distances[0], q),
        )
    try:
        slope, rest = _affine(
            penetration,
            q,
            f"the gap of contact {contact.name} is neither linear nor the distance of two centres",
        )
    except CannotExpressError:
        if is_tree:
            return touch
        raise
    return replace(touch, normal=-slope, offset=rest)


def _centres(
    contact: Contact, distance: sp.Expr, q: Sequence[sp.Symbol]
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the coordinates of two centres at this distance, sqrt(dx^2 + dy^2 + constant)."""
    form = np.array(sp.hessian(sp.expand(distance**2), list(q)) / 2)
    pairs = [(i, j) for i in range(len(q)) for j in range(i + 1, len(q)) if form[i, j] == -1]
    if len(pairs) != 2 or any(form[place, place] != 1 for pair in pairs for place in pair):
        raise CannotExpressError(
            f"the distance of contact {contact.name} is not that of two centres in the plane"
        )
    (x1, x2), (y1, y2) = pairs
    return (x1, y1), (x2, y2)


def _slip(scene: Scene, friction: Friction) -> np.ndarray:
    v = [item.velocity for item in scene.coordinates]
    otherwise = f"the direction of friction {friction.name} depends on the positions"
    return _affine(friction.slip.subs(scene.parameter_values), v, otherwise)[0]


def _with_friction(scene: Scene, touches: list[Touch]) -> tuple[tuple[Touch, ...], tuple[Rub, ...]]:
    """Add friction coefficients to pressing contacts; return constant-weight friction as rubs."""
    values, by_name = scene.parameter_values, {touch.name: touch for touch in touches}
    rubs = []
    for friction in scene.frictions:
        coefficient = float(friction.coefficient.subs(values))
        if friction.pressing:
            slip = None
            with contextlib.suppress(CannotExpressError):
                slip = _slip(scene, friction)
            for contact in friction.pressing:
                by_name[contact] = replace(by_name[contact], friction=coefficient, slip=slip)
            continue
        pressed = sp.S.Zero if friction.normal_force is None else friction.normal_force.subs(values)
        if pressed.free_symbols:
            raise CannotExpressError(
                f"what presses friction {friction.name} depends on the positions without being a contact"
            )
        rubs.append(
            Rub(
                name=friction.name,
                direction=_slip(scene, friction),
                coefficient=coefficient,
                pressed=float(pressed),
            )
        )
    return tuple(by_name.values()), tuple(rubs)


# Scenes with turning bodies. A body has the name of its first joint. MJCF hinges are relative to
# the carrying body; `Tree.joints` converts the scene's angles.


@dataclass(frozen=True, kw_only=True, eq=False)
class Tree:
    """MJCF bodies, pads by contact, gravity [m/s^2].

    joints (nq, nq): q of joints = joints @ q of scene, None: identity.
    """

    bodies: str
    pads: Mapping[str, tuple[Pad, Pad]] = field(default_factory=dict)
    gravity: float = 0.0
    joints: np.ndarray | None = None


def _numbers(scene: Scene) -> dict[str, float]:
    return {parameter.name: parameter.value for parameter in scene.parameters}


def _body(name: str, inside: str, *, at: str = "0 0 0", joints: str | None = None) -> str:
    turning = f'<joint name="{name}" type="hinge" axis="0 1 0"/>' if joints is None else joints
    return f'<body name="{name}" pos="{at}">{turning}{inside}</body>'


def _point(mass: float, height: float) -> str:
    return f'<inertial pos="0 0 {height!r}" mass="{mass!r}" diaginertia="{_TINY} {_TINY} {_TINY}"/>'


def _cart_pole(scene: Scene) -> Tree:
    """A cart on a slide, a point mass on a rod, and two planes that only the tip touches."""
    p = _numbers(scene)
    pole = _body("theta", _point(p["m_p"], p["l"]))
    tip = Pad(body="theta", at=(0.0, 0.0, p["l"]), radius=_BALL)
    pads = {}
    for name, side in (("right", 1.0), ("left", -1.0)):
        pads[name] = (
            tip,
            Pad(body="", at=(side * (p["w"] + _BALL), 0.0, 0.0), normal=(-side, 0.0, 0.0)),
        )
    cart = _body(
        "x", _point(p["m_c"], 0.0) + pole, joints='<joint name="x" type="slide" axis="1 0 0"/>'
    )
    return Tree(bodies=cart, pads=pads, gravity=p["g"])


def _acrobot(scene: Scene) -> Tree:
    """Two point masses on hinged rods; stops act on the shoulder's angle, without pads."""
    p = _numbers(scene)
    second = _body("theta2", _point(p["m2"], p["l2"]), at=f"0 0 {p['l1']!r}")
    return Tree(bodies=_body("theta1", _point(p["m1"], p["l1"]) + second), gravity=p["g"])


def _fingers(scene: Scene) -> Tree:
    """Two fingers of two bars and a disc: x right, z up, hinges about y.

    A bar lies along x; the right finger mirrors the left one.
    """
    p = _numbers(scene)
    long, w, radius, table = p["l"], p["w"], p["R"], p.get("y_t")
    bodies, pads = "", {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        square = p["m_l"] * (long**2 + w**2) / 12
        bar = f'<inertial pos="{sign * long / 2!r} 0 0" mass="{p["m_l"]!r}" diaginertia="{square} {square} {square}"/>'
        hinge = [
            f'<joint name="{side}{number}" type="hinge" axis="0 {-sign} 0"/>' for number in (1, 2)
        ]
        link = _body(f"{side}2", bar, at=f"{sign * long!r} 0 0", joints=hinge[1])
        bodies += _body(f"{side}1", bar + link, at=f"{-sign * p['reach']!r} 0 0", joints=hinge[0])
        tip = Pad(body=f"{side}2", at=(sign * long, 0.0, 0.0), radius=w / 2)
        pads[side] = (tip, Pad(body="x", at=(0.0, 0.0, 0.0), radius=radius))
    slides = '<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 0 1"/><joint name="theta" type="hinge" axis="0 -1 0"/>'
    turning = p["m_d"] * radius**2 / 2
    bodies += _body(
        "x",
        f'<inertial pos="0 0 0" mass="{p["m_d"]!r}" diaginertia="{turning} {turning} {turning}"/>',
        joints=slides,
    )
    if table is not None:
        pads["table"] = (
            pads["left"][1],
            Pad(body="", at=(0.0, 0.0, -table), normal=(0.0, 0.0, 1.0)),
        )
    joints = np.eye(scene.nq)
    joints[1, 0] = joints[3, 2] = -1.0  # the scene's angles are absolute, hinge angles relative
    return Tree(bodies=bodies, pads=pads, gravity=p.get("g", 0.0), joints=joints)


TREES = {
    "cart_pole_walls": _cart_pole,
    "acrobot_limits": _acrobot,
    "two_finger": _fingers,
    "two_finger_lift": _fingers,
}

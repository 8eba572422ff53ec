"""A scene as other simulators can be told it: bodies on joints, forces, and contacts between balls and planes, with numbers for coefficients.

    # raises CannotExpressError, in a sentence, for a scene that is no such thing
    mechanism = mechanism_of(scene)
    # the bodies as the worldbody of an MJCF text: joints have the names of coordinates
    mechanism.bodies
    mechanism.touches[0].pads                # the ball and the plane, or the two balls, that meet

Every number is derived from the scene's own energies, forces and contacts; nothing is typed twice.
Each coordinate is a body that slides, or one of the axes of a body: a disc has two, and so has what
rubs on something. Scenes whose bodies turn are written out below (`TREES`). An engine makes the
contacts; what is smooth - springs, dampers, inputs - acts on it as forces.
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
from validate.judge.simulator import CannotExpressError

# Radius of a ball that slides along a plane [m]: nothing depends on it.
_BALL = 0.1
# Inertia of what has none: MJCF wants some of each [kg m^2].
_TINY = 1e-12


@dataclass(frozen=True, kw_only=True)
class Pad:
    """What touches, in the frame of its body (empty: the ground) [m]: a ball by its centre and radius, or where that is 0 a plane by a point and its normal."""

    body: str
    at: tuple[float, ...]
    radius: float = 0.0
    normal: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Touch:
    """A contact: gap = normal @ q - offset, or with centres the distance of those two bodies less offset; with neither only its pads tell.

    normal (nq,); offset, stiffness, damping in the scene's units; law of its damping; friction: its
        coefficient; slip (nq,): its direction, where that is constant; centres: the coordinates (x,
        y) of each body;
    pads: what meets, steepness: the gap's change over that of their distance; without pads `why`
        says why.
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
        """Whether it acts on coordinates alone: without pads, damping and friction."""
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
    """See the module docstring.

    bodies: their MJCF text; gravity [m/s^2], downwards; joints: q of the joints = joints @ q of the
        scene, (nq, nq); forces: the smooth ones on each coordinate, by
    the symbols q, v, u; weights: joint and force [N] of each rub that was given a body of its own
        to press.
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
        """Whether the smooth forces depend on inputs alone."""
        return not set().union(*(force.free_symbols for force in self.forces)) & {
            *self.symbols[0],
            *self.symbols[1],
        }

    def smooth(self, modules: Any = "math", *, stops: bool = False) -> Callable[..., list[float]]:
        """The smooth forces on the joints, with those of stops or without, in the arithmetic of `modules`, of q, v of the joints and u one by one. Raises nothing."""
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
    """The mechanism of a scene.

    Parameters
    ----------
    scene
        With numbers for its parameters.
    weights
        Whether what rubs under a constant weight becomes a body that is pressed on a plane, for
        engines without dry friction on joints.

    Returns
    -------
    Mechanism
        All in SI units [SI].

    Raises
    ------
    CannotExpressError
        With a sentence that says which part of the scene is no part of a mechanism.
    """
    dynamics, values = derive(scene), scene.parameter_values
    symbols, tree = (dynamics.q, dynamics.v, dynamics.u), TREES.get(scene.name)
    forces = [force.subs(values) for force in scene.forces]
    touches, rubs = _with_friction(
        scene, [_touch(scene, contact, tree is not None) for contact in scene.contacts]
    )
    if tree is not None:
        found = tree(scene)
        return Mechanism(
            bodies=found.bodies, gravity=found.gravity,
            joints=np.eye(scene.nq) if found.joints is None else found.joints, forces=tuple(forces),
            symbols=symbols,
            touches=tuple(replace(touch, pads=found.pads.get(touch.name),
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
    """Bodies on slides, all from the origin: which coordinates are axes of one body, along what, and what they are padded with."""

    def __init__(
        self, scene: Scene, masses: Sequence[float], touches: Sequence[Touch], rubs: Sequence[Rub]
    ) -> None:
        self.names = [coordinate.name for coordinate in scene.coordinates]
        self.masses, self.touches, self.extra = masses, touches, {}
        self.axis = dict.fromkeys(range(scene.nq), 0)
        self.owner = list(range(scene.nq))
        # Which coordinate a rubbing contact slides along, and which body (None: the ground) is
        # under it.
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
        """With the balls and planes of its gap, where there are some."""
        if touch.centres is not None:
            # The smaller of two balls stands for both in their sum; each gets half.
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
        """The contact that stands for a weight, upright, as stiff as the stiffest of the scene.

        Its joint, its force [N] and where it starts in balance [m].
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
        """Their MJCF. Raises CannotExpressError."""
        found = ""
        for first in dict.fromkeys(self.owner):
            own = [place for place, item in enumerate(self.owner) if item == first]
            mass = self.masses[first]
            if not np.allclose([self.masses[place] for place in own], mass, rtol=1e-12):
                raise CannotExpressError("a body has another mass in each direction")
            joints = [(self.names[place], self.axis[place]) for place in own]
            joints += (
                [(self.extra[self.names[first]], 2)] if self.names[first] in self.extra else []
            )
            slides = "".join(
                f'<joint name="{name}" type="slide" axis="{["1 0 0", "0 1 0", "0 0 1"][axis]}"/>'
                for name, axis in joints
            )
            found += f'<body name="{self.names[first]}">{slides}<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/></body>'
        return found


def _affine(
    expression: sp.Expr, symbols: Sequence[sp.Symbol], otherwise: str
) -> tuple[np.ndarray, float]:
    """Slopes (symbols,) and value at zero of an expression that is affine in the symbols.

    Raises CannotExpressError with the words of `otherwise`.
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
    """The coordinates of two centres whose distance this is: sqrt((x2 - x1)^2 + (y2 - y1)^2), but for what blurs it."""
    form = np.array(sp.hessian(sp.expand(distance**2), list(q)) / 2)
    pairs = [(i, j) for i in range(len(q)) for j in range(i + 1, len(q)) if form[i, j] == -1]
    if len(pairs) != 2 or any(form[place, place] != 1 for pair in pairs for place in pair):
        raise CannotExpressError(
            f"the distance of contact {contact.name} is not that of two centres in the plane"
        )
    (x1, x2), (y1, y2) = pairs
    return (x1, y1), (x2, y2)


def _slip(scene: Scene, friction: Friction) -> np.ndarray:
    """Its direction, (nq,) [-]."""
    v = [item.velocity for item in scene.coordinates]
    otherwise = f"the direction of friction {friction.name} depends on the positions"
    return _affine(friction.slip.subs(scene.parameter_values), v, otherwise)[0]


def _with_friction(scene: Scene, touches: list[Touch]) -> tuple[tuple[Touch, ...], tuple[Rub, ...]]:
    """Frictions as coefficients of the contacts that press them, or as rubs under a constant weight."""
    values, found = scene.parameter_values, {touch.name: touch for touch in touches}
    rubs = []
    for friction in scene.frictions:
        coefficient = float(friction.coefficient.subs(values))
        if friction.pressing:
            slip = None
            with contextlib.suppress(CannotExpressError):
                slip = _slip(scene, friction)
            for contact in friction.pressing:
                found[contact] = replace(found[contact], friction=coefficient, slip=slip)
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
    return tuple(found.values()), tuple(rubs)


# Scenes whose bodies turn. A body has the name of its first joint. MJCF's hinges turn a body
# relative to the one that carries it: `joints` says how the scene's angles become theirs.


@dataclass(frozen=True, kw_only=True, eq=False)
class Tree:
    """bodies: MJCF; pads by contact; gravity [m/s^2].

    joints: q of the joints = joints @ q of the scene, (nq, nq), None: the same.
    """

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
        pads[name] = (
            tip,
            Pad(body="", at=(side * (p["w"] + _BALL), 0.0, 0.0), normal=(-side, 0.0, 0.0)),
        )
    cart = _body(
        "x", _point(p["m_c"], 0.0) + pole, joints='<joint name="x" type="slide" axis="1 0 0"/>'
    )
    return Tree(bodies=cart, pads=pads, gravity=p["g"])


def _acrobot(scene: Scene) -> Tree:
    """Two points at the ends of rods, each on a hinge.

    Its stops act on the shoulder's angle, and no ball touches anything.
    """
    p = _numbers(scene)
    second = _body("theta2", _point(p["m2"], p["l2"]), at=f"0 0 {p['l1']!r}")
    return Tree(bodies=_body("theta1", _point(p["m1"], p["l1"]) + second), gravity=p["g"])


def _fingers(scene: Scene) -> Tree:
    """Two fingers of two bars and a disc, upright: x to the right, z up, hinges about y.

    A bar lies along x; the right finger is the left one's mirror image.
    """
    p = _numbers(scene)
    long, w, radius, table = p["l"], p["w"], p["R"], p.get("y_t")
    found, pads = "", {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        square = p["m_l"] * (long**2 + w**2) / 12
        bar = f'<inertial pos="{sign * long / 2!r} 0 0" mass="{p["m_l"]!r}" diaginertia="{square} {square} {square}"/>'
        hinge = [
            f'<joint name="{side}{number}" type="hinge" axis="0 {-sign} 0"/>' for number in (1, 2)
        ]
        link = _body(f"{side}2", bar, at=f"{sign * long!r} 0 0", joints=hinge[1])
        found += _body(f"{side}1", bar + link, at=f"{-sign * p['reach']!r} 0 0", joints=hinge[0])
        tip = Pad(body=f"{side}2", at=(sign * long, 0.0, 0.0), radius=w / 2)
        pads[side] = (tip, Pad(body="x", at=(0.0, 0.0, 0.0), radius=radius))
    slides = '<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 0 1"/><joint name="theta" type="hinge" axis="0 -1 0"/>'
    turning = p["m_d"] * radius**2 / 2
    found += _body(
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
    joints[1, 0] = joints[3, 2] = -1.0  # the scene's angles are absolute, a hinge's relative
    return Tree(bodies=found, pads=pads, gravity=p.get("g", 0.0), joints=joints)


TREES = {
    "cart_pole_walls": _cart_pole,
    "acrobot_limits": _acrobot,
    "two_finger": _fingers,
    "two_finger_lift": _fingers,
}

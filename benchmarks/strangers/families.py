"""Eight kinds of scenes, written from drawn numbers as a user would write them.

    draft = FAMILIES["line"](dice, size)     # a scene without goal; Implausible if nobody would build it

Numbers have two digits. What a user may leave to a default (nominals, all limits but those of the
goal) is left to it in every second scene.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy as sp

from models.scene import Contact, Coordinate, Friction, Input, Parameter, Scene, Task
from models.scene.contacts import DampingLaw

GRAVITY = 9.81  # [m/s^2]
# Largest penetration under the inputs and under the weight, as shares of a contact's depth.
_PRESSED = 0.5
_SAG = 0.2
# Periods of free fall through the scene's length that a task may last.
_FALLS = (1.5, 15.0)
# Ratio of an input's bound to the least force that moves the bodies through the scene in time.
_STRENGTH = (1.5, 4.0)
# Damping of a contact, as a share of the critical one.
_DAMPING = (0.05, 0.5)


class Implausible(Exception):  # noqa: N818 - a draw that is made again, no error
    """Drawn numbers that no user would put into one scene."""


class Dice:
    """Random numbers of two digits."""

    def __init__(self, seed: Sequence[int]) -> None:
        self.random = np.random.default_rng(tuple(seed))

    def between(self, low: float, high: float) -> float:
        """Return a number, uniform in [low, high]."""
        return rounded(self.random.uniform(low, high))

    def spread(self, low: float, high: float) -> float:
        """Return a number whose logarithm is uniform."""
        return rounded(float(np.exp(self.random.uniform(np.log(low), np.log(high)))))

    def chance(self, share: float) -> bool:
        """Return True in this share of calls."""
        return bool(self.random.uniform() < share)


def rounded(value: float) -> float:
    """Return the number with two digits."""
    return float(f"{value:.2g}")


@dataclass(frozen=True, kw_only=True)
class Size:
    """How large, heavy, stiff and fast a scene is.

    length [m]; mass [kg]; stiffness [N/m] of its contacts; step [s]; steps.
    """

    length: float
    mass: float
    stiffness: float
    step: float
    steps: int

    @property
    def horizon(self) -> float:
        """Duration of the task [s]."""
        return self.step * self.steps

    @property
    def turn(self) -> float:
        """omega h: radians that a closed contact turns through in a step."""
        return float(np.sqrt(self.stiffness / self.mass)) * self.step

    def force(self, dice: Dice, mass: float) -> float:
        """Draw a bound for an input that moves this mass [N]; 4 m L/T^2 just crosses the scene."""
        return rounded(4.0 * mass * self.length / self.horizon**2 * dice.between(*_STRENGTH))


@dataclass(frozen=True, kw_only=True)
class Draft:
    """A scene without goal.

    aims: indices of the coordinates that the goal names; rest: (nu,) inputs around which pushes
    are drawn; reach: what counts as far for these coordinates [m or rad].
    """

    scene: Scene
    aims: tuple[int, ...]
    rest: tuple[float, ...]
    reach: float


@dataclass(kw_only=True)
class _Page:
    """The parts of a scene, written one after the other."""

    name: str
    title: str
    dice: Dice
    size: Size
    coordinates: list[Coordinate] = field(default_factory=list)
    inputs: list[Input] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    frictions: list[Friction] = field(default_factory=list)
    start: list[tuple[float, float]] = field(default_factory=list)
    strongest: float = 0.0

    def __post_init__(self) -> None:
        self.is_short = self.dice.chance(0.5)  # the user leaves nominals to their defaults

    def coordinate(
        self, name: str, start: float, speed: float = 0.0, unit: str = "m"
    ) -> tuple[sp.Symbol, sp.Symbol]:
        q, v = sp.symbols(f"{name} v_{name}", real=True)
        size = self.size.length if unit == "m" else 1.0
        nominal = 1.0 if self.is_short else rounded(size)
        self.coordinates.append(Coordinate(symbol=q, velocity=v, unit=unit, nominal=nominal))
        self.start.append((start, speed))
        return q, v

    def parameter(self, name: str, value: float, unit: str) -> sp.Symbol:
        symbol = sp.Symbol(name, nonnegative=True)
        self.parameters.append(Parameter(symbol=symbol, value=rounded(value), unit=unit))
        return symbol

    def input(self, name: str, lower: float, upper: float, unit: str = "N") -> sp.Symbol:
        symbol = sp.Symbol(name, real=True)
        lower, upper = rounded(lower), rounded(upper)
        self.inputs.append(Input(symbol=symbol, unit=unit, lower=lower, upper=upper))
        if unit == "N":
            self.strongest = max(self.strongest, abs(lower), abs(upper))
        return symbol

    def contact(
        self, name: str, penetration: sp.Expr, stiffness: sp.Symbol, depth: float,
        damping: dict[str, Any], weight: float = 0.0,
    ) -> None:  # fmt: skip
        """Add a contact. weight: of what rests on it [N]."""
        k = self.size.stiffness
        if self.strongest / k > _PRESSED * depth or weight / k > _SAG * depth:
            raise Implausible
        given = {} if self.is_short else {"nominal": rounded(depth / 5.0)}
        self.contacts.append(
            Contact(
                name=name, bodies=(f"{name}_a", f"{name}_b"), penetration=penetration,
                stiffness=stiffness, depth=rounded(depth),
                depth_reason="the thickness of what gives way", **given, **damping,
            )
        )  # fmt: skip

    def friction(self, name: str, slip: sp.Expr, coefficient: sp.Symbol, **pressed: Any) -> None:
        given = {} if self.is_short else {"nominal": rounded(self.size.length / self.size.horizon)}
        self.frictions.append(
            Friction(name=name, slip=slip, coefficient=coefficient, **given, **pressed)
        )

    def damping(self, mass: float, share: float) -> dict[str, Any]:
        """Draw the damping of contacts of this mass [kg]; none but in this share of scenes."""
        if not self.dice.chance(share):
            return {}
        ratio = self.dice.between(*_DAMPING)
        if self.dice.chance(0.5):
            value = 2.0 * ratio * np.sqrt(self.size.stiffness * mass)
            return {"damping": self.parameter("damping", value, "N s/m")}
        # e = 1 - 2/3 d v for slow impacts: the same loss at the speed L/T
        value = 1.5 * ratio * self.size.horizon / self.size.length
        law = {"damping_law": DampingLaw.HUNT_CROSSLEY}
        return {"damping": self.parameter("damping", value, "s/m"), **law}

    def drag(self, mass: float) -> sp.Symbol:
        """Draw a drag that matters over the task, or nearly none."""
        value = mass / self.size.horizon * self.dice.between(0.1, 2.0)
        return self.parameter("drag", value, "N s/m")

    def draft(
        self, kinetic: sp.Expr, potential: sp.Expr, forces: Sequence[sp.Expr], aims: Sequence[int],
        *, rest: Sequence[float] = (), reach: float = 0.0,
    ) -> Draft:  # fmt: skip
        positions, velocities = zip(*self.start, strict=True)
        scene = Scene(
            name=self.name, title=self.title, source="drawn",
            coordinates=tuple(self.coordinates), inputs=tuple(self.inputs),
            parameters=tuple(self.parameters),
            kinetic_energy=kinetic, potential_energy=potential, forces=tuple(forces),
            contacts=tuple(self.contacts), frictions=tuple(self.frictions),
            task=Task(
                start=(*positions, *velocities), goal=(), step=self.size.step,
                steps=self.size.steps, running_cost=sum(item.symbol**2 for item in self.inputs),
            ),
        )  # fmt: skip
        return Draft(
            scene=scene,
            aims=tuple(aims),
            rest=tuple(rest) or (0.0,) * scene.nu,
            reach=reach or self.size.length,
        )


def _falls(size: Size, length: float) -> None:
    """Raise Implausible if gravity is too slow or too fast for this length [m]."""
    low, high = _FALLS
    if not low <= size.horizon * np.sqrt(GRAVITY / length) <= high:
        raise Implausible


def line(name: str, dice: Dice, size: Size) -> Draft:
    """A cart pushes one or two blocks in line, perhaps against a wall."""
    page = _Page(name=name, title="A cart pushes blocks in line", dice=dice, size=size)
    blocks = 1 + dice.chance(0.5)
    has_wall = blocks == 1 and dice.chance(0.5)
    width = rounded(size.length * dice.between(0.1, 0.4))
    masses = [
        page.parameter(f"m{i}", size.mass * dice.between(0.7, 2.0), "kg") for i in range(blocks + 1)
    ]
    total = sum(item.value for item in page.parameters)
    places = [0.0]
    for _ in range(blocks):
        places.append(rounded(places[-1] + width + size.length * dice.between(0.02, 0.3)))
    q, v = zip(*(page.coordinate(f"x{i}", place) for i, place in enumerate(places)), strict=True)
    bound = size.force(dice, total)
    u = page.input("u", -bound, bound)
    k, w = page.parameter("k", size.stiffness, "N/m"), page.parameter("width", width, "m")
    damping = page.damping(size.mass, 0.3)
    for i in range(blocks):
        page.contact(f"touch{i}", w - (q[i + 1] - q[i]), k, width / 2, damping)
    if has_wall:
        wall = page.parameter("wall", places[-1] + size.length * dice.between(0.4, 0.8), "m")
        page.contact("stop", q[-1] + w / 2 - wall, k, width / 2, damping)
    c = page.drag(size.mass)
    forces = [u - c * v[0], *(-c * speed for speed in v[1:])]
    kinetic = sum(m * speed**2 for m, speed in zip(masses, v, strict=True)) / 2
    return page.draft(kinetic, sp.Integer(0), forces, range(1, blocks + 1))


def plate(name: str, dice: Dice, size: Size) -> Draft:
    """One or two fingers push a block on a rough plate."""
    page = _Page(name=name, title="Fingers push a block on a rough plate", dice=dice, size=size)
    fingers = 1 + dice.chance(0.5)
    width = rounded(size.length * dice.between(0.1, 0.4))
    mf = page.parameter("m_finger", size.mass * dice.between(0.7, 1.5), "kg")
    mb = page.parameter("m_block", size.mass * dice.between(0.7, 2.0), "kg")
    mu = page.parameter("mu", dice.between(0.1, 0.7), "1")
    g = page.parameter("g", GRAVITY, "m/s^2")
    values = {item.name: item.value for item in page.parameters}
    holding = values["mu"] * values["m_block"] * values["g"]
    gaps = [size.length * dice.between(0.02, 0.2) for _ in range(fingers)]
    x, vx = page.coordinate("x", 0.0)
    ends = [-1.0, 1.0][:fingers]
    fs = [
        page.coordinate(f"f{i}", rounded(side * (width / 2 + gap)))
        for i, (side, gap) in enumerate(zip(ends, gaps, strict=True))
    ]
    bound = size.force(dice, values["m_finger"] + values["m_block"]) + 1.5 * holding
    u = [page.input(f"u{i}", -bound, bound) for i in range(fingers)]
    k, w = page.parameter("k", size.stiffness, "N/m"), page.parameter("width", width, "m")
    damping = page.damping(size.mass, 0.2)
    for i, (side, (f, _)) in enumerate(zip(ends, fs, strict=True)):
        page.contact(f"touch{i}", w / 2 - side * (f - x), k, width / 2, damping)
    page.friction("plate", vx, mu, normal_force=mb * g)
    c = page.drag(size.mass)
    kinetic = mb * vx**2 / 2 + sum(mf * speed**2 for _, speed in fs) / 2
    forces = [sp.Integer(0), *(push - c * speed for push, (_, speed) in zip(u, fs, strict=True))]
    return page.draft(kinetic, sp.Integer(0), forces, [0])


def pendulum(name: str, dice: Dice, size: Size) -> Draft:
    """A pendulum with a drive swings against a stop, perhaps between two."""
    _falls(size, size.length)
    page = _Page(name=name, title="A pendulum swings against a stop", dice=dice, size=size)
    m = page.parameter("m", size.mass, "kg")
    length = page.parameter("l", size.length, "m")
    g = page.parameter("g", GRAVITY, "m/s^2")
    k = page.parameter("k", size.stiffness, "N/m")
    angle, rate = page.coordinate("angle", rounded(dice.between(-0.5, 0.0)), unit="rad")
    weight = size.mass * GRAVITY
    bound = weight * size.length * dice.between(0.3, 1.5)
    u = page.input("u", -bound, bound, "N m")
    page.strongest = weight + abs(bound) / size.length
    c = page.parameter(
        "c", size.mass * size.length**2 / size.horizon * dice.between(0.1, 1.0), "N m s/rad"
    )
    damping = page.damping(size.mass, 0.5)
    stop = page.parameter("stop", dice.between(0.2, 0.8), "rad")
    page.contact("right", length * (angle - stop), k, 0.2 * size.length, damping)
    if dice.chance(0.4):
        back = page.parameter("back", dice.between(0.6, 1.2), "rad")
        page.contact("left", -length * (angle + back), k, 0.2 * size.length, damping)
    kinetic = m * length**2 * rate**2 / 2
    return page.draft(kinetic, -m * g * length * sp.cos(angle), [u - c * rate], [0], reach=1.0)


def ball(name: str, dice: Dice, size: Size) -> Draft:
    """A ball between a driven plate and a ceiling, with gravity; the plate is balanced."""
    _falls(size, size.length)
    page = _Page(
        name=name, title="A ball is thrown by a plate, under a ceiling", dice=dice, size=size
    )
    mp = page.parameter("m_plate", size.mass * dice.between(1.0, 3.0), "kg")
    mb = page.parameter("m_ball", size.mass, "kg")
    g = page.parameter("g", GRAVITY, "m/s^2")
    k = page.parameter("k", size.stiffness, "N/m")
    radius = rounded(size.length * dice.between(0.05, 0.15))
    r = page.parameter("r", radius, "m")
    sag = size.mass * GRAVITY / size.stiffness
    rests = dice.chance(0.5)
    height = radius - sag if rests else rounded(radius + size.length * dice.between(0.05, 0.3))
    p, vp = page.coordinate("plate", 0.0)
    b, vb = page.coordinate("ball", height)
    mass = page.parameters[0].value + page.parameters[1].value
    bound = 2.0 * size.mass * GRAVITY + size.force(dice, mass)
    u = page.input("u", -bound, bound)
    damping = page.damping(size.mass, 0.7)
    weight = size.mass * GRAVITY
    page.contact("below", r - (b - p), k, radius, damping, weight=weight)
    if dice.chance(0.6):
        top = page.parameter("top", size.length * dice.between(0.8, 1.2), "m")
        page.contact("above", b + r - top, k, radius, damping)
    c = page.drag(size.mass)
    kinetic = mp * vp**2 / 2 + mb * vb**2 / 2
    rest = (weight if rests else 0.0,)
    return page.draft(kinetic, mb * g * b, [u - c * vp, sp.Integer(0)], [1], rest=rest)


def lever(name: str, dice: Dice, size: Size) -> Draft:
    """A lever with a drive lifts a load off the ground."""
    _falls(size, size.length)
    page = _Page(name=name, title="A lever lifts a load", dice=dice, size=size)
    ml = page.parameter("m_lever", size.mass * dice.between(0.5, 1.5), "kg")
    mb = page.parameter("m_load", size.mass, "kg")
    a = page.parameter("a", size.length, "m")
    g = page.parameter("g", GRAVITY, "m/s^2")
    k = page.parameter("k", size.stiffness, "N/m")
    below = -dice.between(0.1, 0.4)
    depth = 0.1 * size.length
    lever_weight = page.parameters[0].value * GRAVITY / 2.0
    stop = page.parameter("rest_angle", -below, "rad")
    angle, rate = page.coordinate(
        "angle", below - lever_weight / (size.stiffness * size.length), unit="rad"
    )
    z, vz = page.coordinate("z", -size.mass * GRAVITY / size.stiffness)
    torque = (lever_weight + size.mass * GRAVITY) * size.length
    u = page.input("u", 0.0, torque * dice.between(1.5, 3.0), "N m")
    page.strongest = page.inputs[0].upper / size.length
    damping = page.damping(size.mass, 0.4)
    weight = size.mass * GRAVITY
    page.contact("tip", a * sp.sin(angle) - z, k, depth, damping)
    page.contact("ground", -z, k, depth, damping, weight=weight)
    page.contact("stop", -a * (angle + stop), k, depth, damping, weight=lever_weight)
    c = page.parameter(
        "c", size.mass * size.length**2 / size.horizon * dice.between(0.5, 4.0), "N m s/rad"
    )
    kinetic = ml * a**2 * rate**2 / 6 + mb * vz**2 / 2
    potential = ml * g * a * sp.sin(angle) / 2 + mb * g * z
    return page.draft(kinetic, potential, [u - c * rate, sp.Integer(0)], [1], rest=(torque,))


def bounce(name: str, dice: Dice, size: Size) -> Draft:
    """A driven body meets one that flies at it, perhaps before a wall."""
    page = _Page(name=name, title="A driven body bounces a flying one back", dice=dice, size=size)
    m1 = page.parameter("m1", size.mass * dice.between(0.7, 3.0), "kg")
    m2 = page.parameter("m2", size.mass, "kg")
    k = page.parameter("k", size.stiffness, "N/m")
    width = rounded(size.length * dice.between(0.1, 0.3))
    w = page.parameter("width", width, "m")
    gap = size.length * dice.between(0.1, 0.4)
    speed = rounded(gap / size.horizon * dice.between(1.5, 5.0))
    x1, v1 = page.coordinate("x1", 0.0)
    x2, v2 = page.coordinate("x2", rounded(width + gap), -speed)
    bound = size.force(dice, page.parameters[0].value + page.parameters[1].value)
    u = page.input("u", -bound, bound)
    page.strongest = max(page.strongest, speed * np.sqrt(size.stiffness * size.mass))
    damping = page.damping(size.mass, 0.6)
    page.contact("touch", w - (x2 - x1), k, width / 2, damping)
    if dice.chance(0.4):
        wall = page.parameter("wall", width + gap + size.length * dice.between(0.3, 0.6), "m")
        page.contact("stop", x2 + w / 2 - wall, k, width / 2, damping)
    c = page.drag(size.mass)
    kinetic = m1 * v1**2 / 2 + m2 * v2**2 / 2
    return page.draft(kinetic, sp.Integer(0), [u - c * v1, sp.Integer(0)], [1])


def drag(name: str, dice: Dice, size: Size) -> Draft:
    """A pad presses on a slab from above and drags it over the floor by friction."""
    page = _Page(name=name, title="A pad drags a slab by friction", dice=dice, size=size)
    mp = page.parameter("m_pad", size.mass * dice.between(0.7, 1.5), "kg")
    ms = page.parameter("m_slab", size.mass, "kg")
    mu_pad = page.parameter("mu_pad", dice.between(0.5, 0.9), "1")
    mu_floor = page.parameter("mu_floor", dice.between(0.05, 0.25), "1")
    g = page.parameter("g", GRAVITY, "m/s^2")
    k = page.parameter("k", size.stiffness, "N/m")
    height = rounded(size.length * dice.between(0.02, 0.1))
    _, vx = page.coordinate("x", 0.0)
    z, vz = page.coordinate("z", height)
    _, vs = page.coordinate("slab", 0.0)
    needed = size.force(dice, 2.5 * size.mass) + 0.25 * size.mass * GRAVITY
    fx = page.input("fx", -needed, needed)
    fz = page.input("fz", -3.0 * needed, needed)
    damping = page.damping(size.mass, 0.5)
    page.contact("press", -z, k, 0.1 * size.length, damping)
    page.friction("pad", vs - vx, mu_pad, contact="press")
    page.friction("floor", vs, mu_floor, normal_force=ms * g)
    c = page.drag(size.mass)
    kinetic = mp * (vx**2 + vz**2) / 2 + ms * vs**2 / 2
    forces = [fx - c * vx, fz - c * vz, sp.Integer(0)]
    return page.draft(kinetic, sp.Integer(0), forces, [2], rest=(0.0, -needed))


def brake(name: str, dice: Dice, size: Size) -> Draft:
    """A turning wheel is braked by a pad that a spring holds off."""
    page = _Page(name=name, title="A pad brakes a wheel", dice=dice, size=size)
    inertia = page.parameter("J", size.mass * size.length**2 * dice.between(0.5, 2.0), "kg m^2")
    radius = page.parameter("R", size.length, "m")
    m = page.parameter("m", size.mass, "kg")
    mu = page.parameter("mu", dice.between(0.2, 0.7), "1")
    k = page.parameter("k", size.stiffness, "N/m")
    gap = rounded(size.length * dice.between(0.01, 0.05))
    rate = rounded(dice.between(2.0, 6.0) / size.horizon)
    values = {item.name: item.value for item in page.parameters}
    holding = values["J"] * rate / (size.horizon * values["mu"] * size.length)
    _, vw = page.coordinate("wheel", 0.0, rate, unit="rad")
    p, vp = page.coordinate("pad", -gap)
    back = page.parameter("k_back", holding / gap * dice.between(0.05, 0.3), "N/m")
    u = page.input("u", -holding, 4.0 * holding)
    damping = page.damping(size.mass, 0.3)
    page.contact("lining", p, k, 0.1 * size.length, damping)
    page.friction("rim", radius * vw, mu, contact="lining")
    c = page.drag(size.mass)
    away = page.parameter("gap", gap, "m")
    kinetic = inertia * vw**2 / 2 + m * vp**2 / 2
    potential = back * (p + away) ** 2 / 2
    return page.draft(
        kinetic, potential, [sp.Integer(0), u - c * vp], [0], rest=(holding,), reach=1.0
    )


FAMILIES: dict[str, Callable[[str, Dice, Size], Draft]] = {
    family.__name__: family for family in (line, plate, pendulum, ball, lever, bounce, drag, brake)
}

"""A scene as other simulators can be told it: masses that slide, springs, dampers, contacts and frictions with numbers for coefficients.

    mechanism = mechanism_of(scene)          # raises CannotExpressError, in a sentence, for a scene that is no such thing

Every number is derived from the scene's own energies, forces and contacts; nothing is typed twice. Each coordinate is a body that slides, or one of the
axes of a body: a disc has two, and so has what rubs on something. The gap of a contact is linear, `normal @ q - offset`, or the distance of two centres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from models.dynamics import derive
from models.scene import Contact, Scene
from models.scene.contacts import DampingLaw
from validate.judge.simulator import CannotExpressError

# A spring or damper weaker than this share of the strongest is rounding of the eigenvalues.
_ROUNDING = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """A spring or damper along a direction: force -strength * direction * (direction @ x); direction (nq,), strength [N/m or N s/m], of a spring also negative."""

    strength: float
    direction: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Touch:
    """A contact: gap = normal @ q - offset, or with centres the distance of those two bodies less offset.

    normal (nq,); offset, stiffness, damping in the scene's units; law of its damping; centres: the coordinates (x, y) of each body.
    """

    name: str
    normal: np.ndarray
    offset: float
    stiffness: float
    damping: float
    law: DampingLaw
    centres: tuple[tuple[int, int], tuple[int, int]] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Rub:
    """Dry friction: slip = direction @ v, direction (nq,); pressed by `touch` (its place among the touches) or by a constant force [N]."""

    name: str
    direction: np.ndarray
    coefficient: float
    touch: int | None
    pressed: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Mechanism:
    """See the module docstring.

    masses (nq,) [kg], None where the engine's own bodies were asked for; constant (nq,) [N]: forces that never change; drive (nq, nu): force of each input.
    """

    masses: np.ndarray | None
    constant: np.ndarray
    drive: np.ndarray
    springs: tuple[Link, ...]
    dampers: tuple[Link, ...]
    touches: tuple[Touch, ...]
    rubs: tuple[Rub, ...]


def mechanism_of(scene: Scene, *, bodies: bool = True) -> Mechanism:
    """The mechanism of a scene.

    Parameters
    ----------
    scene
        With numbers for its parameters.
    bodies
        Whether masses and potential are asked for too; False where the engine's own bodies and gravity stand for them.

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
    q, v, u = dynamics.q, dynamics.v, dynamics.u
    masses, constant, springs = None, np.zeros(scene.nq), ()
    if bodies:
        if not (dynamics.structure.constant_mass and dynamics.structure.diagonal_mass):
            raise CannotExpressError(
                "its masses do not each move along a coordinate of their own (the mass matrix is no constant diagonal)"
            )
        masses = np.array([float(dynamics.mass_matrix[i, i].subs(values)) for i in range(scene.nq)])
        slope, rest = _affine(
            [-sp.diff(dynamics.potential_energy.subs(values), symbol) for symbol in q], q, "its potential is no sum of springs"
        )
        constant, springs = rest, _links(-slope)
    slope, rest = _affine(
        [force.subs(values) for force in scene.forces], (*q, *v, *u), "its forces are not linear in positions, velocities and inputs"
    )
    if np.abs(slope[:, : scene.nq]).max(initial=0.0) > 0.0:
        raise CannotExpressError("its forces depend on positions without a potential")
    damping = -slope[:, scene.nq : 2 * scene.nq]
    if not np.allclose(damping, damping.T, rtol=1e-12, atol=0.0):
        raise CannotExpressError("its damping is no sum of dampers between bodies")
    return Mechanism(
        masses=masses,
        constant=constant + rest,
        drive=slope[:, 2 * scene.nq :],
        springs=springs,
        dampers=_links(damping),
        touches=tuple(_touch(scene, contact, bodies) for contact in scene.contacts) if bodies else _linear_touches(scene),
        rubs=_rubs(scene),
    )


def axes_of_bodies(mechanism: Mechanism) -> list[tuple[int, ...]]:
    """Which coordinates belong to one body: the centre of a disc, what a rubbing body slides along and is pressed along; every other is one of its own."""
    owner = list(range(len(mechanism.constant)))

    def join(one: int, other: int) -> None:
        first, second = sorted((owner[one], owner[other]))
        owner[:] = [first if item == second else item for item in owner]

    for touch in mechanism.touches:
        for centre in touch.centres or ():
            join(*centre)
    for rub in mechanism.rubs:
        if rub.touch is not None:
            pressed = np.flatnonzero(mechanism.touches[rub.touch].normal)
            slides = np.flatnonzero(rub.direction > 0.0)
            if len(pressed) != 1 or len(slides) != 1:
                raise CannotExpressError(f"friction {rub.name} is pressed by a contact of more than one coordinate")
            join(int(pressed[0]), int(slides[0]))
    return [tuple(np.flatnonzero(np.array(owner) == first).tolist()) for first in dict.fromkeys(owner)]


def _affine(expressions: Sequence[sp.Expr], symbols: Sequence[sp.Symbol], otherwise: str) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (n, symbols) and values at zero (n,) of expressions that are affine in the symbols. Raises CannotExpressError with the words of `otherwise`."""
    column = sp.Matrix([sp.expand(expression) for expression in expressions])
    slope = column.jacobian(sp.Matrix(list(symbols)))
    if slope.free_symbols:
        raise CannotExpressError(otherwise)
    rest = column.subs(dict.fromkeys(symbols, 0))
    return np.array(slope, dtype=float).reshape(len(expressions), len(symbols)), np.array(rest, dtype=float).ravel()


def _links(matrix: np.ndarray) -> tuple[Link, ...]:
    """A symmetric matrix (nq, nq) as a sum of links; a diagonal one along the coordinates themselves."""
    if not matrix.any():
        return ()
    strengths, directions = np.linalg.eigh(matrix)
    if not (matrix - np.diag(np.diag(matrix))).any():
        strengths, directions = np.diag(matrix), np.eye(len(matrix))
    return tuple(
        Link(strength=float(strength), direction=directions[:, place])
        for place, strength in enumerate(strengths)
        if abs(strength) > _ROUNDING * np.abs(strengths).max()
    )


def _linear_touches(scene: Scene) -> tuple[Touch, ...]:
    """Those contacts of a scene whose gap is linear; the others are the bodies' own matter."""
    found = []
    for contact in scene.contacts:
        try:
            found.append(_touch(scene, contact, False))
        except CannotExpressError:
            continue
    return tuple(found)


def _touch(scene: Scene, contact: Contact, discs: bool) -> Touch:
    values = scene.parameter_values
    q = [coordinate.symbol for coordinate in scene.coordinates]
    penetration = contact.penetration.subs(values)
    numbers = {
        "name": contact.name,
        "stiffness": float(contact.stiffness.subs(values)),
        "damping": float(contact.damping.subs(values)),
        "law": contact.damping_law,
    }
    distances = [item for item in penetration.atoms(sp.Pow) if item.exp == sp.Rational(1, 2)]
    if discs and len(distances) == 1 and not (penetration + distances[0]).free_symbols:
        return Touch(
            **numbers, normal=np.zeros(scene.nq), offset=float(penetration + distances[0]), centres=_centres(contact, distances[0], q)
        )
    slope, rest = _affine([penetration], q, f"the gap of contact {contact.name} is neither linear nor the distance of two centres")
    return Touch(**numbers, normal=-slope[0], offset=float(rest[0]))


def _centres(contact: Contact, distance: sp.Expr, q: Sequence[sp.Symbol]) -> tuple[tuple[int, int], tuple[int, int]]:
    """The coordinates of two centres whose distance this is: sqrt((x2 - x1)^2 + (y2 - y1)^2), but for what blurs it."""
    form = np.array(sp.hessian(sp.expand(distance**2), list(q)) / 2)
    pairs = [(i, j) for i in range(len(q)) for j in range(i + 1, len(q)) if form[i, j] == -1]
    if len(pairs) != 2 or any(form[place, place] != 1 for pair in pairs for place in pair):
        raise CannotExpressError(f"the distance of contact {contact.name} is not that of two centres in the plane")
    (x1, x2), (y1, y2) = pairs
    return (x1, y1), (x2, y2)


def _rubs(scene: Scene) -> tuple[Rub, ...]:
    values = scene.parameter_values
    q, v = ([getattr(item, part) for item in scene.coordinates] for part in ("symbol", "velocity"))
    names = [contact.name for contact in scene.contacts]
    found = []
    for friction in scene.frictions:
        where = f"friction {friction.name}"
        direction, _ = _affine([friction.slip.subs(values)], v, f"the direction of {where} depends on the positions")
        pressed = sp.S.Zero if friction.normal_force is None else friction.normal_force.subs(values)
        if pressed.free_symbols & set(q):
            raise CannotExpressError(f"what presses {where} depends on the positions without being a contact")
        touch = None if friction.contact is None else names.index(friction.contact)
        coefficient = float(friction.coefficient.subs(values))
        found.append(Rub(name=friction.name, direction=direction[0], coefficient=coefficient, touch=touch, pressed=float(pressed)))
    return tuple(found)

"""How a plan's model writes contact, and how it is tightened without building the model again."""

from __future__ import annotations

import math
from enum import Enum
from typing import Any

import numpy as np
import pyomo.environ as pyo

from formulations.transcription.damping import settle_springs
from formulations.transcription.friction import free_unpressed, settle_slip
from models.contact_law import sharpness
from models.errors import TouchstoneError

_TRANSFORMATION = "mpec.simple_nonlinear"


class ContactLaw(Enum):
    """SOFTPLUS: smooth force at a distance, eps in (0, 1). COMPLEMENTARITY: lam (lam - k phi) <= eps [N^2], eps = 0 is the true law."""

    SOFTPLUS = "softplus"
    COMPLEMENTARITY = "complementarity"


class ModelError(TouchstoneError):
    """A model is asked for something it was not built for; one sentence says what and what to do instead."""


def relax(block: Any, eps: float) -> None:
    """Replace the complementarity of a built block by Pyomo's own relaxation lam * v <= mpec_bound, v = lam - k phi (mpec.simple_nonlinear).

    In place, once: the transformation applied again would silently disconnect the first bound, hence a ModelError. To keep the
    untransformed model, relax a clone: `relaxed = model.clone(); relax(relaxed, 1e-2)`.
    """
    if not _families(block):
        raise ModelError(f"{_name(block)} has no complementarity to relax; build it with contact=ContactLaw.COMPLEMENTARITY and eps=None.")
    if hasattr(block, "mpec_bound"):
        raise ModelError(f"{_name(block)} is relaxed already; move its bound with tighten(model, eps).")
    bound = _checked_bound(block, eps)
    pyo.TransformationFactory(_TRANSFORMATION).apply_to(block, mpec_bound=bound)
    for _, pair in pairs(block):
        pair.c.deactivate()  # that a force or slip is not negative is its bound already; as a row it would cost a slack each
    settle_separation(block)  # the transformation leaves v without a value


def settle_separation(block: Any) -> None:
    """Give the separation force v = lam - k phi (friction: the reserve mu N - |f| either way) of each relaxed pair the value that its own
    equation asks for (at least 0), and slip speeds and springs theirs."""
    settle_slip(block)
    settle_springs(block)
    if not is_relaxed(block):
        return
    for _, pair in pairs(block):
        pair.v.set_value(0.0, skip_validation=True)
        pair.v.set_value(max(0.0, -pyo.value(pair.ve.body)), skip_validation=True)  # ve: v - (lam - k phi) == 0


def tighten(block: Any, eps: float) -> None:
    """Set the relaxation of a built block: sharpness b = |ln eps| for softplus, the bound eps [N^2] for complementarity (0 allowed)."""
    if hasattr(block, "parameter_sharpness"):
        block.parameter_sharpness.value = sharpness(eps, pyo.value(block.parameter_length))
    elif hasattr(block, "mpec_bound"):
        block.mpec_bound.value = _checked_bound(block, eps)
    else:
        raise ModelError(f"{_name(block)} has no relaxation to tighten; build it with an eps, or relax(model, eps) first.")


def pairs(block: Any) -> list[tuple[Any, Any]]:
    """(variable, pair) of every complementarity, contacts, frictions, then springs and switches of damped contacts, each by step: (lam, its
    pair), (slip one way, its pair)."""
    return [item for family in _families(block) for item in zip(family[0].values(), family[1].values(), strict=True)]


def sides(block: Any) -> list[tuple[Any, Any]]:
    """The two variables of every pair of a relaxed block, of which one is zero, step by step as in `hold_modes`: (lam, lam - k phi) of
    the contacts, then (slip forward, mu N + f), (slip backward, mu N - f) of the frictions, then the pairs of `damping`: springs, switches."""
    steps = len(block.set_steps)
    rows: list[list[tuple[Any, Any]]] = [[] for _ in range(steps)]
    for variables, components in _families(block):
        couples = [(variable, pair.v) for variable, pair in zip(variables.values(), components.values(), strict=True)]
        width = len(couples) // steps
        for t, row in enumerate(rows):
            row += couples[t * width : (t + 1) * width]
    return [couple for row in rows for couple in row]


def _families(block: Any) -> list[tuple[Any, Any]]:
    kinds = (("lam", "contact"), ("slip", "friction"), ("spring", "spring"), ("touch", "touch"))
    names = [(f"variable_{variable}", f"complementarity_{pair}") for variable, pair in kinds]
    found = [(block.component(variable), block.component(pair)) for variable, pair in names]
    return [(variable, pair) for variable, pair in found if pair is not None]


def hold_modes(block: Any, closed: np.ndarray) -> None:
    """Decide every pair of a relaxed block; the products are switched off.

    closed (steps, nc + 2 nf + springs + switches) is True where a contact is closed (lam = k phi; else lam = 0), then, for each friction, where it may slip
    forward against f = -mu N (else it does not), and where backward; then whether each damped contact touches, for its spring and for its
    switch. What is left has no complementarity: for a linear scene without
    friction a convex quadratic program.

    Of a friction whose contact is open nothing is decided, whatever `closed` says: it has no force, and slips as it will.
    """
    for _, pair in pairs(block):
        pair.ccon.deactivate()
    couples = sides(block)
    for (force, separation), is_closed in zip(couples, closed.ravel().tolist(), strict=True):
        force.setlb(0.0)
        separation.setlb(0.0)
        force.setub(None if is_closed else 0.0)
        separation.setub(0.0 if is_closed else None)
    free_unpressed(block, couples, closed)


def release_modes(block: Any) -> None:
    """Undo `hold_modes`: the pairs are open to choice again, and their products are bounded by mpec_bound."""
    for variable, pair in pairs(block):
        pair.ccon.activate()
        for side in (variable, pair.v):
            side.setlb(0.0)
            side.setub(None)


def is_relaxed(block: Any) -> bool:
    """Whether the block's complementarity went through `relax`."""
    return hasattr(block, "mpec_bound")


def _checked_bound(block: Any, eps: Any) -> float:
    if isinstance(eps, bool) or not isinstance(eps, (int, float)) or not 0.0 <= eps < math.inf:
        raise ModelError(f"{_name(block)}: eps is {eps!r}, but the bound of lam (lam - k phi) must be a finite number of at least 0 N^2.")
    return float(eps)


def _name(block: Any) -> str:
    return f"model {block.name}"

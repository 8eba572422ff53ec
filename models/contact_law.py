"""The contact laws lam(phi) of plans and simulations.

    ReLU, true:          lam = k * max(phi, 0)                                    (paper, eq. 3)
    softplus, relaxed:   lam = (k / b) * log(1 + exp(b * phi)),  b = |ln eps| / L (paper, eq. 5,
                         sign corrected)

L is the scene's length unit of eps (by default the smallest contact depth), so that eps = 1e-3
has the same relative reach at 0.1 m and at 1 m.
"""

from __future__ import annotations

import math
from enum import Enum

import numpy as np

from models.errors import TouchstoneError


class RelaxationError(TouchstoneError):
    """An eps outside the range of the relaxed law."""


class ContactLaw(Enum):
    """The true law, or the relaxed one; the value is that of the C code."""

    RELU = 0
    SOFTPLUS = 1


def sharpness(eps: float, length: float = 1.0) -> float:
    """Return b = |ln eps| / length [1/m] of the softplus law.

    Raises RelaxationError unless 0 < eps < 1.
    """
    if isinstance(eps, bool) or not isinstance(eps, (int, float)) or not 0.0 < eps < 1.0:
        raise RelaxationError(
            f"softplus contact: eps is {eps!r}, but must be a number with 0 < eps < 1 (the law's sharpness is |ln eps|)."
        )
    return abs(math.log(eps)) / length


def contact_force(
    phi: np.ndarray,
    stiffness: np.ndarray | float,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
    length: float = 1.0,
) -> np.ndarray:
    """Return contact forces lam [N], shaped like phi (paper, eq. 3 and 5).

    Raises RelaxationError unless 0 < eps < 1, for the relaxed law.

    Parameters
    ----------
    phi
        Penetrations (any,) [m].
    stiffness
        k [N/m], a number or shaped like phi.
    law, eps
        The law, and the relaxation of softplus [-].
    length
        The scene's length [m].
    """
    phi = np.asarray(phi, dtype=float)
    if law is ContactLaw.RELU:
        return stiffness * np.maximum(phi, 0.0)
    b = sharpness(eps if eps is not None else 0.0, length)
    return (stiffness / b) * np.logaddexp(0.0, b * phi)


def worst_case_violation(stiffness: float, eps: float, length: float = 1.0) -> float:
    """Return the largest lam*(lam - k*phi) of softplus: (k L ln2 / ln eps)^2 [N^2], at phi = 0."""
    return (stiffness * math.log(2.0) / sharpness(eps, length)) ** 2

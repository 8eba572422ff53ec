"""The contact laws lam(phi) that plans and simulations use.

ReLU, the true law:   lam = k * max(phi, 0)                                    (paper, eq. 3)
softplus, relaxed:    lam = (k / b) * log(1 + exp(b * phi)),  b = |ln eps| / L (paper, eq. 5, sign
                      corrected)

L is the length that the scene's eps is counted in (without one the smallest depth of its contacts): eps = 1e-3
then reaches as far beside 0.1 m as it does beside 1 m.

Evaluated without overflow as (k / b) * (max(b phi, 0) + log1p(exp(-|b phi|))).
"""

from __future__ import annotations

import math
from enum import Enum

import numpy as np

from models.errors import TouchstoneError


class RelaxationError(TouchstoneError):
    """An eps for which the relaxed law has no meaning."""


class ContactLaw(Enum):
    """The true law, or the relaxed one; the value is the C code's."""

    RELU = 0
    SOFTPLUS = 1


def sharpness(eps: float, length: float = 1.0) -> float:
    """Sharpness b = |ln eps| / length [1/m] of the softplus law.

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
    """Contact forces, element by element (paper, eq. 3 and 5).

    Parameters
    ----------
    phi
        Penetrations (any,) [m].
    stiffness
        k [N/m], a number or of the shape of phi.
    law, eps
        The law, and the relaxation of a softplus [-].
    length
        The scene's length, which eps is counted in [m].

    Returns
    -------
    np.ndarray
        lam, of the shape of phi [N].

    Raises
    ------
    RelaxationError
        Unless 0 < eps < 1, of a relaxed law.
    """
    phi = np.asarray(phi, dtype=float)
    if law is ContactLaw.RELU:
        return stiffness * np.maximum(phi, 0.0)
    b = sharpness(eps if eps is not None else 0.0, length)
    return (stiffness / b) * np.logaddexp(0.0, b * phi)


def worst_case_violation(stiffness: float, eps: float, length: float = 1.0) -> float:
    """D = max over phi of lam*(lam - k*phi) of the softplus law: (k L ln2 / ln eps)^2 [N^2], reached at phi = 0."""
    return (stiffness * math.log(2.0) / sharpness(eps, length)) ** 2

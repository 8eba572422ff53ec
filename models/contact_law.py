"""The contact laws lam(phi) that plans and simulations use.

ReLU, the true law:   lam = k * max(phi, 0)                                    (paper, eq. 3)
softplus, relaxed:    lam = (k / b) * log(1 + exp(b * phi)),  b = |ln eps|     (paper, eq. 5, sign corrected)

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
    RELU = 0
    SOFTPLUS = 1


def sharpness(eps: float) -> float:
    """b = |ln eps| [1/m] of the softplus law. Raises RelaxationError unless 0 < eps < 1."""
    if isinstance(eps, bool) or not isinstance(eps, (int, float)) or not 0.0 < eps < 1.0:
        raise RelaxationError(f"softplus contact: eps is {eps!r}, but must be a number with 0 < eps < 1 (the law's sharpness is |ln eps|).")
    return abs(math.log(eps))


def contact_force(
    phi: np.ndarray, stiffness: np.ndarray | float, law: ContactLaw = ContactLaw.RELU, eps: float | None = None
) -> np.ndarray:
    """lam [N] at penetrations phi [m], element by element."""
    phi = np.asarray(phi, dtype=float)
    if law is ContactLaw.RELU:
        return stiffness * np.maximum(phi, 0.0)
    b = sharpness(eps if eps is not None else 0.0)
    return (stiffness / b) * np.logaddexp(0.0, b * phi)


def worst_case_violation(stiffness: float, eps: float) -> float:
    """D = max over phi of lam*(lam - k*phi) of the softplus law: (k ln2 / ln eps)^2 [N^2], reached at phi = 0."""
    return (stiffness * math.log(2.0) / sharpness(eps)) ** 2

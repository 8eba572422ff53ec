"""The time steps of plans, with one input per step.

| scheme | step | order |
|---|---|---|
| SEMI_IMPLICIT_EULER | v' = v + h a(q, v, u, lam(q)), q' = q + h v' | 1, the paper's |
| IMPLICIT_MIDPOINT | Gauss-Legendre collocation, one stage | 2, keeps quadratic energies |
| RADAU_IIA_2 | Radau IIA collocation, two stages | 3, stiffly accurate, L-stable |

Source: Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np


class Scheme(Enum):
    """The time step of a plan."""

    SEMI_IMPLICIT_EULER = "semi_implicit_euler"
    IMPLICIT_MIDPOINT = "implicit_midpoint"
    RADAU_IIA_2 = "radau_iia_2"


@dataclass(frozen=True, eq=False)
class Tableau:
    """Butcher tableau of a collocation: c (s,), a (s, s), b (s,).

        X_i = x + h sum_j a_ij f(X_j, u), x' = x + h sum_i b_i f(X_i, u)

    Contact forces have a kink where contacts open or close. A step with a kink has a velocity error
    of at most `switch_constant` h^2 |phi'| |M^-1 J' k|, so plans with contacts have order 2
    (three_cart: 1.9).

    switch_constant: largest |integral over 0..1 of max(s - z, 0) - sum_i b_i max(c_i - z, 0)| over
        the place z of the kink
    """

    c: np.ndarray
    a: np.ndarray
    b: np.ndarray
    switch_constant: float

    @property
    def stages(self) -> int:
        """Return the number of stages s."""
        return len(self.c)

    @property
    def is_stiffly_accurate(self) -> bool:
        """Return whether the last stage is the next node."""
        return bool(self.c[-1] == 1.0)


_TABLEAUS = {
    Scheme.IMPLICIT_MIDPOINT: Tableau(
        c=np.array([1 / 2]),
        a=np.array([[1 / 2]]),
        b=np.array([1.0]),
        switch_constant=1 / 8,
    ),
    Scheme.RADAU_IIA_2: Tableau(
        c=np.array([1 / 3, 1.0]),
        a=np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]]),
        b=np.array([3 / 4, 1 / 4]),
        switch_constant=1 / 18,
    ),
}


def tableau(scheme: Scheme) -> Tableau:
    """Return the tableau of a collocation; raise KeyError for semi-implicit Euler."""
    return _TABLEAUS[scheme]

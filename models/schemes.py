"""The time steps a plan may be made of, with one input held over each: semi-implicit Euler, and collocation by Butcher tableaus.

    SEMI_IMPLICIT_EULER   v' = v + h a(q, v, u, lam(q)),  q' = q + h v'   order 1, the paper's
    IMPLICIT_MIDPOINT   Gauss-Legendre, one stage: c = 1/2   order 2, keeps quadratic energies
    RADAU_IIA_2, _3   Radau IIA, c = 1/3, 1 or c = (4 -+ sqrt 6)/10, 1
        order 3 and 5, stiffly accurate, L-stable

    X_i = x + h sum_j a_ij f(X_j, u),   x' = x + h sum_i b_i f(X_i, u),
        a_ij = integral of the Lagrange polynomial l_j from 0 to c_i

These orders hold where the right-hand side is smooth. The force of a contact, k max(phi, 0), has a
kink where it opens or closes; the step in which that happens misses the velocity by at most
`switch_constant` h^2 |phi'| |M^-1 J' k|, so that a plan with contacts is of order 2 (three_cart:
1.9).

Source: Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.5.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.polynomial import Polynomial


class Scheme(Enum):
    """How a plan goes from node to node."""

    SEMI_IMPLICIT_EULER = "semi_implicit_euler"
    IMPLICIT_MIDPOINT = "implicit_midpoint"
    RADAU_IIA_2 = "radau_iia_2"
    RADAU_IIA_3 = "radau_iia_3"


@dataclass(frozen=True, eq=False)
class Tableau:
    """Butcher tableau of a collocation: c (s,), a (s, s), b (s,); order, where nothing has a kink.

    switch_constant: see the module docstring.

    inverse: a^-1 (s, s); ends: b' a^-1 (s,), with x' - x = sum_i ends_i (X_i - x);
        is_stiffly_accurate: the last stage is the next node.
    """

    c: np.ndarray
    a: np.ndarray
    b: np.ndarray
    order: int
    switch_constant: float
    inverse: np.ndarray
    ends: np.ndarray

    @property
    def stages(self) -> int:
        """The number of stages s."""
        return len(self.c)

    @property
    def is_stiffly_accurate(self) -> bool:
        """Whether the last stage is the next node."""
        return bool(self.c[-1] == 1.0)


_NODES = {
    Scheme.IMPLICIT_MIDPOINT: ((0.5,), 2),
    Scheme.RADAU_IIA_2: ((1.0 / 3.0, 1.0), 3),
    Scheme.RADAU_IIA_3: (((4.0 - math.sqrt(6.0)) / 10.0, (4.0 + math.sqrt(6.0)) / 10.0, 1.0), 5),
}


@cache
def tableau(scheme: Scheme) -> Tableau:
    """The tableau of a collocation. Raises ValueError for semi-implicit Euler, which is none."""
    if scheme not in _NODES:
        raise ValueError(
            f"{scheme.value} is no collocation; there are {', '.join(item.value for item in _NODES)}."
        )
    nodes, order = _NODES[scheme]
    c = np.array(nodes)
    primitives = [_lagrange(c, j).integ() for j in range(len(c))]
    a = np.array([[primitive(place) for primitive in primitives] for place in c])
    b = np.array([primitive(1.0) for primitive in primitives])
    inverse = np.linalg.inv(a)
    ends = b @ inverse if c[-1] != 1.0 else np.eye(len(c))[-1]
    return Tableau(
        c=c,
        a=a,
        b=b,
        order=order,
        switch_constant=_switch_constant(c, b),
        inverse=inverse,
        ends=ends,
    )


def _lagrange(c: np.ndarray, j: int) -> Polynomial:
    from numpy.polynomial import Polynomial  # 8 ms of the 270 of the child that replays

    others = np.delete(c, j)
    return (
        Polynomial.fromroots(others) / float(np.prod(c[j] - others))
        if len(others)
        else Polynomial([1.0])
    )


def _switch_constant(c: np.ndarray, b: np.ndarray) -> float:
    """Largest |integral over 0..1 of max(s - z, 0) - sum_i b_i max(c_i - z, 0)| over the place z of the kink.

    Between two nodes that error is the parabola (1 - z)^2/2 - sum over c_i > z of b_i (c_i - z): it
    is largest at a node, or at its vertex.
    """
    places = [0.0, *c, 1.0]
    for low, high in itertools.pairwise(places):
        vertex = 1.0 - float(b[c > low].sum())
        if low < vertex < high:
            places.append(vertex)
    z = np.array(places)
    return float(np.abs((1.0 - z) ** 2 / 2.0 - np.maximum(c - z[:, None], 0.0) @ b).max())

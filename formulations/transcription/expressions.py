"""SymPy equations of a scene -> functions of Pyomo variables and Params.

    equations = SceneExpressions(derive(scene))
    equations.penetration(q, p)        # [Pyomo expression per contact]

Arguments are sequences in the scene's order: q, v (nq), u (nu), lam (nc), p (np). Entries that are zero for the scene are the number 0,
so that nothing is written for what is not there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import pyomo.environ as pyo
import sympy as sp

from formulations.transcription.smooth import SMOOTH, check_smooth
from models.dynamics import Dynamics

_NAMESPACE = {**{name: getattr(pyo, name) for name in SMOOTH}, "pi": math.pi, "E": math.e}

Entries = Callable[..., Sequence[Any]]


class SceneExpressions:
    """The functions a transcription needs. Raises SceneError for a function that Pyomo does not have (erf, atan2 ..)."""

    def __init__(self, dynamics: Dynamics) -> None:
        d = dynamics
        self.nq, self.nc = len(d.q), len(d.lam)
        self.mass = _function(d, "the mass matrix", list(d.mass_matrix), d.q, d.p)  # row by row, nq*nq entries
        self.force = _function(d, "the generalised force", list(d.generalised_force), d.q, d.v, d.u, (*d.lam, *d.f), d.p)
        self.penetration = _function(d, "a penetration", list(d.penetration), d.q, d.p)
        self.stiffness = _function(d, "a stiffness", list(d.stiffness), d.p)
        self.damping = _function(d, "a damping", list(d.damping), d.p)
        self.penetration_rate = _function(d, "a rate of penetration", list(-d.gap_jacobian * sp.Matrix(d.v)), d.q, d.v, d.p)
        self.slip = _function(d, "a slip", list(d.slip), d.q, d.v, d.p)
        self.friction_limit = _function(d, "a friction coefficient or normal force", list(d.friction_limit), d.q, d.lam, d.p)
        self.running_cost = _function(d, "the running cost", [d.running_cost], d.q, d.v, d.u, d.p)
        self.final_cost = _function(d, "the final cost", [] if d.final_cost == 0 else [d.final_cost], d.q, d.v, d.p)  # 0 or 1 entry


def _function(dynamics: Dynamics, what: str, expressions: list[sp.Expr], *groups: Sequence[sp.Symbol]) -> Entries:
    check_smooth(dynamics.scene, what, expressions)
    return sp.lambdify([list(group) for group in groups], expressions, modules=[_NAMESPACE], cse=True)

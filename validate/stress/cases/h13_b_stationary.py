"""An optimum that is B- but not S-stationary: multipliers grow without bound along every relaxation. The primal answer is kept, the class says so.

min z1 + z2 - z0,   z0 <= 4 z1,   z0 <= 4 z2,   0 <= z1 complements z2 >= 0
    (scholtes4 of MacMPEC; solution 0 at the origin)
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

from formulations.mpec import Stationarity, certify, solve_mpec
from validate.stress.case import Found, StressCase, at_most, finding, none_of


def _problem(start: float) -> Any:
    m: Any = pyo.ConcreteModel()
    m.z = pyo.Var([1, 2], bounds=(0, None), initialize=start)
    m.top = pyo.Var(initialize=start)
    m.cost = pyo.Objective(expr=m.z[1] + m.z[2] - m.top)
    m.below = pyo.Constraint([1, 2], rule=lambda m, i: m.top <= 4 * m.z[i])
    m.pair = Complementarity(expr=complements(m.z[1] >= 0, m.z[2] >= 0))
    return m


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    solved = solve_mpec(_problem(1.0))
    origin = certify(_problem(0.0))
    wrong = []
    certificate = solved.certificate
    if not solved.has_point or not np.isfinite(solved.objective):
        wrong.append("no primal answer")
    if certificate is None:
        wrong.append("no certificate")
    for where, item in (("answer", certificate), ("origin", origin)):
        if item is not None and (
            item.stationarity is Stationarity.STRONG
            or item.stationarity is Stationarity.NONE
            or item.b_stationary is False
        ):
            wrong.append(f"{where}: {item.sentence}")
    letter = certificate.stationarity.letter if certificate is not None else "-"
    return finding(
        f"The solver ends as {solved.outcome.name.lower()} at {solved.objective:.1e}, class {letter}"
        f"{'' if certificate is None or certificate.b_stationary is None else ', B-stationary'}; the origin itself: {origin.sentence}.",
        none_of(
            "what is lost or told wrongly",
            wrong,
            reason="the primal answer stays, and its class is neither S nor none",
        ),
        at_most("objective, off 0", abs(solved.objective), 1e-6, reason="the known optimum"),
    )


CASE = StressCase(
    title="Optimum that is B- but not S-stationary",
    expected="The primal answer is kept, and the class says so.",
    quick=True,
)

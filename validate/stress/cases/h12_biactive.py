"""Biactive pairs, force and gap both zero: the certificate must report stationarity.

Three touching carts at rest are all biactive. The origin of min (x - 1)^2 + (y - 1)^2 on two axes
is feasible, but not stationary.
"""

from __future__ import annotations

from typing import Any

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

from formulations.mpec import Stationarity, certify, certify_plan, solve_mpec
from models.catalog import load_scene
from validate.stress.case import Found, StressCase, at_most, finding, none_of, unlimited
from validate.stress.motion import rolled

STEPS = 50


def _corner() -> Any:
    """Minimise (x - 1)^2 + (y - 1)^2, 0 <= x complements y >= 0, at the origin."""
    m: Any = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(bounds=(0, None), initialize=0.0), pyo.Var(bounds=(0, None), initialize=0.0)
    m.cost = pyo.Objective(expr=(m.x - 1) ** 2 + (m.y - 1) ** 2)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    return m


def measure() -> Found:
    """Measure the case."""
    touching = (2.0, 2.5, 3.0, 0.0, 0.0, 0.0)
    scene = load_scene("three_cart").with_task(start=touching, goal=touching, steps=STEPS)
    plan = certify_plan(scene, rolled(scene))
    origin = certify(_corner())
    solved = solve_mpec(_corner())
    wrong = []
    if plan.biactive != 2 * STEPS or not plan.strong or not plan.holds:
        wrong.append(f"resting carts: {plan.sentence}")
    if (
        not origin.feasible
        or origin.biactive != 1
        or origin.stationarity is not Stationarity.WEAK
        or origin.b_stationary is not False
    ):
        wrong.append(f"origin: {origin.sentence}")
    certificate = solved.certificate
    if not solved.solved or certificate is None or not certificate.strong:
        wrong.append(f"from the origin: {solved.message}")
    return finding(
        f"Carts at rest: {plan.stationary_as}, {plan.biactive} of {plan.pairs} pairs biactive. The origin: feasible, {origin.stationary_as}; "
        f"from there the solver continues to {solved.objective:.3f}.",
        none_of(
            "stationarity reported wrongly",
            wrong,
            reason="S-stationary for the carts and the solution; the origin is not, and not B-stationary",
        ),
        at_most(
            "objective the solver reaches from the origin, off 1",
            abs(solved.objective - 1.0),
            1e-8,
            reason="the two solutions (1, 0), (0, 1)",
        ),
        unlimited("biactive pairs of the plan", plan.biactive),
    )


CASE = StressCase(
    title="Biactive pairs (force and gap both zero)",
    expected="Stationarity is reported, not only feasibility.",
    scenes=("three_cart",),
    quick=True,
)

"""Biactive pairs, force and gap both zero: the certificate must report stationarity.

Three touching carts at rest are all biactive. The origin of min (x - 1)^2 + (y - 1)^2 on two axes
is feasible, but not stationary.
"""

from __future__ import annotations

from typing import Any

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

from formulations.certificate.certificate import certify
from formulations.certificate.plan import certify_plan
from formulations.certificate.stationarity import Stationarity
from models.catalog import load_scene
from validate.stress.case import Found, StressCase, finding, none_of, unlimited
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
    return finding(
        f"Carts at rest: {plan.stationary_as}, {plan.biactive} of {plan.pairs} pairs biactive. The origin: feasible, {origin.stationary_as}.",
        none_of(
            "stationarity reported wrongly",
            wrong,
            reason="S-stationary for the carts; the origin is not, and not B-stationary",
        ),
        unlimited("biactive pairs of the plan", plan.biactive),
    )


CASE = StressCase(
    title="Biactive pairs (force and gap both zero)",
    expected="Stationarity is reported, not only feasibility.",
    scenes=("three_cart",),
    quick=True,
)

"""Solve MPECs written with pyomo.mpec: relax, polish to exact complementarity, certify.

pyo.SolverFactory("mpec_ipopt").solve(model)  # importing formulations registers the solver

result = solve_mpec(model, MpecSettings(strategy="scholtes"))  # the model is only read
load(result)
certify(model).sentence  # of any point
certify_plan(scene, trajectory).sentence  # of a plan, in the scene's strict model
"""

from __future__ import annotations

from formulations.certificate.certificate import Certificate, Multipliers, Tolerances, certify
from formulations.certificate.plan import certify_plan, certify_solution
from formulations.certificate.stationarity import Stationarity
from formulations.mpec.result import MpecResult, PairState, load
from formulations.mpec.solve import MpecIpopt, solve_mpec
from formulations.mpec.strategies import FALLBACKS, STRATEGY_NAMES, MpecSettings, read_settings

__all__ = [
    "FALLBACKS",
    "STRATEGY_NAMES",
    "Certificate",
    "MpecIpopt",
    "MpecResult",
    "MpecSettings",
    "Multipliers",
    "PairState",
    "Stationarity",
    "Tolerances",
    "certify",
    "certify_plan",
    "certify_solution",
    "load",
    "read_settings",
    "solve_mpec",
]

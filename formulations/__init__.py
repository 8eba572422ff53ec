"""How a plan is found: methods, the pipelines that chain them, and the Pyomo models they are built from.

    from formulations import build_model, ContactFormulation
    model = build_model("three_cart", ContactFormulation.SOFTPLUS, eps=1e-3)     # a plain pyomo ConcreteModel
    pyomo.environ.SolverFactory("touchstone_ipopt").solve(model)         # or any other solver; "mpec_ipopt" for complementarity

Importing this package registers both solvers with both of Pyomo's factories, and imports neither Pyomo, which comes when a model is built, nor PyTorch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from formulations.registration import register

if TYPE_CHECKING:
    from formulations.transcription.build import build_block, build_model, load_plan, read_plan
    from formulations.transcription.contact import ContactFormulation, ModelError, relax, set_relaxation
    from formulations.transcription.residuals import PlanResiduals

_HOME = {
    "ContactFormulation": "contact",
    "ModelError": "contact",
    "PlanResiduals": "residuals",
    "build_block": "build",
    "build_model": "build",
    "load_plan": "build",
    "read_plan": "build",
    "relax": "contact",
    "set_relaxation": "contact",
}

__all__ = [
    "ContactFormulation",
    "ModelError",
    "PlanResiduals",
    "build_block",
    "build_model",
    "load_plan",
    "read_plan",
    "relax",
    "set_relaxation",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"formulations.transcription.{_HOME[name]}"), name)


register()

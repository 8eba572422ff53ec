"""The exact planning problem of a linear scene as a mixed-integer quadratic program in Pyomo, with one binary variable a pair.

    model = build_miqp(scene, bounds)
    pyo.SolverFactory("scip_direct").solve(model)          # or Gurobi, or whatever Pyomo knows

    lam <= k h+ b,     lam - k phi <= -k l- (1 - b),     lam >= 0,     lam - k phi >= 0,     b in {0, 1}

on top of the plain model of `build_model` (same names). `mpec.simple_disjunction` and a big-M transformation make two binaries a pair and one
M for all; `python -m benchmarks proof --disjunction` says what that costs.
"""

from __future__ import annotations

from typing import Any

import pyomo.environ as pyo

from formulations.proof.bounds import PairBounds
from formulations.transcription.build import build_model
from formulations.transcription.contact_laws import ContactLaw, ModelError
from formulations.transcription.expressions import SceneExpressions
from models.dynamics import derive
from models.scene import Scene


def build_miqp(scene: Scene, bounds: PairBounds) -> pyo.ConcreteModel:
    """See the module docstring. The objective is `variable_cost`, at least the cost and at most the ceiling of the bounds.

    Raises ModelError for bounds that are infinite: they are the big-M.
    """
    if not bounds.is_finite:
        raise ModelError(
            f"scene {scene.name}: a penetration has no finite bound, so there is no big-M; bound the inputs or give a ceiling."
        )
    model: Any = build_model(scene, ContactLaw.COMPLEMENTARITY)
    model.objective_cost.deactivate()
    model.variable_cost = pyo.Var(bounds=(None, bounds.ceiling if bounds.ceiling < float("inf") else None))
    model.constraint_cost = pyo.Constraint(expr=model.variable_cost >= model.expression_cost)
    model.objective_bound = pyo.Objective(expr=model.variable_cost)
    if scene.nc:
        _add_pairs(model, scene, bounds)
    return model


def _add_pairs(model: Any, scene: Scene, bounds: PairBounds) -> None:
    law = SceneExpressions(derive(scene))
    p = list(model.parameter_scene.values()) if scene.parameters else []
    k = [float(pyo.value(entry)) for entry in law.stiffness(p)]
    model.complementarity_contact.deactivate()
    model.variable_closed = pyo.Var(model.set_steps, model.set_contacts, domain=pyo.Binary)
    model.constraint_pair = pyo.ConstraintList()
    for t in model.set_steps:
        phi = law.penetration([model.variable_q[t, name] for name in model.set_coordinates], p)
        for i, name in enumerate(model.set_contacts):
            force, closed = model.variable_lam[t, name], model.variable_closed[t, name]
            low, high = k[i] * min(float(bounds.lower[t, i]), 0.0), k[i] * max(float(bounds.upper[t, i]), 0.0)
            force.setub(high)
            if bounds.decided[t, i]:
                closed.fix(1 if bounds.lower[t, i] >= 0.0 and bounds.upper[t, i] > 0.0 else 0)
            separation = force - k[i] * phi[i]
            model.constraint_pair.add(force <= high * closed)
            model.constraint_pair.add(separation >= 0.0)
            model.constraint_pair.add(separation <= -low * (1 - closed))

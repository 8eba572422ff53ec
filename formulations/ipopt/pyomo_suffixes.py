"""Multipliers between Ipopt's signs and Pyomo's.

Ipopt: L = sense*f + lagrange' g - zl' x + zu' x with zl, zu >= 0. Pyomo (as its ipopt interface reports them): a dual is the change of the
model's objective when the constraint's bound grows by one, so that `min x, x >= 1` has dual +1; ipopt_zL_out and ipopt_zU_out likewise for
the bounds of a variable, so zU is negative when minimising.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pyomo.core.base import Block, Suffix

from formulations.ipopt.problem import IpoptProblem
from formulations.ipopt.result import IpoptResult
from formulations.ipopt.warm_start import Start


def pyomo_duals(problem: IpoptProblem, result: IpoptResult) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(dual (m,), zL (n,), zU (n,)) in Pyomo's signs."""
    return -problem.sense * result.lagrange, problem.sense * result.zl, -problem.sense * result.zu


def fill_suffixes(problem: IpoptProblem, result: IpoptResult) -> None:
    """Write multipliers into the import suffixes the model declares; a constraint without variables has none."""
    dual, lower, upper = pyomo_duals(problem, result)
    for name, components, values in (
        ("dual", problem.equations, dual),
        ("ipopt_zL_out", problem.variables, lower),
        ("ipopt_zU_out", problem.variables, upper),
    ):
        suffix = problem.layout.model.component(name)
        if isinstance(suffix, Suffix) and suffix.active and suffix.import_enabled():
            suffix.clear()
            suffix.update(zip(components, values.tolist(), strict=True))


def dual_start(problem: IpoptProblem) -> Start | None:
    """The start that the model's values and export suffixes describe; None where they hold no multiplier."""
    found = {
        "lagrange": _exported(problem.layout.model, "dual", problem.equations),
        "zl": _exported(problem.layout.model, "ipopt_zL_in", problem.variables),
        "zu": _exported(problem.layout.model, "ipopt_zU_in", problem.variables),
    }
    if all(values is None for values in found.values()):
        return None
    signs = {"lagrange": -problem.sense, "zl": problem.sense, "zu": -problem.sense}
    given = {name: signs[name] * values for name, values in found.items() if values is not None}
    return Start(x=problem.start()[0], **given)


def _exported(model: Any, name: str, components: tuple[Any, ...]) -> np.ndarray | None:
    """Values of the export suffixes of this name, on any active block; a component without entry has 0; None for no entry at all."""
    suffixes = [
        s
        for s in model.component_data_objects(Suffix, active=True, descend_into=Block)
        if s.local_name == name and s.export_enabled() and len(s)
    ]
    if not suffixes:
        return None
    values = np.zeros(len(components))
    for suffix in suffixes:
        for k, component in enumerate(components):
            number = suffix.get(component)
            if number is not None:
                values[k] = number
    return values

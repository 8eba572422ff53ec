"""Translate a Pyomo model for Ipopt once, and solve it again whenever its numbers change.

    problem = compile_model(model)  # any smooth ConcreteModel or Block
    result = solve(problem, options={"tol": 1e-9})  # IpoptResult; the model is unchanged
    load(problem, result)  # write the variables
    model.b.value = 14.0  # a mutable Param, a fixed variable or a bound
    problem.refresh()

Multipliers have Ipopt's signs, L = f + lagrange' g - zl' x + zu' x with f = sense * objective.
"""

from __future__ import annotations

from formulations.ipopt.model import MissingValueError, ModelRefusedError, StructureChangedError
from formulations.ipopt.options import UnknownOptionError
from formulations.ipopt.problem import IpoptProblem, compile_model
from formulations.ipopt.pyomo_solver import TouchstoneIpopt
from formulations.ipopt.result import IpoptResult, Iteration, load
from formulations.ipopt.solve import Start, solve

__all__ = [
    "IpoptProblem",
    "IpoptResult",
    "Iteration",
    "MissingValueError",
    "ModelRefusedError",
    "Start",
    "StructureChangedError",
    "TouchstoneIpopt",
    "UnknownOptionError",
    "compile_model",
    "load",
    "solve",
]

"""Pyomo model -> Ipopt, without AMPL executables: translate once, solve as often as the numbers change.

    from formulations.ipopt import Start, compile_model, load, solve

    # any smooth ConcreteModel or Block; ModelRefusedError says what is not
    problem = compile_model(model)
    result = solve(problem, options={"tol": 1e-9})    # IpoptResult; the model is untouched
    load(problem, result)                             # writes the variables

    model.b.value = 14.0  # a mutable Param, a fixed variable's value, a bound
    problem.refresh()  # read again; StructureChangedError if more than numbers changed
    again = solve(problem, warm_start=Start(x=result.x, lagrange=result.lagrange, zl=result.zl, zu=result.zu))

`result.outcome` is an `Outcome`, judged by `result.residuals` (unscaled, computed here, not by
Ipopt). Multipliers are in Ipopt's signs, L = f + lagrange' g - zl' x + zu' x, for the minimised
objective `problem.sense * f`. Positions: `problem.variables[j]` is x[j], `problem.equations[i]` is
lagrange[i].

`SolverFactory("touchstone_ipopt")` works like any Pyomo solver; importing `formulations` registers
it.
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

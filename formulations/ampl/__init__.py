"""AMPL's `.nl` files as Pyomo models, and a solver command for AMPL, JuMP, GAMS and Pyomo's `asl:`.

model = read_nl("bard1.nl")  # a ConcreteModel, with Complementarity
pyo.SolverFactory("mpec_ipopt").solve(model)

touchstone-mpec bard1 -AMPL strategy=scholtes  # in the shell: reads bard1.nl, writes bard1.sol
"""

from __future__ import annotations

from formulations.ampl.nl import NlError, read_nl

__all__ = ["NlError", "read_nl"]

"""AMPL's files: `.nl` problems read as Pyomo models, and a solver that AMPL, JuMP, GAMS' convert and Pyomo's `asl:` can call.

from formulations.ampl import read_nl
# a plain ConcreteModel, with Complementarity where rows complement variables
model = read_nl("bard1.nl")
pyo.SolverFactory("mpec_ipopt").solve(model)

touchstone-mpec bard1 -AMPL strategy=scholtes  # in the shell: reads bard1.nl, writes bard1.sol
"""

from __future__ import annotations

from formulations.ampl.nl import NlError, read_nl

__all__ = ["NlError", "read_nl"]

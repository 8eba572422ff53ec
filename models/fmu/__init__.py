"""FMUs of scenes: generated C in one hand-written shell, without Modelica.

    path = build_fmu(scene)  # FMI 2.0, Co-Simulation and Model Exchange
    path = build_fmu(scene, version="3.0", platforms=["win64"])
    names = variable_names(scene)  # names.q, names.v, names.u, names.lam, names.gap, ...

In `shell/`, model.h, equations.h, *_modes.h and integrator.h are independent of FMI; instance.h,
access.h, exchange.h and stepping.h of its version; fmi2.c and fmi3.c provide names and types.
"""

from models.fmu.package import build_fmu
from models.fmu.variables import VariableNames, variable_names

__all__ = ["VariableNames", "build_fmu", "variable_names"]

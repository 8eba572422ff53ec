"""FMUs from a scene's equations: generated C in one hand-written shell, without Modelica.

    path = build_fmu(scene)   FMI 2.0, Co-Simulation and Model Exchange in one file
    path = build_fmu(scene, version="3.0")          FMI 3.0, likewise
    path = build_fmu(scene, platforms=["win64"])
        binaries of other platforms, by the cross-compiler
    names = variable_names(scene)   names.q, names.v, names.u, names.lam, names.gap, ...

`shell/` is the C that all scenes share. model.h, equations.h, friction_modes.h, damping_modes.h and
integrator.h know no FMI; instance.h, access.h, exchange.h and stepping.h are what every version of
FMI does, whatever it calls it; fmi2.c and fmi3.c only give these the names and types of their
standard.
"""

from models.fmu.package import build_fmu
from models.fmu.variables import VariableNames, variable_names

__all__ = ["VariableNames", "build_fmu", "variable_names"]

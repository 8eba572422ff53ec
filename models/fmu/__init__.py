"""FMUs from a scene's equations: generated C in one hand-written shell, without Modelica.

    path = build_fmu(scene)            FMI 2.0, Co-Simulation and Model Exchange in one file
    names = variable_names(scene)      names.q, names.v, names.u, names.lam, names.gap, ...

`shell/` is the C that all scenes share: model.h, equations.h and integrator.h know no FMI; fmi2_*.c put them behind the
functions of FMI 2.0.
"""

from models.fmu.package import build_fmu
from models.fmu.variables import VariableNames, variable_names

__all__ = ["VariableNames", "build_fmu", "variable_names"]

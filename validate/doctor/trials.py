"""The trials themselves. Each runs in a child (`run_isolated`), returns a sentence of what was found, and raises where it cannot.

A trial ends with a number that is known beforehand: an installation that computes something else has failed it. Each imports what it tries by itself:
what cannot be imported is its finding, and nobody else's.
"""

from __future__ import annotations

import ctypes
import math
import tempfile
from pathlib import Path
from typing import Any

from models.catalog import load_scene
from models.codegen.cache import cache_folder
from models.codegen.compiler import compile_shared, find_compiler
from models.errors import MachineError

# The square root of 2 by Newton's iteration.
_NEWTON = """\
__attribute__((visibility("default"))) double trial(double x)
{
    double y = x;
    for (int i = 0; i < 8; i++) y = (y + x / y) / 2;
    return y;
}
"""


class TrialError(MachineError):
    """A trial that ran and found the wrong thing."""


def _compare(what: str, found: float, expected: float, tolerance: float) -> None:
    if not abs(found - expected) <= tolerance * max(1.0, abs(expected)):
        raise TrialError(f"{what} is {found:.12g}, but {expected:.12g} is right.")


def compiler(request: Any, arrays: Any) -> str:
    """Compile and load a C function."""
    found = find_compiler()
    with tempfile.TemporaryDirectory(prefix="touchstone-doctor-") as folder:
        library = Path(folder) / "trial.so"
        compile_shared(found, {"trial.c": _NEWTON}, library)
        function = ctypes.CDLL(str(library)).trial
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
        _compare("the square root of 2 by compiled C", function(2.0), math.sqrt(2.0), 1e-15)
    return found.describe()


def cache(request: Any, arrays: Any) -> str:
    """Write where compiled scenes and FMUs are kept, and leave nothing."""
    folder = cache_folder()
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix="touchstone-doctor-") as inside:
            Path(inside, "file").write_bytes(b"touchstone")
    except OSError as error:
        raise MachineError(f"the cache folder {folder} cannot be written to ({error.strerror}).") from error
    return f"compiled scenes and FMUs are kept in {folder}"


def ipopt(request: Any, arrays: Any) -> str:
    """Solve problem 71 of Hock and Schittkowski through Pyomo."""
    import pyomo.environ as pyo

    import formulations.ipopt  # noqa: F401 - registers the solver
    from formulations.ipopt.linear_solver import linear_solver
    from formulations.ipopt.solve import version

    model = pyo.ConcreteModel()
    model.x = pyo.Var(range(4), bounds=(1.0, 5.0), initialize={0: 1.0, 1: 5.0, 2: 5.0, 3: 1.0})
    x = model.x
    model.cost = pyo.Objective(expr=x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2])
    model.product = pyo.Constraint(expr=x[0] * x[1] * x[2] * x[3] >= 25.0)
    model.length = pyo.Constraint(expr=sum(x[i] ** 2 for i in range(4)) == 40.0)
    pyo.SolverFactory("touchstone_ipopt").solve(model)
    _compare("the optimum of problem 71 of Hock and Schittkowski", pyo.value(model.cost), 17.014017289156, 1e-7)
    return f"{version()}, linear systems by {linear_solver()}; the optimum of a known problem to 1e-7"


def gradient(request: Any, arrays: Any) -> str:
    """One gradient of PyTorch through the compiled rollout of the paper's scene, against a difference quotient."""
    import torch

    from formulations.shooting.rollout import rollout

    scene = load_scene("three_cart").with_task(steps=40)

    def loss(u: torch.Tensor) -> torch.Tensor:
        return (rollout(scene, u).q[-1] ** 2).sum()

    u = torch.full((40, scene.nu), 0.5, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(loss(u), u)
    with torch.no_grad():
        ahead, behind, step = u.clone(), u.clone(), 1e-4
        ahead[3, 0] += step
        behind[3, 0] -= step
        quotient = float((loss(ahead) - loss(behind)) / (2 * step))
    _compare("a gradient through the compiled rollout", float(slope[3, 0]), quotient, 1e-7)
    return f"PyTorch {torch.__version__}, a gradient through the compiled rollout equals its difference quotient"


def fmu(request: Any, arrays: Any) -> str:
    """Export a scene, run it by Model Exchange and Co-Simulation, and hold the fall against the closed form."""
    from validate.stress.motion import replayed, rolled

    scene = load_scene("bouncing_mass").with_task(steps=5)
    result = replayed(scene, rolled(scene))
    if len(result.t) == 0:
        raise TrialError(f"the FMU of a scene could not be run: {result.message or result.outcome.value}")
    gravity = scene.parameter_values[next(p.symbol for p in scene.parameters if p.name == "g")]
    time = float(result.t[-1])
    expected = scene.task.start[0] + scene.task.start[1] * time - gravity * time**2 / 2
    _compare("the height of a falling mass in its FMU", float(result.q[-1, 0]), expected, 1e-9)
    return "an FMU was exported and run by Model Exchange and Co-Simulation; the fall is right to 1e-9"


def integer_programs(request: Any, arrays: Any) -> str:
    """Whether the extra [global] is there and solves a knapsack."""
    try:
        from pyscipopt import Model, quicksum
    except ImportError:
        return ""
    model = Model()
    model.hideOutput()
    take = [model.addVar(vtype="B") for _ in range(4)]
    model.addCons(quicksum(w * x for w, x in zip((5, 4, 3, 2), take, strict=True)) <= 9)
    model.setObjective(quicksum(c * x for c, x in zip((10, 9, 7, 3), take, strict=True)), "maximize")
    model.optimize()
    _compare("the optimum of a knapsack", model.getObjVal(), 19.0, 1e-9)
    return f"SCIP {model.version()}"

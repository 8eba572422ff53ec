"""The same plan through the same FMU by FMPy's own `simulate_fmu`: Co-Simulation, one communication step a step of the plan."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import Size, Work
from benchmarks.suite.carts import pushed_plan, scene_of
from models.fmu import build_fmu, variable_names

# Internal steps a plan step, as in our Co-Simulation (benchmarks.suite.stages).
FINENESS = 50


def simulate(size: Size, folder: Path) -> Work:
    import fmpy

    scene, plan = scene_of(size), pushed_plan(size)
    names, step = variable_names(scene), scene.task.step
    unzipped = fmpy.extract(str(build_fmu(scene)), unzipdir=tempfile.mkdtemp(dir=folder))
    description = fmpy.read_model_description(unzipped)
    # One row a node: FMPy reads the input at the start of each communication step.
    held = np.vstack([plan.u, plan.u[-1:]])
    inputs = np.zeros(len(plan.t), dtype=[("time", float), *((name, float) for name in names.u)])
    inputs["time"] = plan.t
    for column, name in enumerate(names.u):
        inputs[name] = held[:, column]
    settings: dict[str, Any] = {
        "start_values": {names.internal_step: step / FINENESS},
        "fmi_type": "CoSimulation",
        "output": [*names.q, *names.v, *names.lam],
        "output_interval": step,
        "input": inputs,
        "model_description": description,
    }
    fmpy.simulate_fmu(unzipped, stop_time=5 * step, **settings)

    def work() -> Mapping[str, Any]:
        result = fmpy.simulate_fmu(unzipped, stop_time=float(plan.t[-1]), **settings)
        return {
            "outcome": "completed",
            "iterations": len(result),
            "value": float(result[names.q[0]][-1]),
        }

    return work

"""The co-simulation master libcosim (Open Simulation Platform) on the parts of a scene: fixed steps, and its ECCO algorithm.

ECCO (Sadjina and Pedersen, Energy conservation and coupling error reduction in non-iterative
co-simulations, 2020) takes pairs of connections that are a power bond - a velocity one way, a force
the other - and chooses the step by the power that the two sides disagree on.

It comes with the extra `[fmu-check]` and is optional. It ends the process it runs in on what it
    does not like, so it runs in a child of its
own: `run_libcosim` describes the system in a file, `python -m benchmarks.cosim.libcosim JOB RESULT`
    steps it.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.measure import run_child
from validate.store.disk import disk_error, temporary_folder

FIXED = "fixed"
ECCO = "ecco"
# ECCO may shorten its step to this share of the longest one.
SHORTEST = 0.1
_NANO = 1e9
# A child that hangs is ended after this long [s]; the largest study takes some tens of seconds a
# run.
_PATIENCE = 600.0


def libcosim_refusal() -> str | None:
    """None, or why it cannot run here."""
    if importlib.util.find_spec("libcosimpy") is None:
        return "libcosimpy is not installed; it comes with: pip install -e '.[fmu-check]'"
    return None


def run_libcosim(
    scene: Any,
    start: np.ndarray,
    u: np.ndarray,
    h: float,
    times: np.ndarray,
    inner_step: float,
    algorithm: str,
) -> tuple[np.ndarray, np.ndarray, float, int] | str:
    """(time reached [s] (n,), motion there (n, 2 nq), CPU seconds, steps), or a sentence why it failed. Raises MachineError where its files cannot be written.

    times: when the motion is wanted; ECCO's own steps pass them by less than h. h: the step, of
        ECCO the longest one.
    """
    job = _job(scene, start, u, h, times, inner_step, algorithm)
    with temporary_folder("touchstone-cosim-") as folder:
        paths = [folder / name for name in ("job.json", "result.json")]
        try:
            paths[0].write_text(json.dumps(job), encoding="utf-8")
        except OSError as error:
            raise disk_error(paths[0], error) from error
        try:
            code = run_child(
                "benchmarks.cosim.libcosim", *map(str, paths), timeout=_PATIENCE
            ).returncode
        except subprocess.TimeoutExpired:
            return f"libcosim did not end within {_PATIENCE:g} s"
        if code != 0 or not paths[1].is_file():
            return f"libcosim ended with code {code}"
        told = json.loads(paths[1].read_text(encoding="utf-8"))
    return np.array(told["t"]), np.array(told["motion"]), float(told["cpu_s"]), int(told["steps"])


def _job(
    scene: Any,
    start: np.ndarray,
    u: np.ndarray,
    h: float,
    times: np.ndarray,
    inner_step: float,
    algorithm: str,
) -> dict[str, Any]:
    from models.fmu.coupled import build_part, split
    from validate.fmi.description import read_package

    parts = split(scene)
    names = [item.name for item in scene.coordinates] + [
        item.velocity_name for item in scene.coordinates
    ]
    values = {item.name: item.value for item in scene.parameters} | dict(
        zip(names, start.tolist(), strict=True)
    )
    values |= {item.name: float(value) for item, value in zip(scene.inputs, u, strict=True)} | {
        "internal_step": inner_step
    }
    order = [part.name for part in (*parts.bodies, *parts.contacts)]
    references, slaves = {}, []
    for part in (*parts.bodies, *parts.contacts):
        path = build_part(part)
        variables = {
            item.name: int(item.valueReference)
            for item in read_package(path).description.modelVariables
        }
        references[part.name] = variables
        initial = [(variables[name], value) for name, value in values.items() if name in variables]
        slaves.append({"name": part.name, "path": str(path), "initial": initial})

    def place(part: str, name: str) -> tuple[int, int]:
        return order.index(part), references[part][name]

    home = {item: body.name for body in parts.bodies for item in body.coordinates}
    bonds = []
    for part in parts.contacts:
        for item in part.coordinates:
            body, push = home[item], part.force_name(item)
            back, here = references[body][push], references[part.name][item.velocity_name]
            bonds.append((*place(body, item.velocity_name), back, *place(part.name, push), here))
    return {
        "algorithm": algorithm,
        "h": h,
        "times": times.tolist(),
        "slaves": slaves,
        "connections": [
            (*place(item.source, item.output), *place(item.target, item.input))
            for item in parts.connections
        ],
        "bonds": bonds if algorithm == ECCO else [],
        "states": [place(home[item], item.name) for item in scene.coordinates]
        + [place(home[item], item.velocity_name) for item in scene.coordinates],
    }


def _child(job: dict[str, Any]) -> dict[str, Any]:
    algorithms, executions, observers, slaves = (
        importlib.import_module(f"libcosimpy.Cosim{name}")
        for name in ("Algorithm", "Execution", "Observer", "Slave")
    )
    h = job["h"]
    algorithm: Any = None
    if job["algorithm"] == ECCO:
        algorithm = algorithms.CosimAlgorithm.create_ecco_algorithm(
            algorithms.EccoParams(step_size=h, min_step_size=h * SHORTEST, max_step_size=h)
        )
        execution = executions.CosimExecution.from_algorithm(algorithm)
    else:
        execution = executions.CosimExecution.from_step_size(round(h * _NANO))
    for item in job["slaves"]:
        index = execution.add_local_slave(
            slaves.CosimLocalSlave(fmu_path=item["path"], instance_name=item["name"])
        )
        for reference, value in item["initial"]:
            execution.real_initial_value(index, reference, value)
    for connection in job["connections"]:
        execution.connect_real_variables(*connection)
    for bond in job["bonds"]:
        algorithm.add_power_bond(*bond)
    observer = observers.CosimObserver.create_last_value()
    execution.add_observer(observer)
    reached, motion, steps, seconds = [], [], 0, 0.0
    for time in job["times"]:
        began = process_time()
        while execution.status().current_time < time * _NANO - 1:
            # Fixed steps that divide the wait are taken at one call, as a user would.
            count = (
                max(1, round((time - execution.status().current_time / _NANO) / h))
                if algorithm is None
                else 1
            )
            execution.step(count)
            steps += count
        seconds += process_time() - began
        reached.append(execution.status().current_time / _NANO)
        motion.append(
            [observer.last_real_values(index, [reference])[0] for index, reference in job["states"]]
        )
    return {"t": reached, "motion": motion, "cpu_s": seconds, "steps": steps}


if __name__ == "__main__":
    told = _child(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
    Path(sys.argv[2]).write_text(json.dumps(told), encoding="utf-8")

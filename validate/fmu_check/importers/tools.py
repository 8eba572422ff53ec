"""What runs in the process of an importer: each function runs an FMU as the importer's own documentation says, and gives the values that were asked for.

    run_importer({"importer": "fmuloader", "path": ..., "fmi": "2.0", ...}, {}) -> {"values": [...]}

is what the child runs (validate.execution.isolated).
"""

from __future__ import annotations

import contextlib
import importlib
import io
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from validate.fmi.archive import FmuError

# Of FMPy's CVODE.
_TOLERANCE = 1e-9


def _module(name: str) -> Any:
    """Imported where it is run: a checker of types does without it."""
    return importlib.import_module(name)


def fmpy(job: dict[str, Any]) -> list[float]:
    """By simulate_fmu, with the communication steps of the job, or CVODE's."""
    from fmpy import simulate_fmu

    whole = {"ME": "ModelExchange", "CS": "CoSimulation"}[job["type"]]
    begin, end = job["steps"][0][0], sum(job["steps"][-1])
    given = {name: value for name, _, value in job["inputs"]}
    result = simulate_fmu(
        job["path"], validate=False, fmi_type=whole, start_time=begin, stop_time=end, output_interval=job["steps"][0][1], start_values=given,
        output=job["names"], relative_tolerance=_TOLERANCE if job["type"] == "ME" else None,
    )  # fmt: skip
    return [float(result[name][-1]) for name in job["names"]]


def fmuloader(job: dict[str, Any]) -> list[float]:
    """Its classes of a slave, call by call."""
    begin = job["steps"][0][0]
    if job["fmi"] == "2.0":
        loader = _module("fmuloader.fmi2")
        fmu = loader.Fmi2Slave(job["path"], model_identifier=job["identifier"])
        fmu.instantiate("it", loader.Fmi2Type.CO_SIMULATION, guid=job["token"])
        fmu.setup_experiment(begin)
        fmu.enter_initialization_mode()
        get, put = fmu.get_real, fmu.set_real
    else:
        fmu = _module("fmuloader.fmi3").Fmi3Slave(job["path"], model_identifier=job["identifier"])
        fmu.instantiate_co_simulation("it", instantiation_token=job["token"])
        fmu.enter_initialization_mode(start_time=begin)
        get, put = fmu.get_float64, fmu.set_float64
    if job["inputs"]:
        put([reference for _, reference, _ in job["inputs"]], [value for _, _, value in job["inputs"]])
    fmu.exit_initialization_mode()
    for time, step in job["steps"]:
        fmu.do_step(time, step)
    values = list(get(job["references"]))
    fmu.terminate()
    fmu.free_instance()
    return values


def libcosimpy(job: dict[str, Any]) -> list[float]:
    """A co-simulation of one, whose steps are whole nanoseconds from 0 on."""
    if job["steps"][0][0] != 0.0:
        raise FmuError(f"it begins at 0 s, and the FMU's experiment at {job['steps'][0][0]:g} s")
    execution = _module("libcosimpy.CosimExecution").CosimExecution.from_step_size(round(1e9 * job["steps"][0][1]))
    index = execution.add_local_slave(_module("libcosimpy.CosimSlave").CosimLocalSlave(fmu_path=job["path"], instance_name="it"))
    for _, reference, value in job["inputs"]:
        execution.real_initial_value(index, reference, value)
    observer = _module("libcosimpy.CosimObserver").CosimObserver.create_last_value()
    execution.add_observer(observer)
    execution.simulate_until(round(1e9 * sum(job["steps"][-1])))
    return list(observer.last_real_values(index, job["references"]))


def casadi(job: dict[str, Any]) -> list[float]:
    """CVODES over DaeBuilder's function of the unpacked FMU; it takes no imported FMU to Event Mode."""
    ca = _module("casadi")
    dae = ca.DaeBuilder("model", job["folder"])
    n, m = len(dae.x()), len(dae.u())
    if (n, m) != (len(job["references"]), len(job["inputs"])):
        raise FmuError(f"it finds {n} states and {m} inputs, where there are {len(job['references'])} and {len(job['inputs'])}")
    f = dae.create("f", ["x", "u"] if m else ["x"], ["ode"])
    x, p = ca.MX.sym("x", n), ca.MX.sym("p", m)
    tight = {"reltol": 1e-11, "abstol": 1e-12}
    flow = ca.integrator(
        "flow", "cvodes", {"x": x, "p": p, "ode": f(x, p) if m else f(x)}, job["steps"][0][0], sum(job["steps"][-1]), tight
    )
    return np.array(flow(x0=dae.start(dae.x()), p=[value for _, _, value in job["inputs"]])["xf"]).ravel().tolist()


def fmutool(job: dict[str, Any]) -> list[str]:
    """What its checker complains of; the words of its exit where it breaks off."""
    sys.argv = ["fmutool", "-input", job["path"], "-check"]
    said, code = io.StringIO(), 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            _module("fmu_manipulation_toolbox.cli.fmutool").fmutool()
        except SystemExit as end:
            code = end.code or 0
    lines = said.getvalue().splitlines()
    compliant = any(f"compliant with FMI-{job['fmi']}" in line for line in lines) and any("No semantic error" in line for line in lines)
    told = [
        line.strip() for line in lines if "WARNING" in line or "ERROR" in line or ("error" in line.lower() and "No semantic" not in line)
    ]
    return told if told or (compliant and not code) else [f"it ends with code {code} and says: {' '.join(lines[-3:])}"]


class Importer(NamedTuple):
    """One of them: how it is called and installed, the interfaces it takes - (version of FMI, type) -, and what runs in its process."""

    title: str
    package: str
    module: str
    takes: tuple[tuple[int, str], ...]
    run: Callable[[dict[str, Any]], Any]


IMPORTERS = {
    item.title: item
    for item in (
        Importer("FMPy", "FMPy", "fmpy", ((2, "ME"), (2, "CS"), (3, "ME"), (3, "CS")), fmpy),
        Importer("fmuloader", "fmuloader", "fmuloader", ((2, "CS"), (3, "CS")), fmuloader),
        Importer("libcosimpy", "libcosimpy", "libcosimpy", ((2, "CS"),), libcosimpy),
        Importer("CasADi", "casadi", "casadi", ((2, "ME"), (3, "ME")), casadi),
        Importer("fmutool", "fmu-manipulation-toolbox", "fmu_manipulation_toolbox", (), fmutool),
    )
}


def run_importer(request: dict[str, Any], _arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """See the module docstring. Raises what the importer raises."""
    return {"values": IMPORTERS[request["importer"]].run(request)}

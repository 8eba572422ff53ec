"""Importers and checkers of other projects on one FMU; `run_importer` runs in a child process, because some of them crash.

They come with the extra `[fmu-check]`.
"""

import contextlib
import io
import sys
from importlib import import_module


def fmuloader(job):
    """Return the values after Co-Simulation by fmuloader, call by call."""
    begin = job["steps"][0][0]
    if job["fmi"] == "2.0":
        loader = import_module("fmuloader.fmi2")
        fmu = loader.Fmi2Slave(job["path"], model_identifier=job["identifier"])
        fmu.instantiate("it", loader.Fmi2Type.CO_SIMULATION, guid=job["token"])
        fmu.setup_experiment(begin)
        fmu.enter_initialization_mode()
        get, put = fmu.get_real, fmu.set_real
    else:
        fmu = import_module("fmuloader.fmi3").Fmi3Slave(
            job["path"], model_identifier=job["identifier"]
        )
        fmu.instantiate_co_simulation("it", instantiation_token=job["token"])
        fmu.enter_initialization_mode(start_time=begin)
        get, put = fmu.get_float64, fmu.set_float64
    if job["inputs"]:
        put(
            [reference for _, reference, _ in job["inputs"]],
            [value for _, _, value in job["inputs"]],
        )
    fmu.exit_initialization_mode()
    for time, step in job["steps"]:
        fmu.do_step(time, step)
    values = list(get(job["references"]))
    fmu.terminate()
    fmu.free_instance()
    return values


def libcosimpy(job):
    """Return the values after a co-simulation of one FMU, whose steps are whole nanoseconds from 0 on."""
    execution = import_module("libcosimpy.CosimExecution").CosimExecution.from_step_size(
        round(1e9 * job["steps"][0][1])
    )
    index = execution.add_local_slave(
        import_module("libcosimpy.CosimSlave").CosimLocalSlave(
            fmu_path=job["path"], instance_name="it"
        )
    )
    for _, reference, value in job["inputs"]:
        execution.real_initial_value(index, reference, value)
    observer = import_module("libcosimpy.CosimObserver").CosimObserver.create_last_value()
    execution.add_observer(observer)
    execution.simulate_until(round(1e9 * sum(job["steps"][-1])))
    return list(observer.last_real_values(index, job["references"]))


def fmutool(job):
    """Return the complaints of fmutool's checker, or its last words if it breaks off."""
    sys.argv = ["fmutool", "-input", job["path"], "-check"]
    said, code = io.StringIO(), 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            import_module("fmu_manipulation_toolbox.cli.fmutool").fmutool()
        except SystemExit as end:
            code = end.code or 0
    lines = said.getvalue().splitlines()
    compliant = any(f"compliant with FMI-{job['fmi']}" in line for line in lines) and any(
        "No semantic error" in line for line in lines
    )
    told = [
        line.strip()
        for line in lines
        if "WARNING" in line
        or "ERROR" in line
        or ("error" in line.lower() and "No semantic" not in line)
    ]
    return (
        told
        if told or (compliant and not code)
        else [f"it ends with code {code} and says: {' '.join(lines[-3:])}"]
    )


_IMPORTERS = {"fmuloader": fmuloader, "libcosimpy": libcosimpy, "fmutool": fmutool}


def run_importer(request, _arrays):
    """Run in the child process. Raises what the importer raises."""
    return {"values": _IMPORTERS[request["importer"]](request)}

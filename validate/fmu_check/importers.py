"""Other people's importers: each runs the FMU in a process of its own, and its numbers are compared with ours. They come with the extra `[fmu-check]`.

    run_importer({"importer": "fmuloader", "path": ..., "fmi": "2.0", ...}, {}) -> {"values": [...]}

is what that process runs (validate.execution.isolated): one function an importer, which goes as the
importer's own documentation says. A fault is the importer's or the FMU's, which nobody can tell
from here: so it is advice, with the version and what was measured.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import importlib.util
import io
import sys
from collections.abc import Callable
from importlib import import_module  # where each is run: a checker of types does without them
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from validate.execution.isolated import Limits, run_isolated
from validate.fmi.archive import INTERFACES, FmuError
from validate.fmi.description import REAL
from validate.fmu_check.check import Check, Finding, Scope, advice, check, not_offered, passed
from validate.fmu_check.reference import ErrorBounded, Signals, solve
from validate.fmu_check.subject import (
    NOTHING,
    Block,
    CheckedInstance,
    FmuVariable,
    Settings,
    Subject,
)

# Of FMPy's CVODE.
_TOLERANCE = 1e-9


def fmpy(job: dict[str, Any]) -> list[float]:
    """By simulate_fmu, with the communication steps of the job, or CVODE's."""
    from fmpy import simulate_fmu

    begin, end = job["steps"][0][0], sum(job["steps"][-1])
    given = {name: value for name, _, value in job["inputs"]}
    result = simulate_fmu(
        job["path"], validate=False, fmi_type=INTERFACES[job["type"]], start_time=begin,
        stop_time=end, output_interval=job["steps"][0][1], start_values=given,
        output=job["names"], relative_tolerance=_TOLERANCE if job["type"] == "ME" else None,
    )  # fmt: skip
    return [float(result[name][-1]) for name in job["names"]]


def fmuloader(job: dict[str, Any]) -> list[float]:
    """Its classes of a slave, call by call."""
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


def libcosimpy(job: dict[str, Any]) -> list[float]:
    """A co-simulation of one, whose steps are whole nanoseconds from 0 on."""
    if job["steps"][0][0] != 0.0:
        raise FmuError(f"it begins at 0 s, and the FMU's experiment at {job['steps'][0][0]:g} s")
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


def casadi(job: dict[str, Any]) -> list[float]:
    """CVODES over DaeBuilder's function of the unpacked FMU.

    It takes no imported FMU to Event Mode.
    """
    ca = import_module("casadi")
    dae = ca.DaeBuilder("model", job["folder"])
    n, m = len(dae.x()), len(dae.u())
    if (n, m) != (len(job["references"]), len(job["inputs"])):
        raise FmuError(
            f"it finds {n} states and {m} inputs, where there are {len(job['references'])} and {len(job['inputs'])}"
        )
    f = dae.create("f", ["x", "u"] if m else ["x"], ["ode"])
    x, p = ca.MX.sym("x", n), ca.MX.sym("p", m)
    tight = {"reltol": 1e-11, "abstol": 1e-12}
    flow = ca.integrator(
        "flow",
        "cvodes",
        {"x": x, "p": p, "ode": f(x, p) if m else f(x)},
        job["steps"][0][0],
        sum(job["steps"][-1]),
        tight,
    )
    return (
        np.array(flow(x0=dae.start(dae.x()), p=[value for _, _, value in job["inputs"]])["xf"])
        .ravel()
        .tolist()
    )


def fmutool(job: dict[str, Any]) -> list[str]:
    """What its checker complains of; the words of its exit where it breaks off."""
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


# Steps of the run, seconds and memory of the importer's process.
_STEPS = 100
_LIMITS = Limits(seconds=40.0, memory=4 * 1024**3)
# Of a value's size: what Co-Simulation may differ where the same steps are made, and Model Exchange
# with another integrator beside what ours is off itself.
_SAME_STEPS = 1e-6
_OTHER_SOLVER = 1e-5
# Of the time to the first event: how far an importer goes that handles none.
_BEFORE = 0.9


def _asked(importer: Importer, subject: Subject, job: dict[str, Any]) -> tuple[str, Any, str]:
    """Its name with the version, what it answered, and why it did not."""
    who = f"{importer.title} {importlib.metadata.version(importer.package)}"
    job |= {
        "importer": importer.title,
        "path": str(subject.path.resolve()),
        "fmi": "2.0" if subject.major == 2 else "3.0",
    }
    done = run_isolated("validate.fmu_check.importers:run_importer", job, limits=_LIMITS, what=who)
    return (
        who,
        done.value["values"] if done.ok else None,
        "" if done.ok else done.sentence.rstrip("."),
    )


def _compared(importer: Importer, subject: Subject, kind: str) -> Finding:
    if (subject.major, kind) not in importer.takes:
        return not_offered(f"{importer.title} takes no FMI {subject.major}.0 as {kind}.")
    plain = all(
        _is_plain(item) for item in subject.continuous_inputs
    )  # else they stay at their starts
    given = (subject.continuous_inputs, subject.inputs_at(0)) if plain else NOTHING
    watched = {
        item.reference: item for item in (*subject.states, *subject.outputs) if _is_plain(item)
    }
    block = subject.states if importer.run is casadi else Block(watched.values())
    if not block or (importer.run is casadi and not plain):
        return not_offered(
            "there is nothing to compare: no outputs and no states that are single numbers."
        )
    steps = subject.before_end(kind, min(subject.steps(kind), _STEPS))
    try:
        end, ours, bars = _ours(
            subject, kind, block, given, steps, before_events=importer.run is casadi
        )
    except FmuError as error:
        return not_offered(f"we cannot tell either: {str(error).rstrip('.')}.")
    whole = end - subject.start_time
    points = [
        subject.time(place) if kind == "CS" else subject.start_time + whole * place / steps
        for place in range(steps + 1)
    ]
    job = {
        "folder": str(subject.folder), "type": kind,
        "identifier": subject.interface(kind).modelIdentifier, "token": subject.description.guid,
        "names": block.names, "references": block.references,
        "inputs": [[item.name, item.reference, value] for item,
                   value in zip(given[0], given[1].tolist(), strict=True)],
        "steps": [(begin, subject.step if kind == "CS" else after - begin) for begin,
                  after in pairwise(points)],
    }  # fmt: skip
    who, theirs, problem = _asked(importer, subject, job)
    if problem:
        return advice(f"{problem}.")
    size = np.maximum(np.abs(ours), block.scales)
    away = np.abs(np.array(theirs) - ours) / size
    worst = int(np.argmax(np.nan_to_num(away - bars / size, nan=np.inf)))
    found = f"{who}: {len(ours)} values at t = {end:.6g} s, off by {away.max():.2g} of their size"
    if away[worst] <= bars[worst] / size[worst]:
        return passed(f"{found}.")
    return advice(
        f"{found}: {block.names[worst]} is {theirs[worst]:.9g} there and {ours[worst]:.9g} by us."
    )


def _is_plain(item: FmuVariable) -> bool:
    return item.size == 1 and item.type in REAL


def _ours(
    subject: Subject, kind: str, watched: Block, given: Settings, steps: int, *, before_events: bool
) -> tuple[float, np.ndarray, np.ndarray]:
    """End of the run [s], values (entries,) [unit of each] there by our own calls, and what an importer may be off."""
    if kind == "CS":
        with CheckedInstance(subject, kind).begin(during=given) as instance:
            for step in range(steps):
                instance.make_step(step)
            values = instance.get(watched)
        return subject.time(steps), values, _SAME_STEPS * np.maximum(np.abs(values), watched.scales)
    variables, values = given
    signals = Signals(np.array([subject.start_time]), variables, values[np.newaxis])

    def solved(end: float) -> ErrorBounded:
        return solve(subject, kind, np.array([subject.start_time, end]), signals, watched)

    found = solved(end := subject.time(steps))
    if before_events and (later := found.events[found.events > subject.start_time]).size:
        found = solved(end := subject.start_time + _BEFORE * (float(later[0]) - subject.start_time))
    return (
        end,
        found.values[-1],
        found.bars[-1] + _OTHER_SOLVER * np.maximum(np.abs(found.values[-1]), watched.scales),
    )


def _check(importer: Importer) -> Check:
    def by_it(subject: Subject, *kind: str) -> Finding:
        if importlib.util.find_spec(importer.module) is None:
            return not_offered(
                f"{importer.title} is not installed; it comes with the extra [fmu-check]."
            )
        if importer.takes:
            return _compared(importer, subject, *kind)
        who, told, problem = _asked(importer, subject, {})
        return (
            advice(f"{problem or f'{who}: ' + '; '.join(told)}.")
            if problem or told
            else passed(f"{who} finds nothing.")
        )

    claim = "It runs, and its numbers are ours: in the same steps, or as exact as the integrators"
    by_it.__doc__ = claim if importer.takes else "It complains of nothing"
    return check(f"importer {importer.title}", Scope.EACH if importer.takes else Scope.FILE)(by_it)


CHECKS = tuple(map(_check, IMPORTERS.values()))

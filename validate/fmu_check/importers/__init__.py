"""Other people's importers: each runs the FMU in a process of its own, and its numbers are compared with ours. They come with the extra `[fmu-check]`.

A fault is the importer's or the FMU's, which nobody can tell from here: so it is advice, with the version and what was measured.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from validate.execution.isolated import Limits, run_isolated
from validate.fmi.archive import FmuError
from validate.fmi.description import REAL
from validate.fmu_check.check import Check, Finding, Scope, advice, check, not_offered, passed
from validate.fmu_check.importers.tools import IMPORTERS, Importer, casadi
from validate.fmu_check.reference import ErrorBounded, Signals, solve
from validate.fmu_check.subject import NOTHING, Block, CheckedInstance, FmuVariable, Settings, Subject

# Steps of the run, seconds and memory of the importer's process.
_STEPS, _LIMITS = 100, Limits(seconds=40.0, memory=4 * 1024**3)
# Of a value's size: what Co-Simulation may differ where the same steps are made, and Model Exchange with another integrator beside what ours is off itself.
_SAME_STEPS, _OTHER_SOLVER = 1e-6, 1e-5
# Of the time to the first event: how far an importer goes that handles none.
_BEFORE = 0.9


def _job(subject: Subject, kind: str, watched: Block, given: Settings, steps: list[tuple[float, float]]) -> dict[str, Any]:
    """What an importer is asked for."""
    variables, values = given
    return {
        "path": str(subject.path.resolve()),
        "folder": str(subject.folder),
        "fmi": "2.0" if subject.major == 2 else "3.0",
        "type": kind,
        "identifier": subject.interface(kind).modelIdentifier,
        "token": subject.description.guid,
        "names": watched.names,
        "references": [item.reference for item in watched],
        "inputs": [[item.name, item.reference, value] for item, value in zip(variables, values.tolist(), strict=True)],
        "steps": steps,
    }


def _asked(importer: Importer, job: dict[str, Any]) -> tuple[str, Any, str]:
    """Its name with the version, what it answered, and why it did not."""
    who = f"{importer.title} {importlib.metadata.version(importer.package)}"
    done = run_isolated("validate.fmu_check.importers.tools:run_importer", {**job, "importer": importer.title}, limits=_LIMITS, what=who)
    return who, done.value["values"] if done.ok else None, "" if done.ok else done.sentence.rstrip(".")


def _absent(importer: Importer) -> Finding | None:
    if importlib.util.find_spec(importer.module) is not None:
        return None
    return not_offered(f"{importer.title} is not installed; it comes with the extra [fmu-check].")


def _complaints(importer: Importer, subject: Subject) -> Finding:
    if absent := _absent(importer):
        return absent
    who, told, problem = _asked(importer, {"path": str(subject.path.resolve()), "fmi": "2.0" if subject.major == 2 else "3.0"})
    if problem or told:
        return advice(f"{problem or f'{who}: ' + '; '.join(told)}.")
    return passed(f"{who} finds nothing.")


def _compared(importer: Importer, subject: Subject, kind: str) -> Finding:
    if absent := _absent(importer):
        return absent
    if (subject.major, kind) not in importer.takes:
        return not_offered(f"{importer.title} takes no FMI {subject.major}.0 as {kind}.")
    plain = all(_is_plain(item) for item in subject.continuous_inputs)  # else they stay at their starts
    given = (subject.continuous_inputs, subject.inputs_at(0)) if plain else NOTHING
    watched = {item.reference: item for item in (*subject.states, *subject.outputs) if _is_plain(item)}
    block = subject.states if importer.run is casadi else Block(watched.values())
    if not block or (importer.run is casadi and not plain):
        return not_offered("there is nothing to compare: no outputs and no states that are single numbers.")
    steps = subject.before_end(kind, min(subject.steps(kind), _STEPS))
    try:
        end, ours, bars = _ours(subject, kind, block, given, steps, before_events=importer.run is casadi)
    except FmuError as error:
        return not_offered(f"we cannot tell either: {str(error).rstrip('.')}.")
    points = [subject.start_time + (end - subject.start_time) * place / steps for place in range(steps + 1)]
    if kind == "CS":
        points = [subject.time(place) for place in range(steps + 1)]
    job = _job(subject, kind, block, given, [(begin, subject.step if kind == "CS" else after - begin) for begin, after in pairwise(points)])
    who, theirs, problem = _asked(importer, job)
    if problem:
        return advice(f"{problem}.")
    size = np.maximum(np.abs(ours), block.scales)
    away = np.abs(np.array(theirs) - ours) / size
    worst = int(np.argmax(np.nan_to_num(away - bars / size, nan=np.inf)))
    found = f"{who}: {len(ours)} values at t = {end:.6g} s, off by {away.max():.2g} of their size"
    if away[worst] <= bars[worst] / size[worst]:
        return passed(f"{found}.")
    return advice(f"{found}: {block.names[worst]} is {theirs[worst]:.9g} there and {ours[worst]:.9g} by us.")


def _is_plain(item: FmuVariable) -> bool:
    return item.size == 1 and item.type in REAL


def _ours(
    subject: Subject, kind: str, watched: Block, given: Settings, steps: int, *, before_events: bool
) -> tuple[float, np.ndarray, np.ndarray]:
    """End of the run [s], values (entries,) [unit of each] there by our own calls, and what an importer may be off."""
    if kind == "CS":
        with CheckedInstance(subject, kind) as instance:
            instance.begin(during=given)
            for step in range(steps):
                instance.do_step(subject.time(step), subject.step)
            values = instance.get(watched)
        return subject.time(steps), values, _SAME_STEPS * np.maximum(np.abs(values), watched.scales)
    variables, values = given
    signals = Signals(np.array([subject.start_time]), variables, values[np.newaxis])

    def solved(end: float) -> ErrorBounded:
        return solve(subject, kind, np.array([subject.start_time, end]), signals, watched)

    found = solved(end := subject.time(steps))
    if before_events and (later := found.events[found.events > subject.start_time]).size:
        found = solved(end := subject.start_time + _BEFORE * (float(later[0]) - subject.start_time))
    return end, found.values[-1], found.bars[-1] + _OTHER_SOLVER * np.maximum(np.abs(found.values[-1]), watched.scales)


def _checks() -> tuple[Check, ...]:
    made = []
    for importer in IMPORTERS.values():
        function: Callable[..., Finding] = partial(_compared if importer.takes else _complaints, importer)
        function.__doc__ = (  # type: ignore[attr-defined]
            "It runs, and its numbers are ours: in the same steps, or as exact as the integrators"
            if importer.takes
            else "It complains of nothing"
        )
        made.append(check(f"importer {importer.title}", Scope.EACH if importer.takes else Scope.FILE)(function))
    return tuple(made)


CHECKS = _checks()

"""check_fmu(): the file is checked, unpacked, and checked by the table of checks in an isolated child (validate.execution.isolated).

    run_checks({"path": ..., "folder": ..., "names": [...] or None, "seconds": 60}, {}) -> rows, as JSON holds them

is what the child runs: each check in a fork of its own.
"""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fmpy
from fmpy.fmi1 import FMICallException

from models.errors import MachineError, UnknownNameError
from validate.execution.isolated import Ending, Limits, run_isolated
from validate.fmi import cvode
from validate.fmi.archive import ArchiveError, check_archive, unpack
from validate.fmi.instance import Fault, Lacking, Misbehaviour, TerminationRequested
from validate.fmu_check import communication, derivatives, exchange, files, states, values
from validate.fmu_check.check import Check, CheckReport, FmuCheckRow, Scope, Status, in_fork
from validate.fmu_check.subject import Subject
from validate.store.disk import temporary_folder

# All checks, in the order of the table.
# Of the file alone; the others need its description, and most of them run its code.
STATIC: tuple[Check, ...] = (files.archive, files.valid)
# If this one fails for a type, those after it are not run.
FIRST = communication.lives
READING: tuple[Check, ...] = (files.consistent, files.exports)
BEHAVIOUR: tuple[Check, ...] = (
    FIRST,
    values.readable,
    values.starts,
    values.obeyed,
    values.finite,
    values.get_order,
    communication.keeps_time,
    communication.stop_time,
    communication.event_mode,
    communication.early_return,
    communication.intermediate_update,
    communication.input_derivatives,
    states.repeats,
    states.resets,
    states.independent,
    states.leaks,
    states.restores,
    states.serialises,
    exchange.arrays,
    exchange.nominals,
    exchange.indicators,
    derivatives.directional,
    derivatives.adjoint,
    derivatives.dependencies,
    exchange.agree,
)
NAMES = tuple(item.name for item in (*STATIC, *READING, *BEHAVIOUR))
_TYPES = {Scope.FILE: ("",), Scope.EACH: ("ME", "CS"), Scope.EXCHANGE: ("ME",), Scope.COSIMULATION: ("CS",)}


def run_checks(request: dict[str, Any], _arrays: dict[str, Any]) -> dict[str, Any]:
    """See the module docstring."""
    if request["names"] is None:
        cvode.functions()  # 7 ms, once, before anything is forked
    table = _Table(request)
    path, folder = Path(request["path"]), Path(request["folder"])
    for item, place in zip(STATIC, (path, folder), strict=True):
        table.add(item, "", (place,))
    try:
        description = fmpy.read_model_description(str(folder), validate=False)
    except Exception as error:  # noqa: BLE001 - FMPy raises anything; the check above has said why
        reason = f"the description cannot be read ({type(error).__name__}: {next(iter(str(error).splitlines()), '')})."
        for item in (*READING, *BEHAVIOUR):
            table.skip(item, "", reason)
        return {"version": "", "types": [], "rows": table.rows, "lacking": False}
    subject = Subject(path, folder, description)
    for item in (*READING, *BEHAVIOUR):
        for kind in _TYPES[item.scope]:
            if not kind or kind in subject.types:
                table.of_description(item, kind, subject)
    return {"version": description.fmiVersion, "types": list(subject.types), "rows": table.rows, "lacking": table.lacking}


class _Table:
    """The rows so far, and which types turned out not to run."""

    def __init__(self, request: dict[str, Any]) -> None:
        self.rows: list[dict[str, Any]] = []
        self._names, self._seconds = request["names"], request["seconds"]
        self._broken: set[str] = set()
        self.lacking = False  # whether a type cannot be run on this machine

    def of_description(self, item: Check, kind: str, subject: Subject) -> None:
        """One check of a described FMU, if it can be run."""
        if item in READING:
            self.add(item, kind, (subject, kind) if kind else (subject,))
            return
        needed = (kind,) if kind else subject.types
        missing = [name for name in needed if not files.library_path(subject, name).is_file()]
        broken = [name for name in needed if name in self._broken]
        if missing:
            self.skip(item, kind, "there is no binary for this machine.")
        elif broken:
            self.skip(item, kind, f"it does not run as {' and '.join(broken)}: see `{FIRST.name}`.")
        elif lacks := item.lacks(subject, kind):
            self.skip(item, kind, lacks)
        else:
            pace = self.add(item, kind, (subject, kind) if kind else (subject,))
            if item is FIRST:
                if self.rows[-1]["status"] != Status.PASSED.name:
                    self._broken.add(kind)
                self.lacking = self.lacking or self.rows[-1]["status"] == Status.NOT_OFFERED.name
                subject.pace[kind] = pace or 0.0

    def add(self, item: Check, kind: str, arguments: tuple[Any, ...]) -> float | None:
        """Run one check in a fork; the pace, if it measures that."""
        if not self._wanted(item):
            return None
        began = time.monotonic()
        status, sentence, pace = self._found(item, kind, arguments)
        self._row(item, kind, status, sentence, began)
        return pace

    def _found(self, item: Check, kind: str, arguments: tuple[Any, ...]) -> tuple[Status, str, float | None]:
        """What the check finds, or what kept it from that; shorter once more where the FMU ends the simulation."""
        while True:
            try:
                status, sentence, pace = in_fork(lambda: _call(item, arguments), self._seconds, own_group=True)
                return Status[status], sentence, pace
            except TerminationRequested as end:
                if not _shorten(arguments[0], kind, end.time):
                    sentence = f"it asks for the end of the simulation at t = {end.time:.6g} s, which leaves nothing to check."
                    return Status.FAILED if item is FIRST else Status.NOT_OFFERED, sentence, None
            except Lacking as lack:
                return Status.NOT_OFFERED, f"{lack}.", None
            except Misbehaviour as fault:
                if item in STATIC:  # none of the FMU's code ran: a large description takes FMPy's validation minutes
                    return Status.NOT_OFFERED, f"it was not found out within {self._seconds:g} s: {fault}.", None
                return Status.FAILED, f"{fault}.", None

    def skip(self, item: Check, kind: str, sentence: str) -> None:
        if self._wanted(item):
            self._row(item, kind, Status.NOT_OFFERED, sentence, time.monotonic())

    def _wanted(self, item: Check) -> bool:
        return self._names is None or item.name in self._names or item is FIRST

    def _row(self, item: Check, kind: str, status: Status, sentence: str, began: float) -> None:
        row = {"name": item.name, "type": kind, "claim": item.claim, "status": status.name, "sentence": sentence}
        self.rows.append({**row, "seconds": time.monotonic() - began})


def _shorten(subject: Subject, kind: str, end: float) -> bool:
    """Let runs end before `end` [s]; whether that is earlier than it was, and leaves a step to make."""
    earlier = False
    for name in (kind,) if kind else subject.types:
        if end < subject.ends.get(name, math.inf):
            subject.ends[name] = end
            earlier = True
    return earlier and all(subject.before_end(name, 1) for name in subject.ends)


def _call(item: Check, arguments: tuple[Any, ...]) -> tuple[str, str, float | None]:
    """In the fork: the finding - status, sentence, pace - as JSON holds it."""
    try:
        finding = item(*arguments)
    except (Fault, FMICallException, MemoryError):
        raise
    except Exception as error:  # noqa: BLE001 - our own mistake must not pass for the FMU's
        traceback.print_exc()
        text = f"this check itself broke off ({type(error).__name__}: {error}); please report it with the FMU."
        return Status.FAILED.name, text, None
    return finding.status.name, finding.sentence, finding.pace


# Seconds of one check, and bytes of memory of each.
CHECK_SECONDS = 60.0
_MEMORY = 4 * 1024**3


def check_fmu(path: Path, *, names: Sequence[str] | None = None, seconds: float = CHECK_SECONDS) -> CheckReport:
    """All checks of an FMU file, or those named. seconds: of the clock, for each check.

    Raises ArchiveError if the file is no FMU of version 2.0 or 3.0, MachineError if this machine cannot, UnknownNameError for a name.
    """
    for name in names or ():
        if name not in NAMES:
            raise UnknownNameError(f"there is no check {name!r}; there are: {', '.join(NAMES)}.")
    try:
        archive = check_archive(path, but_for="binary")
    except ArchiveError as error:
        if error.check not in files.ARCHIVE_CHECKS:
            raise
        return _unsafe(path)
    with temporary_folder("touchstone-check-") as folder:
        unpack(archive, folder)
        request = {"path": str(path.resolve()), "folder": str(folder), "names": None if names is None else list(names), "seconds": seconds}
        limits = Limits(seconds=60.0 + 2 * len(NAMES) * seconds, memory=_MEMORY)
        done = run_isolated("validate.fmu_check.host:run_checks", request, limits=limits, what=f"the check of {path}")
    if not done.ok:
        raise MachineError(
            done.sentence
            if done.ending is Ending.MACHINE
            else f"{done.sentence.rstrip('.')}; the checks themselves did not come to an end."
        )
    rows = tuple(FmuCheckRow(**{**row, "status": Status[row["status"]]}) for row in done.value["rows"])
    return CheckReport(
        path=str(path),
        version=done.value["version"],
        types=tuple(done.value["types"]),
        rows=rows,
        unrunnable=not archive.kinds or done.value["lacking"],
    )


def _unsafe(path: Path) -> CheckReport:
    """Of a file that is not unpacked."""
    finding, first = files.archive(path), files.archive
    rows = [FmuCheckRow(name=first.name, type="", claim=first.claim, status=finding.status, sentence=finding.sentence, seconds=0.0)]
    reason = "the archive is not unpacked: it is unsafe."
    rows += [FmuCheckRow(name=name, type="", claim="", status=Status.NOT_OFFERED, sentence=reason, seconds=0.0) for name in NAMES[1:]]
    return CheckReport(path=str(path), version="", types=(), rows=tuple(rows))

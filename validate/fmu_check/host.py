"""check_fmu(): the file is checked, unpacked, and checked by the table of checks in an isolated child (validate.processes.isolated).

    run_checks({"path": ..., "folder": ..., "told": ..., "names": [...], "seconds": 60}, {}) -> what the rows are about

is what the child runs: each check in a fork of its own. It appends each row to the file `told`, as
a line of JSON, when the check has ended.
"""

from __future__ import annotations

import contextlib
import json
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from models.errors import MachineError, UnknownNameError, did_you_mean
from validate.fmi import cvode
from validate.fmi.archive import ARCHIVE_CHECKS, ArchiveError, FmuError, check_archive, unpack
from validate.fmi.description import read_description
from validate.fmi.instance import Lacking, Misbehaviour, TerminationRequested
from validate.fmu_check import (
    accepted,
    agreement,
    communication,
    derivatives,
    exchange,
    files,
    states,
    values,
)
from validate.fmu_check.check import (
    Check,
    CheckReport,
    Finding,
    FmuCheckRow,
    Refusal,
    Status,
    failed,
    in_fork,
    not_offered,
)
from validate.fmu_check.subject import Avoided, Subject
from validate.processes.disk import temporary_folder
from validate.processes.isolated import Ending, Limits, run_isolated

# All checks, in the order of the table.
# Of the file alone; the others need its description, and most of them run its code.
STATIC: tuple[Check, ...] = (files.archive, files.valid)
# If this one fails for a type, those after it are not run.
FIRST = communication.lives
# What it learns, others avoid.
ACCEPTED = accepted.accepted
READING: tuple[Check, ...] = (files.consistent, files.compiled, files.exports)
BEHAVIOUR: tuple[Check, ...] = (
    FIRST, ACCEPTED, values.readable, values.starts, values.obeyed, values.finite, values.still,
    values.get_order,
    communication.keeps_time, communication.stop_time, communication.event_mode,
    communication.early_return,
    communication.intermediate_update, communication.input_derivatives,
    states.repeats, states.resets, states.independent, states.leaks, states.surrounded,
    states.token, states.restores, states.serialises,
    exchange.arrays, exchange.nominals, exchange.indicators, exchange.told,
    derivatives.directional, derivatives.adjoint, derivatives.dependencies, derivatives.rates,
    agreement.agree,
)  # fmt: skip
NAMES = tuple(item.name for item in (*STATIC, *READING, *BEHAVIOUR))
# Checks that decide whether a replay by the FMU can be trusted: start values, state, derivatives,
# events, and Model Exchange against Co-Simulation. A campaign makes these.
DECISIVE = tuple(
    item.name
    for item in (
        values.starts, communication.keeps_time, states.repeats, states.restores,
        exchange.indicators, exchange.told, derivatives.directional, derivatives.rates,
        agreement.agree,
    )
)  # fmt: skip
# Checks on which others depend.
_ALWAYS = (FIRST.name, files.compiled.name)


def run_checks(request: dict[str, Any], _arrays: dict[str, Any]) -> dict[str, Any]:
    """See the module docstring."""
    if set(request["names"]) >= set(NAMES):
        # Loads the integrator once, before anything is forked (7 ms). A few named checks may run
        # without it, and it may be missing.
        cvode.functions()
    table = _Table(request)
    path, folder = Path(request["path"]), Path(request["folder"])
    for item, place in zip(STATIC, (path, folder), strict=True):
        table.add(item, "", place)
    try:
        description = read_description(folder)
    except FmuError as error:
        reason = f"{error}."
        for item in (*READING, *BEHAVIOUR):
            table.skip(item, "", reason)
        return {"version": "", "types": [], "lacking": not request["runnable"]}
    table.subject = subject = Subject(path, folder, description)
    with contextlib.suppress(ValueError, KeyError):  # told by the first check that looks at it
        subject.prepare()
    table.major = subject.major
    for item in (*READING, *BEHAVIOUR):
        for kind in item.scope.value:
            if kind in ("", *subject.types):
                table.of_description(item, kind)
    return {
        "version": description.fmiVersion,
        "types": subject.types,
        "lacking": table.lacking or not table.ran,
    }


class _Table:
    """Writes the rows, and knows which types turned out not to run, and which values the FMU refuses.

    subject: the FMU, once it is described; it avoids what was found to be refused.
    """

    subject: Subject

    def __init__(self, request: dict[str, Any]) -> None:
        self._names, self._seconds, self._told = (
            request["names"],
            request["seconds"],
            Path(request["told"]),
        )
        self.major = int(request["version"][:1] or 0)
        self._broken: set[str] = set()
        self._searched: set[str] = set()  # types of which it is known what they refuse
        self._refusals: dict[str, str] = {}  # reason of a refusal -> the check that reports it
        self.ran = False  # whether any of its code could be run
        self.lacking = False  # whether a type cannot be run on this machine

    def of_description(self, item: Check, kind: str) -> None:
        """One check of a described FMU, if it can be run."""
        subject = self.subject
        if item is files.compiled and files.library_path(subject, kind).is_file():
            return  # as of most FMUs: no row
        if item in READING:
            self.add(item, kind, subject)
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
            found = self.add(item, kind, subject)
            self.ran = self.ran or bool(kind)
            if found is not None and item is FIRST:
                if found.status is not Status.PASSED:
                    self._broken.add(kind)
                self.lacking = self.lacking or found.status is Status.NOT_OFFERED
                subject.pace[kind] = found.pace or 0.0

    def add(self, item: Check, kind: str, about: Path | Subject) -> Finding | None:
        """Run one check in a fork, if it was asked for; what it found."""
        if item.name not in self._names:
            return None
        began = time.monotonic()
        self._row(item, kind, found := self._found(item, kind, about), began)
        return found

    def _found(self, item: Check, kind: str, about: Path | Subject) -> Finding:
        """What the check finds, or what kept it from that.

        Shorter once more where the FMU ends the simulation; with other values where it refuses some.
        """
        while True:
            once = partial(item, about, kind) if kind else partial(item, about)
            try:
                status, *rest = in_fork(once, self._seconds, own_group=True)
                found = Finding(Status(status), *rest)
                if item is ACCEPTED:
                    self._learn(kind, found)
                return found
            except TerminationRequested as end:
                if not _shorten(self.subject, kind, end.time):
                    sentence = f"it asks for the end of the simulation at t = {end.time:.6g} s, which leaves nothing to check."
                    return failed(sentence) if item is FIRST else not_offered(sentence)
            except Refusal as refusal:
                if item in (FIRST, ACCEPTED) or not self._search(kind):
                    return self._refused(item, kind, refusal)
                about = self.subject
            except Lacking as lack:
                return not_offered(f"{lack}.")
            except Misbehaviour as fault:
                if (
                    item in STATIC
                ):  # none of the FMU's code ran: a large description takes FMPy's validation minutes
                    return not_offered(f"it was not found out within {self._seconds:g} s: {fault}.")
                return failed(f"{fault}.")

    def _search(self, kind: str) -> bool:
        """Find out which values the FMU refuses, if that is not known; whether there are some to avoid."""
        before, kinds = self.subject.avoided, (kind,) if kind else self.subject.types
        ends = dict(self.subject.ends)
        for name in kinds:
            if name not in self._searched:
                self._found(ACCEPTED, name, self.subject)
                self._searched.add(name)
        return (self.subject.avoided, self.subject.ends) != (before, ends)

    def _learn(self, kind: str, found: Finding) -> None:
        """Keep what the search found, for all types: none is set to what another refuses."""
        self._searched.add(kind)
        if found.learnt is None:
            return
        self._refusals |= dict.fromkeys(found.learnt["reasons"], ACCEPTED.name)
        avoided = Avoided.of(found.learnt["avoided"])
        if avoided != self.subject.avoided:
            self.subject = replace(self.subject, avoided=avoided)
            self.subject.prepare()
        if found.learnt["end"] is not None:
            _shorten(self.subject, kind, found.learnt["end"])

    def _refused(self, item: Check, kind: str, refusal: Refusal) -> Finding:
        """A refusal that no other values avoid: the finding of the first check that meets it, alone."""
        title = f"{item.name} ({kind})" if kind else item.name
        first = self._refusals.setdefault(refusal.reason, title)
        if first != title:
            return not_offered(f"it was not run to its end: {refusal}; see `{first}`.")
        return failed(f"{refusal}.")

    def skip(self, item: Check, kind: str, sentence: str) -> None:
        if item.name in self._names:
            self._row(item, kind, not_offered(sentence), time.monotonic())

    def _row(self, item: Check, kind: str, found: Finding, began: float) -> None:
        row = {
            "name": item.name,
            "type": kind,
            "claim": item.claim,
            "status": found.status,
            "sentence": found.sentence,
        }
        with self._told.open("a", encoding="utf-8") as file:
            file.write(
                f"{json.dumps({**row, 'seconds': time.monotonic() - began, 'clause': item.clause(self.major)})}\n"
            )


def _shorten(subject: Subject, kind: str, end: float) -> bool:
    """Let runs end before `end` [s].

    Whether that is earlier than it was, and leaves a step to make.
    """
    earlier = {
        name: end
        for name in ((kind,) if kind else subject.types)
        if end < subject.ends.get(name, math.inf)
    }
    subject.ends |= earlier
    return bool(earlier) and all(subject.before_end(name, 1) for name in subject.ends)


# Seconds of one check, and bytes of memory of each.
CHECK_SECONDS = 60.0
_MEMORY = 4 * 1024**3
# Pause between two looks at what is found [s].
_LOOK = 0.02


def check_fmu(
    path: Path,
    *,
    names: Sequence[str] | None = None,
    seconds: float = CHECK_SECONDS,
    waived: Mapping[str, str] | None = None,
    told: Callable[[FmuCheckRow], None] | None = None,
) -> CheckReport:
    """All checks of an FMU file, or those named.

    seconds: of the clock, for each check; waived: the reason why a failure of the check of this
        name is right; told: called with each row as soon as it is there.
    Raises ArchiveError if the file is no FMU of version 2.0 or 3.0, MachineError if this machine
        cannot, UnknownNameError for a name.
    """
    waived = waived or {}
    for name in (*(names or ()), *waived):
        if name not in NAMES:
            there = f"there are: {', '.join(NAMES)}."
            raise UnknownNameError(
                f"there is no check {name!r}; {did_you_mean(name, NAMES, there)}"
            )
    asked = NAMES if names is None else (*names, *_ALWAYS)
    rows: list[FmuCheckRow] = []

    def take(row: FmuCheckRow) -> None:
        if row.status is Status.FAILED and row.name in waived:
            row = replace(
                row, status=Status.WAIVED, sentence=f"{row.sentence} Waived: {waived[row.name]}"
            )
        rows.append(row)
        if told is not None:
            told(row)

    try:
        archive = check_archive(path, but_for=("binary", "duplicates", "identifier"))
    except ArchiveError as error:
        if error.check not in ARCHIVE_CHECKS:
            raise
        finding, reason = files.archive(path), "the archive is not unpacked: it is unsafe."
        take(
            FmuCheckRow(
                name=NAMES[0],
                type="",
                claim=files.archive.claim,
                status=finding.status,
                sentence=finding.sentence,
                seconds=0.0,
            )
        )
        for name in NAMES[1:]:
            take(
                FmuCheckRow(
                    name=name,
                    type="",
                    claim="",
                    status=Status.NOT_OFFERED,
                    sentence=reason,
                    seconds=0.0,
                )
            )
        return CheckReport(path=str(path), version="", types=(), rows=tuple(rows))
    with temporary_folder("touchstone-check-") as folder:
        unpacked, lines = folder / "fmu", folder / "rows.jsonl"
        unpacked.mkdir()
        unpack(archive, unpacked)
        lines.touch()
        request = {
            "path": str(path.resolve()), "folder": str(unpacked), "told": str(lines),
            "version": archive.version, "seconds": seconds,
            "runnable": bool(archive.kinds), "names": list(asked),
        }  # fmt: skip
        limits = Limits(seconds=60.0 + 2 * len(NAMES) * seconds, memory=_MEMORY)
        with _following(lines, take):
            done = run_isolated(
                "validate.fmu_check.host:run_checks",
                request,
                limits=limits,
                what=f"the check of {path}",
            )
    if done.ending is Ending.MACHINE:
        raise MachineError(done.sentence)
    if not done.ok:
        raise MachineError(
            f"{done.sentence.rstrip('.')}; the checks themselves did not come to an end."
        )
    version, types, lacking = (done.value[name] for name in ("version", "types", "lacking"))
    return CheckReport(
        path=str(path), version=version, types=tuple(types), rows=tuple(rows), unrunnable=lacking
    )


@contextlib.contextmanager
def _following(lines: Path, take: Callable[[FmuCheckRow], None]) -> Iterator[None]:
    """Give each row to `take` soon after its line is in the file; all of them before the end.

    What that raises, a closed pipe for example, is raised here.
    """
    over = threading.Event()

    def follow() -> None:
        with lines.open(encoding="utf-8") as file:
            part, last = "", False
            while not last:
                last = over.wait(_LOOK)
                *whole, part = (part + file.read()).split("\n")
                for row in map(json.loads, whole):
                    take(FmuCheckRow(**{**row, "status": Status(row["status"])}))

    with ThreadPoolExecutor(1) as pool:
        following = pool.submit(follow)
        try:
            yield
        finally:
            over.set()
    following.result()

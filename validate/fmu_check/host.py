"""The table of checks, and check_fmu(), which runs them in an isolated child.

    report = check_fmu(Path("model.fmu"), names=["runs repeat"])

The child (validate.processes.isolated) calls run_checks(). Each check has a fork of its own. When a
check ends, its row is appended to a file as a line of JSON.
"""

from __future__ import annotations

import contextlib
import json
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from models.errors import (
    MachineError,
    UnknownNameError,
    check_positive,
    check_text,
    did_you_mean,
    listed,
)
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
    guest,
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
# Checks of the file, before its description is read.
STATIC: tuple[Check, ...] = (files.archive, files.valid)
# Checks of the description and the binary.
READING: tuple[Check, ...] = (files.consistent, files.compiled, files.exports)
# If this one fails for a type, the checks after it are not run.
FIRST = communication.lives
# The values that this one finds refused are avoided by all checks.
ACCEPTED = accepted.accepted
BEHAVIOUR: tuple[Check, ...] = (
    FIRST, ACCEPTED, values.readable, values.starts, values.obeyed, values.finite, values.still,
    values.get_order,
    communication.keeps_time, communication.stop_time, communication.event_mode,
    communication.early_return,
    communication.intermediate_update, communication.input_derivatives,
    states.repeats, states.resets, states.independent, guest.leaks, guest.surrounded, guest.token,
    states.restores, states.serialises,
    exchange.arrays, exchange.nominals, exchange.indicators, exchange.reported,
    derivatives.directional, derivatives.adjoint, derivatives.dependencies, derivatives.rates,
    agreement.agree,
)  # fmt: skip
NAMES = tuple(item.name for item in (*STATIC, *READING, *BEHAVIOUR))
# The checks that a campaign makes: they decide whether a replay by the FMU can be trusted.
DECISIVE = tuple(
    item.name
    for item in (
        values.starts, communication.keeps_time, states.repeats, states.restores,
        exchange.indicators, exchange.reported, derivatives.directional, derivatives.rates,
        agreement.agree,
    )
)  # fmt: skip
# Checks that are always made, because further ones depend on them.
_ALWAYS = (FIRST.name, files.compiled.name)


def run_checks(request: dict[str, Any], _arrays: dict[str, Any]) -> dict[str, Any]:
    """Run the checks of a request, in the child; return the facts of the report about the FMU."""
    if set(request["names"]) >= set(NAMES):
        # Load the integrator once, before the forks (7 ms). It may be missing, and a few named
        # checks may run without it.
        cvode.functions()
    table = _Table(request)
    folder = Path(request["folder"])
    for item, place in zip(STATIC, (Path(request["path"]), folder), strict=True):
        table.add(item, "", place)
    try:
        description = read_description(folder)
    except FmuError as error:
        for item in (*READING, *BEHAVIOUR):
            table.skip(item, "", f"{error}.")
        return {"version": "", "types": [], "lacking": not request["runnable"]}
    table.subject = subject = Subject(folder, description)
    with contextlib.suppress(ValueError, KeyError):  # reported by the first check that needs it
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
    """Writes the rows, and learns which types do not run, and which values the FMU refuses.

    subject: the FMU, once it is described; avoids the refused values.
    ran: whether any of its code ran.
    lacking: whether a type cannot be run on this machine.
    """

    subject: Subject

    def __init__(self, request: dict[str, Any]) -> None:
        self._names, self._seconds = request["names"], request["seconds"]
        self._rows = Path(request["rows"])
        self.major = int(request["version"][:1] or 0)
        self._broken: set[str] = set()
        self._searched: set[str] = set()  # types whose refused values are known
        self._refusals: dict[str, str] = {}  # reason of a refusal -> the check that reports it
        self.ran = self.lacking = False

    def of_description(self, item: Check, kind: str) -> None:
        """Run one check of a described FMU, if it can be run."""
        subject = self.subject
        if item is files.compiled and files.library_path(subject, kind).is_file():
            return  # no row: most FMUs have a binary
        if item in READING:
            self.add(item, kind, subject)
            return
        needed = (kind,) if kind else subject.types
        broken = [name for name in needed if name in self._broken]
        if not all(files.library_path(subject, name).is_file() for name in needed):
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
        """Run one check in a fork, and write its row, if it is wanted; return its finding."""
        if item.name not in self._names:
            return None
        began = time.monotonic()
        found = self._found(item, kind, about)
        self._write(item, kind, found, time.monotonic() - began)
        return found

    def _found(self, item: Check, kind: str, about: Path | Subject) -> Finding:
        """Return the finding of a check, or the fault that stopped it.

        A check is repeated with shorter runs if the FMU ends the simulation, and with other values
        if it refuses some.
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
                    sentence = (
                        f"it asks for the end of the simulation at t = {end.time:.6g} s, which "
                        "leaves nothing to check."
                    )
                    return failed(sentence) if item is FIRST else not_offered(sentence)
            except Refusal as refusal:
                if item in (FIRST, ACCEPTED) or not self._search(kind):
                    return self._refused(item, kind, refusal)
                about = self.subject
            except Lacking as lack:
                return not_offered(f"{lack}.")
            except Misbehaviour as fault:
                if item in STATIC:  # FMPy's validation of a large description takes minutes
                    return not_offered(f"it did not end within {self._seconds:g} s: {fault}.")
                return failed(f"{fault}.")

    def _search(self, kind: str) -> bool:
        """Search for refused values, unless they are known; return whether there are new ones."""
        before, ends = self.subject.avoided, dict(self.subject.ends)
        for name in (kind,) if kind else self.subject.types:
            if name not in self._searched:
                self._found(ACCEPTED, name, self.subject)
                self._searched.add(name)
        return (self.subject.avoided, self.subject.ends) != (before, ends)

    def _learn(self, kind: str, found: Finding) -> None:
        """Keep the refused values, for all types."""
        self._searched.add(kind)
        if found.learnt is None:
            return
        self._refusals |= dict.fromkeys(found.learnt["reasons"], ACCEPTED.name)
        avoided = Avoided(**found.learnt["avoided"])
        if avoided != self.subject.avoided:
            self.subject = replace(self.subject, avoided=avoided)
            self.subject.prepare()
        if found.learnt["end"] is not None:
            _shorten(self.subject, kind, found.learnt["end"])

    def _refused(self, item: Check, kind: str, refusal: Refusal) -> Finding:
        """Return the finding of a refusal that other values do not avoid.

        It is failed for the first check.
        """
        title = f"{item.name} ({kind})" if kind else item.name
        first = self._refusals.setdefault(refusal.reason, title)
        if first != title:
            return not_offered(f"it was not run to its end: {refusal}; see `{first}`.")
        return failed(f"{refusal}.")

    def skip(self, item: Check, kind: str, sentence: str) -> None:
        """Write the row of a check that is not run, if it is wanted."""
        if item.name in self._names:
            self._write(item, kind, not_offered(sentence), 0.0)

    def _write(self, item: Check, kind: str, found: Finding, seconds: float) -> None:
        row = _row(item, kind, found, seconds, self.major)
        with self._rows.open("a", encoding="utf-8") as file:
            file.write(f"{json.dumps(asdict(row))}\n")


def _row(item: Check, kind: str, found: Finding, seconds: float, major: int) -> FmuCheckRow:
    return FmuCheckRow(
        name=item.name,
        type=kind,
        claim=item.claim,
        status=found.status,
        sentence=found.sentence,
        seconds=seconds,
        clause=item.clause(major),
    )


def _shorten(subject: Subject, kind: str, end: float) -> bool:
    """Let runs end before `end` [s]; return whether they are shorter now, with a step left."""
    kinds = (kind,) if kind else subject.types
    earlier = {name: end for name in kinds if end < subject.ends.get(name, math.inf)}
    subject.ends |= earlier
    return bool(earlier) and all(subject.before_end(name, 1) for name in subject.ends)


# Time limit of one check [s].
CHECK_SECONDS = 60.0
# Memory of each process [bytes]: a description of 400,000 variables takes a quarter.
_MEMORY = 4 * 1024**3
# Time of the child without its checks [s]: imports, and reading the description.
_BEFORE_SECONDS = 60.0
# Interval of looking for new rows [s]: a line appears at once.
_POLL_S = 0.02


def check_fmu(
    path: Path,
    *,
    names: Sequence[str] | None = None,
    seconds: float = CHECK_SECONDS,
    waived: Mapping[str, str] | None = None,
    on_row: Callable[[FmuCheckRow], None] | None = None,
) -> CheckReport:
    """Run all checks of an FMU file, or some.

    Parameters
    ----------
    path
        The FMU.
    names
        Names of checks; None: all.
    seconds
        Time limit of each check.
    waived
        Name of a check -> the reason why its failure is right.
    on_row
        Called with each row as soon as its check has ended.

    Returns
    -------
    CheckReport
        All findings.

    Raises
    ------
    ArchiveError
        If the file is no FMU of version 2.0 or 3.0.
    MachineError
        If the machine cannot run the checks.
    UnknownNameError
        If there is no check of a name.
    """
    waived = waived or {}
    for name in (*(names or ()), *waived):
        if name not in NAMES:
            hint = did_you_mean(name, NAMES, f"there are: {', '.join(NAMES)}.")
            raise UnknownNameError(f"there is no check {name!r}; {hint}")
    rows: list[FmuCheckRow] = []

    def take(row: FmuCheckRow) -> None:
        if row.status is Status.FAILED and row.name in waived:
            sentence = f"{row.sentence} Waived: {waived[row.name]}"
            row = replace(row, status=Status.WAIVED, sentence=sentence)
        rows.append(row)
        if on_row is not None:
            on_row(row)

    try:
        archive = check_archive(path, but_for=("binary", "duplicates", "identifier"))
    except ArchiveError as error:
        if error.check not in ARCHIVE_CHECKS:
            raise
        take(_row(files.archive, "", files.archive(path), 0.0, 0))
        unsafe = not_offered("the archive is not unpacked: it is unsafe.")
        for item in (files.valid, *READING, *BEHAVIOUR):
            take(_row(item, "", unsafe, 0.0, 0))
        return CheckReport(path=str(path), version="", types=(), rows=tuple(rows))
    with temporary_folder("touchstone-check-") as folder:
        unpacked, lines = folder / "fmu", folder / "rows.jsonl"
        unpacked.mkdir()
        unpack(archive, unpacked)
        lines.touch()
        request = {
            "path": str(path.resolve()), "folder": str(unpacked), "rows": str(lines),
            "version": archive.version, "seconds": seconds, "runnable": bool(archive.kinds),
            "names": list(NAMES if names is None else (*names, *_ALWAYS)),
        }  # fmt: skip
        limits = Limits(seconds=_BEFORE_SECONDS + 2 * len(NAMES) * seconds, memory=_MEMORY)
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
    return CheckReport(
        path=str(path),
        version=done.value["version"],
        types=tuple(done.value["types"]),
        rows=tuple(rows),
        unrunnable=done.value["lacking"],
    )


@contextlib.contextmanager
def _following(lines: Path, take: Callable[[FmuCheckRow], None]) -> Iterator[None]:
    """Call take(row) soon after each row is in the file.

    Raises what `take` raises, as for a closed pipe.
    """
    over = threading.Event()

    def follow() -> None:
        with lines.open(encoding="utf-8") as file:
            part, is_last = "", False
            while not is_last:
                is_last = over.wait(_POLL_S)
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


def check(
    fmu: str | Path, *, only: Sequence[str] | None = None, seconds: float = 60.0
) -> CheckReport:
    """Check an FMU's files, and in child processes its behaviour (docs/fmu_check.md).

    Parameters
    ----------
    only
        Names of checks; None for all.
    seconds
        For each check [s].

    Raises
    ------
    FmuError
        For no FMU of version 2.0 or 3.0.
    """
    check_text("fmu", fmu)
    check_positive("seconds", seconds)
    return check_fmu(Path(fmu), names=None if only is None else listed(only), seconds=seconds)

"""check_fmu(): the file is let in, unpacked, and checked in an isolated child."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

from models.errors import MachineError, UnknownNameError
from validate.disk import temporary_folder
from validate.fmu_check.archive import ARCHIVE_CHECKS, archive
from validate.fmu_check.catalog import NAMES
from validate.fmu_check.result import CheckReport, Row, Status
from validate.isolation import Ending, IntakeError, Limits, Problem, problems, run_isolated

# Seconds of one check, and bytes of memory of each.
CHECK_SECONDS = 60.0
_MEMORY = 4 * 1024**3


def check_fmu(path: Path, *, names: Sequence[str] | None = None, seconds: float = CHECK_SECONDS) -> CheckReport:
    """All checks of an FMU file, or those named. seconds: of the clock, for each check.

    Raises IntakeError if the file is no FMU of version 2.0 or 3.0, MachineError if this machine cannot, UnknownNameError for a name.
    """
    for name in names or ():
        if name not in NAMES:
            raise UnknownNameError(f"there is no check {name!r}; there are: {', '.join(NAMES)}.")
    found = problems(path)
    for problem in found:
        if problem.check not in (*ARCHIVE_CHECKS, "binary"):
            raise IntakeError(problem)
    if any(problem.check in ARCHIVE_CHECKS for problem in found):
        finding = archive(path)
        reason = "the archive is not unpacked: it is unsafe."
        rows = [Row(name=archive.name, type="", claim=archive.claim, status=finding.status, sentence=finding.sentence, seconds=0.0)]
        rows += [Row(name=name, type="", claim="", status=Status.NOT_OFFERED, sentence=reason, seconds=0.0) for name in NAMES[1:]]
        return CheckReport(path=str(path), version="", types=(), rows=tuple(rows))
    return _unpacked(path, names, seconds, unrunnable=any(problem.check == "binary" for problem in found))


def _unpacked(path: Path, names: Sequence[str] | None, seconds: float, unrunnable: bool) -> CheckReport:
    with temporary_folder("touchstone-check-") as folder:
        try:
            with zipfile.ZipFile(path) as packed:
                packed.extractall(folder)
        except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError) as error:
            raise IntakeError(Problem("zip", f"FMU {path}: it cannot be unpacked ({error}); it is damaged.")) from error
        except OSError as error:
            raise MachineError(
                f"FMU {path}: it cannot be unpacked to {folder} ({error.strerror or error}); make room there, or set TMPDIR."
            ) from error
        request = {"path": str(path.resolve()), "folder": str(folder), "names": None if names is None else list(names), "seconds": seconds}
        limits = Limits(seconds=60.0 + 2 * len(NAMES) * seconds, memory=_MEMORY)
        done = run_isolated("validate.fmu_check.host:run_checks", request, limits=limits, what=f"the check of {path}")
    if not done.ok:
        raise MachineError(
            done.sentence
            if done.ending is Ending.MACHINE
            else f"{done.sentence.rstrip('.')}; the checks themselves did not come to an end."
        )
    rows = tuple(Row(**{**row, "status": Status[row["status"]]}) for row in done.value["rows"])
    return CheckReport(
        path=str(path),
        version=done.value["version"],
        types=tuple(done.value["types"]),
        rows=rows,
        unrunnable=unrunnable or done.value["lacking"],
    )

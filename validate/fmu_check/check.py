"""A check of an FMU: what it claims, the fork in which it runs, and what it finds - passed, failed or not offered, and one sentence with figures.

The process that forks never loads an FMU itself: libraries are imported once, and each check has a
fresh process. The answer is a file written last and whole; what the FMU prints, and how the process
exits, cannot pass for one. A Fault is raised here as it was there.
"""

from __future__ import annotations

import contextlib
import gc
import json
import math
import os
import select
import signal
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, StrEnum
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from fmpy.fmi1 import FMICallException

from validate.fmi.instance import Fault, Lacking, Misbehaviour, RefusedCall, TerminationRequested
from validate.fmi.surroundings import listed
from validate.processes.process import exit_in_words

# The texts whose sections the checks name.
STANDARDS = ("2.0.4", "3.0.2")


class Status(StrEnum):
    """How a check ended; the value is the word in the table."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_OFFERED = "not offered"  # the FMU does not offer what is checked, or it cannot be told
    ADVICE = "advice"  # allowed, and a trap for who uses the FMU
    WAIVED = "waived"  # it failed, and who asked for the check gave a reason why that is right


class Scope(Enum):
    """What a check is about: the file; an FMI type, each one the FMU offers; or one of them only.

    The value: the types it is run for, as far as they are there.
    """

    FILE = ("",)
    EACH = ("ME", "CS")
    EXCHANGE = ("ME",)
    COSIMULATION = ("CS",)


class Finding(NamedTuple):
    """The outcome of one check and its sentence.

    pace: seconds of a step, from the check that measures it; learnt: what other checks must not set,
        from the check that finds it (validate.fmu_check.accepted).
    """

    status: Status
    sentence: str
    pace: float | None = None
    learnt: dict[str, Any] | None = None


# Each makes the Finding of a sentence; of advice: nothing that the standard or common sense
# forbids, but worth a change.
passed, failed, not_offered, advice = (
    partial(Finding, status) for status in Status if status is not Status.WAIVED
)


def unless(wrong: list[str], sentence: str, end: str = ".") -> Finding:
    """Failed with the first few things that are wrong, and `end` behind them.

    Without any, passed with the sentence.
    """
    return failed(f"{listed(wrong)}{end}") if wrong else passed(sentence)


class Refusal(Misbehaviour):
    """A call that was refused in a fork, as RefusedCall tells of it: text, a clause, reason and time [s]."""

    def __init__(self, text: str, reason: str = "", time: float = math.nan) -> None:
        super().__init__(text)
        self.reason, self.time = reason, time


class Failed(Exception):  # noqa: N818 - a finding about the FMU, not an error of ours
    """Raised within a check that failed; the text is its sentence."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One check: its name in the table, and the function that finds out, whose docstring, one sentence, is what it claims of a sound FMU.

    run(subject) for Scope.FILE, run(subject, type) with type "ME" or "CS" otherwise; clauses:
    the sections of FMI 2.0.4 and 3.0.2 that demand it, empty where none does; needs: the ability
    that the type must claim, by its names in FMI 2.0 and 3.0, empty in a version that has none.
    """

    name: str
    scope: Scope
    run: Callable[..., Finding]
    clauses: tuple[str, str] = ("", "")
    needs: tuple[str, str] | None = None

    @property
    def claim(self) -> str:
        """What it claims of a sound FMU."""
        claim = " ".join((self.run.__doc__ or "").split()).removesuffix(".")
        return claim[:1].lower() + claim[1:]

    def clause(self, major: int) -> str:
        """The section that demands it, for example `FMI 2.0.4, 2.1.8`.

        Empty where no section does. major: the version of FMI, 0 if it is not known.
        """
        section = self.clauses[major >= 3]
        return f"FMI {STANDARDS[major >= 3]}, {section}" if major and section else ""

    def lacks(self, subject: Any, kind: str) -> str:
        """Which ability the type does not claim, as a sentence; empty if none is missing."""
        ability = self.needs[subject.major >= 3] if self.needs is not None else None
        if ability is None or (ability and subject.can(kind, ability)):
            return ""
        return f"{ability} is false." if ability else f"FMI {subject.major}.0 has none."

    def __call__(self, *arguments: Any) -> Finding:
        """Run it: see `run`. Raises Fault, FMICallException, MemoryError."""
        try:
            return self.run(*arguments)
        except (Fault, FMICallException, MemoryError):
            raise
        except Failed as failure:
            return failed(str(failure))
        except Exception as error:  # noqa: BLE001 - our own mistake must not pass for the FMU's
            traceback.print_exc()
            return failed(
                f"this check itself broke off ({type(error).__name__}: {error}); please report it with the FMU."
            )


def check(
    name: str,
    scope: Scope,
    *,
    clauses: tuple[str, str] = ("", ""),
    needs: tuple[str, str] | None = None,
) -> Callable[[Callable[..., Finding]], Check]:
    """Make a function a Check: see there."""
    return lambda function: Check(
        name=name, scope=scope, run=function, clauses=clauses, needs=needs
    )


@dataclass(frozen=True, kw_only=True)
class FmuCheckRow:
    """A line of the table: check, FMI type ("", "ME" or "CS"), outcome, seconds it took.

    clause: see `Check`.
    """

    name: str
    type: str
    claim: str
    status: Status
    sentence: str
    seconds: float
    clause: str = ""

    @property
    def title(self) -> str:
        """The check, with the type of FMI that it was run for."""
        return f"{self.name} ({self.type})" if self.type else self.name

    @property
    def severity(self) -> str:
        """What a failure of it is: an `error` against the standard, or `behaviour` that users trip over; `advice` is none."""
        return "advice" if self.status is Status.ADVICE else "error" if self.clause else "behaviour"


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """All that was found about one FMU. version: of FMI; types: those it offers.

    unrunnable: there is no binary for this machine, or it needs what the machine does not have.
    """

    path: str
    version: str
    types: tuple[str, ...]
    rows: tuple[FmuCheckRow, ...]
    unrunnable: bool = False

    def failures(self) -> tuple[FmuCheckRow, ...]:
        """The rows that failed."""
        return tuple(row for row in self.rows if row.status is Status.FAILED)

    @property
    def counts(self) -> str:
        """How many rows there are of each outcome; of advice and waivers, if there are any."""
        found = [row.status for row in self.rows]
        always = (Status.PASSED, Status.FAILED, Status.NOT_OFFERED)
        return ", ".join(
            f"{found.count(status)} {status.value}"
            for status in Status
            if status in always or status in found
        )

    @property
    def ok(self) -> bool:
        """Whether no check failed, but for those that are waived."""
        return not self.failures()

    @property
    def exit_code(self) -> int:
        """0 if it is ok, 1 if not, 3 if its code cannot be run on this machine."""
        return (3 if self.unrunnable else 0) if self.ok else 1


# What a function in a fork may raise, as it is raised again here.
_FAULTS = (TerminationRequested, Lacking, Refusal, Misbehaviour)
# Pause between two looks where the system cannot tell us the end of a process [s].
_LOOK = 0.005


def in_fork(function: Callable[[], Any], seconds: float, *, own_group: bool = False) -> Any:
    """What function() gives in a fork, as JSON holds it. own_group: a process group of its own, ended as a whole at the time limit.

    Raises TerminationRequested and Lacking as the function did; Refusal for a call that was refused;
    Misbehaviour for its own, and for a process that crashed or hung.
    """
    with tempfile.TemporaryDirectory(prefix="answer-", ignore_cleanup_errors=True) as folder:
        path = Path(folder, "answer.json")
        child = os.fork()
        if child == 0:
            _answer(function, path, own_group)
        problem = _wait(child, seconds, own_group)
        if (
            problem and own_group
        ):  # what stood between was ended while the code went on: its answer does not count
            raise Misbehaviour(problem)
        try:
            answer = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            raise Misbehaviour(
                problem or "its process ended without a result (exit code 0)"
            ) from None
    for fault in _FAULTS:
        if fault.__name__ in answer:
            raise fault(*answer[fault.__name__])
    return answer["value"]


def _answer(function: Callable[[], Any], path: Path, own_group: bool) -> None:
    """In the child: never returns.

    With a group of its own a process stands between: code that ends its parent ends that one, and
    is told by how it ended.
    """
    code = 1
    try:
        if own_group:
            os.setpgid(0, 0)
            if guarded := os.fork():
                _end_like(guarded)
        first = os.getpid()
        # what was there before the fork is no garbage of the check, and need not be looked through
        gc.freeze()
        try:
            answer = {"value": function()}
        except TerminationRequested as end:
            answer = {TerminationRequested.__name__: [end.time]}
        except RefusedCall as refusal:
            answer = {Refusal.__name__: [refusal.sentence, refusal.reason, refusal.time]}
        except Refusal as refusal:
            answer = {Refusal.__name__: [str(refusal), refusal.reason, refusal.time]}
        except (Lacking, Misbehaviour) as fault:
            answer = {type(fault).__name__: [str(fault)]}
        except MemoryError:
            answer = {Misbehaviour.__name__: ["it was ended at its memory limit"]}
        if os.getpid() == first:  # an FMU may fork within a call: only the first process answers
            aside = path.with_suffix(".part")
            aside.write_text(json.dumps(answer), encoding="utf-8")
            os.replace(aside, path)
        code = 0
    except BaseException:  # noqa: BLE001 - it goes to the output; without an answer the parent knows enough
        traceback.print_exc()
    finally:
        os._exit(code)


def _end_like(child: int) -> None:
    """Wait for a child, then end as it did: never returns."""
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        signal.signal(-code, signal.SIG_DFL) if -code not in (
            signal.SIGKILL,
            signal.SIGSTOP,
        ) else None
        os.kill(os.getpid(), -code)
    os._exit(max(code, 1) if code < 0 else code)


def _wait(child: int, seconds: float, own_group: bool) -> str:
    """Wait for the child, end it at the limit; how it ended if not with exit code 0."""
    over_time = not _ended_within(child, seconds)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if over_time:
            os.kill(child, signal.SIGKILL)
        if own_group:
            os.killpg(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if over_time:
        return f"it hung: it was ended at its time limit of {seconds:g} s"
    if code == 0:
        return ""
    return (
        f"it crashed with {exit_in_words(code)}"
        if code < 0
        else f"its process ended without a result ({exit_in_words(code)})"
    )


def _ended_within(child: int, seconds: float) -> bool:
    """Whether it ends in time; it is not waited for, so that its number stays its own."""
    until = time.monotonic() + seconds
    if hasattr(os, "pidfd_open"):
        handle = os.pidfd_open(child)
        try:
            return bool(select.select([handle], [], [], seconds)[0])
        finally:
            os.close(handle)
    while os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if time.monotonic() > until:
            return False
        time.sleep(_LOOK)
    return True

"""A check of an FMU: its claim, the process in which it runs, and its finding.

    @check("runs repeat", Scope.EACH)
    def repeats(subject: Subject, kind: str) -> Finding: ...

    in_fork(partial(repeats, subject, "CS"), seconds=60.0)

The process that forks never loads an FMU: libraries are imported once, and each check has a fresh
process. Its answer is a file, written last and whole, so that no output or exit code of the FMU can
be taken for an answer.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from fmpy.fmi1 import FMICallException

from models.results.check import FmuCheckRow, Status
from validate.fmi.instance import Fault, Lacking, Misbehaviour, RefusedCall, TerminationRequested
from validate.fmi.surroundings import listed
from validate.processes.process import exit_in_words

# Versions of the standard whose sections the checks name.
STANDARDS = ("2.0.4", "3.0.2")


class Scope(Enum):
    """The types of FMI for which a check is run, if the FMU offers them; "" for the file."""

    FILE = ("",)
    EACH = ("ME", "CS")
    EXCHANGE = ("ME",)
    COSIMULATION = ("CS",)


class Finding(NamedTuple):
    """The outcome of a check and its sentence.

    pace: seconds per step, from the check that measures it.
    learnt: values that other checks must avoid, from the check that finds them.
    """

    status: Status
    sentence: str
    pace: float | None = None
    learnt: dict[str, Any] | None = None


passed = partial(Finding, Status.PASSED)
failed = partial(Finding, Status.FAILED)
not_offered = partial(Finding, Status.NOT_OFFERED)
advice = partial(Finding, Status.ADVICE)


def unless(wrong: list[str], sentence: str) -> Finding:
    """Return failed with the first items of `wrong`; without any, passed with the sentence."""
    return failed(f"{listed(wrong).rstrip('.')}.") if wrong else passed(sentence)


class Refusal(Misbehaviour):
    """A RefusedCall of a fork, raised again in its parent; see there for its attributes."""

    def __init__(self, sentence: str, reason: str, time: float) -> None:
        super().__init__(sentence)
        self.sentence, self.reason, self.time = sentence, reason, time


class Failed(Exception):  # noqa: N818 - a finding about the FMU, not an error of ours
    """Raised within a check that failed; the text is its sentence."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One check.

    - name: in the table.
    - run: run(subject) for Scope.FILE, run(subject, kind) otherwise; its docstring is one sentence.
    - clauses: sections of FMI 2.0.4 and 3.0.2 that demand it, empty if none does.
    - needs: the ability that the type must claim, by its names in FMI 2.0 and 3.0; empty in a
      version without it.
    """

    name: str
    scope: Scope
    run: Callable[..., Finding]
    clauses: tuple[str, str]
    needs: tuple[str, str] | None

    @property
    def claim(self) -> str:
        """The claim about a sound FMU, without full stop."""
        claim = " ".join((self.run.__doc__ or "").split()).removesuffix(".")
        return claim[:1].lower() + claim[1:]

    def clause(self, major: int) -> str:
        """Return the section that demands it, as `FMI 2.0.4, 2.1.8`; empty if none does.

        major: the version of FMI, 0 if it is unknown.
        """
        section = self.clauses[major >= 3]
        return f"FMI {STANDARDS[major >= 3]}, {section}" if major and section else ""

    def lacks(self, subject: Any, kind: str) -> str:
        """Return a sentence about the ability that the type lacks; empty if it lacks none."""
        ability = self.needs[subject.major >= 3] if self.needs is not None else None
        if ability is None or (ability and subject.can(kind, ability)):
            return ""
        return f"{ability} is false." if ability else f"FMI {subject.major}.0 has none."

    def __call__(self, *arguments: Any) -> Finding:
        """Run it. Raises Fault, FMICallException, MemoryError."""
        try:
            return self.run(*arguments)
        except (Fault, FMICallException, MemoryError):
            raise
        except Failed as failure:
            return failed(str(failure))
        except Exception as error:  # noqa: BLE001 - an error of ours is no defect of the FMU
            traceback.print_exc()
            return failed(
                f"this check itself broke off ({type(error).__name__}: {error}); "
                "please report it with the FMU."
            )


def check(
    name: str,
    scope: Scope,
    *,
    clauses: tuple[str, str] = ("", ""),
    needs: tuple[str, str] | None = None,
) -> Callable[[Callable[..., Finding]], Check]:
    """Make a Check of a function."""
    return lambda run: Check(name=name, scope=scope, run=run, clauses=clauses, needs=needs)


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """All findings about one FMU.

    version: of FMI.
    types: those the FMU offers.
    unrunnable: whether its code cannot be run on this machine.
    """

    path: str
    version: str
    types: tuple[str, ...]
    rows: tuple[FmuCheckRow, ...]
    unrunnable: bool = False

    def failures(self) -> tuple[FmuCheckRow, ...]:
        """Return the rows that failed."""
        return tuple(row for row in self.rows if row.status is Status.FAILED)

    @property
    def counts(self) -> str:
        """The number of rows per outcome; of advice and waivers only if there are any."""
        found = [row.status for row in self.rows]
        always = (Status.PASSED, Status.FAILED, Status.NOT_OFFERED)
        shown = (status for status in Status if status in always or status in found)
        return ", ".join(f"{found.count(status)} {status.value}" for status in shown)

    @property
    def ok(self) -> bool:
        """Return whether no check failed, except waived ones."""
        return not self.failures()

    @property
    def exit_code(self) -> int:
        """0 if it is ok, 1 if not, 3 if its code cannot be run on this machine."""
        return (3 if self.unrunnable else 0) if self.ok else 1


# Exceptions of a fork that are raised again in its parent.
_FAULTS = (TerminationRequested, Lacking, Refusal, Misbehaviour)
# Interval of looking whether a process has ended [s]; a check takes 20 ms and more.
_POLL_S = 0.002


def in_fork(function: Callable[[], Any], seconds: float, *, own_group: bool = False) -> Any:
    """Return the value of function() from a fork, as JSON holds it.

    own_group: whether its process group is killed at the end.
    Raises TerminationRequested, Lacking and Misbehaviour as the function did, Refusal for a
        RefusedCall, and Misbehaviour for a process that crashed or hung.
    """
    with tempfile.TemporaryDirectory(prefix="answer-", ignore_cleanup_errors=True) as folder:
        path = Path(folder, "answer.json")
        child = os.fork()
        if child == 0:
            _answer(function, path, own_group)
        problem = _wait(child, seconds, own_group)
        if problem and own_group:
            # The process between was killed while the code ran on: its answer does not count.
            raise Misbehaviour(problem)
        try:
            answer = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            nothing = "its process ended without a result (exit code 0)"
            raise Misbehaviour(problem or nothing) from None
    for fault in _FAULTS:
        if fault.__name__ in answer:
            raise fault(*answer[fault.__name__])
    return answer["value"]


def _answer(function: Callable[[], Any], path: Path, own_group: bool) -> None:
    """Run the function and store its answer, in the child: never returns.

    With a group of its own a process stands between, because code may kill its parent.
    """
    code = 1
    try:
        if own_group:
            os.setpgid(0, 0)
            if guarded := os.fork():
                _end_like(guarded)
        first = os.getpid()
        gc.freeze()  # objects of the parent are no garbage of the check
        answer = _value_or_fault(function)
        if os.getpid() == first:  # an FMU may fork within a call: only the first process answers
            part = path.with_suffix(".part")
            part.write_text(json.dumps(answer), encoding="utf-8")
            os.replace(part, path)
        code = 0
    except BaseException:  # noqa: BLE001 - printed; the parent reports that there is no answer
        traceback.print_exc()
    finally:
        os._exit(code)


def _value_or_fault(function: Callable[[], Any]) -> dict[str, Any]:
    """Return the value, or the arguments of the fault that is to be raised again."""
    try:
        return {"value": function()}
    except TerminationRequested as end:
        return {TerminationRequested.__name__: [end.time]}
    except (RefusedCall, Refusal) as refusal:
        return {Refusal.__name__: [refusal.sentence, refusal.reason, refusal.time]}
    except (Lacking, Misbehaviour) as fault:
        return {type(fault).__name__: [str(fault)]}
    except MemoryError:
        return {Misbehaviour.__name__: ["it was ended at its memory limit"]}


def _end_like(child: int) -> None:
    """Wait for a child, then end with its exit code or signal: never returns."""
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        if -code not in (signal.SIGKILL, signal.SIGSTOP):
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(abs(code))


def _wait(child: int, seconds: float, own_group: bool) -> str:
    """Wait for the child, kill it at the limit; return how it ended if not with exit code 0."""
    until = time.monotonic() + seconds
    # The child is not reaped before its group is killed, so that its number stays its own.
    while not (ended := os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT)):
        if time.monotonic() > until:
            break
        time.sleep(_POLL_S)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if not ended:
            os.kill(child, signal.SIGKILL)
        if own_group:
            os.killpg(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if not ended:
        return f"it hung: it was ended at its time limit of {seconds:g} s"
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        return f"it crashed with {exit_in_words(code)}"
    return f"its process ended without a result ({exit_in_words(code)})" if code else ""

"""What a check says: passed, failed or not offered, and one sentence with figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any


class Status(Enum):
    """How a check ended; the value is the word in the table."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_OFFERED = "not offered"  # the FMU does not offer what is checked, or it cannot be told


class Scope(Enum):
    """What a check is about: the file; an FMI type, each one the FMU offers; or one of them only."""

    FILE = "file"
    EACH = "each type"
    EXCHANGE = "Model Exchange"
    COSIMULATION = "Co-Simulation"


@dataclass(frozen=True)
class Finding:
    """The outcome of one check and its sentence. pace: seconds of a step, from the check that measures it."""

    status: Status
    sentence: str
    pace: float | None = None


def passed(sentence: str, pace: float | None = None) -> Finding:
    """A check that passed."""
    return Finding(Status.PASSED, sentence, pace)


def failed(sentence: str) -> Finding:
    """A check that failed."""
    return Finding(Status.FAILED, sentence)


def not_offered(sentence: str) -> Finding:
    """A check that does not apply, or cannot be decided."""
    return Finding(Status.NOT_OFFERED, sentence)


@dataclass(frozen=True, kw_only=True)
class Check:
    """One check: its name in the table, what it claims of a sound FMU, and the function that finds out.

    run(subject) for Scope.FILE, run(subject, type) with type "ME" or "CS" otherwise.
    """

    name: str
    claim: str
    scope: Scope
    run: Callable[..., Finding]

    def __call__(self, *arguments: Any) -> Finding:
        """Run it: see `run`."""
        return self.run(*arguments)


def check(name: str, scope: Scope) -> Callable[[Callable[..., Finding]], Check]:
    """Make a function a Check. Its docstring, one sentence, is what it claims of a sound FMU."""

    def made(function: Callable[..., Finding]) -> Check:
        claim = " ".join((function.__doc__ or "").split()).removesuffix(".")
        return Check(name=name, claim=claim[:1].lower() + claim[1:], scope=scope, run=function)

    return made


@dataclass(frozen=True, kw_only=True)
class FmuCheckRow:
    """A line of the table: check, FMI type ("", "ME" or "CS"), outcome, seconds it took."""

    name: str
    type: str
    claim: str
    status: Status
    sentence: str
    seconds: float


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """All that was found about one FMU. version: of FMI; types: those it offers; unrunnable: there is no binary for this machine, or it needs what the machine does not have."""

    path: str
    version: str
    types: tuple[str, ...]
    rows: tuple[FmuCheckRow, ...]
    unrunnable: bool = False

    def failures(self) -> tuple[FmuCheckRow, ...]:
        """The rows that failed."""
        return tuple(row for row in self.rows if row.status is Status.FAILED)

    @property
    def ok(self) -> bool:
        """Whether no check failed."""
        return not self.failures()


def listed(items: list[str], most: int = 3) -> str:
    """The first few of some texts, and how many more there are."""
    more = len(items) - most
    return "; ".join(items[:most]) + (f"; and {more} more" if more > 0 else "")

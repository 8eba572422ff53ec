"""What is measured: a Case is one way (`by`) through one stage, at the sizes it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

OURS = "touchstone"
# The folder above our rooms: of a checkout, the one that has benchmarks/ too.
CHECKOUT = Path(__file__).resolve().parents[2]
# What a case's function hands back: does the work once, and says what came of it (`outcome`, `iterations`, `value`, `cpu_s`; all optional).
Work = Callable[[], Mapping[str, Any]]


@dataclass(frozen=True, order=True)
class Size:
    """n carts in a row, T = steps."""

    n: int
    steps: int

    def __str__(self) -> str:
        return f"n = {self.n}, T = {self.steps}" if self.n else ""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One row of the suite.

    function: `module:name`, called in the child as name(size, folder) -> Work: what it does before it returns is not measured.
    once: its work cannot be repeated in one process, or need not be; needs: modules that must be importable, with the words of how to get them;
    needs_file: what a checkout of the sources has and a package has not; only, largest: the one size it is for, the largest n T it is asked for; sized: False
    for what knows no size; slow: it takes minutes, and is measured once, if asked for; of_campaign: it needs a stored campaign.
    """

    stage: str
    title: str
    function: str
    by: str = OURS
    once: bool = False
    needs: Mapping[str, str] = field(default_factory=dict, hash=False)
    needs_file: str = ""
    only: Size | None = None
    largest: int | None = None
    sized: bool = True
    slow: bool = False
    of_campaign: bool = False
    clock: Literal["CPU", "wall"] = "CPU"

    @property
    def names(self) -> tuple[str, ...]:
        """What `-k` looks at."""
        return (self.stage, self.by)

    def missing(self) -> str:
        """Empty, or the sentence why this case cannot be measured here."""
        from importlib.util import find_spec

        for module, remedy in self.needs.items():
            if find_spec(module) is None:
                return f"{self.stage} by {self.by} is not measured: the module {module} is not installed ({remedy})."
        if self.needs_file and not (CHECKOUT / self.needs_file).is_file():
            return f"{self.stage} by {self.by} is not measured: {self.needs_file} is there in a checkout of the sources only."
        return ""

    def fits(self, size: Size) -> bool:
        """Whether it is to be measured at this size."""
        if self.only is not None:
            return size == self.only
        return self.largest is None or size.n * size.steps <= self.largest


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One measurement. cpu_s [s]: of one call of the work, its child processes included; memory_mib: what the work added to the resident
    set at its largest; value: a number by which it can be seen that all ways end at the same answer; failed: why there is none."""

    cpu_s: float | None
    memory_mib: float | None = None
    outcome: str = "ok"
    iterations: int = 0
    value: float | None = None
    failed: str = ""


def scratch(folder: str | Path) -> Path:
    """A new folder inside `folder`, for a work that must find nothing there."""
    import tempfile

    return Path(tempfile.mkdtemp(dir=folder))

"""What is measured: a Case is one way (`by`) through one stage, at the sizes it is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from benchmarks.measure import Size

OURS = "touchstone"


@dataclass(frozen=True, kw_only=True)
class Case:
    """One row of the suite.

    function: `module:name`, called in the child as name(size, folder) -> Work: what it does before it returns is not measured.
    once: its work cannot be repeated in one process, or need not be; needs: modules that must be importable, with the words of how to get them;
    only, largest: the one size it is for, the largest n T it is asked for; sized: False for what knows no size; slow: it takes minutes, and is measured once, if asked for; of_campaign: it needs a stored campaign.
    """

    stage: str
    title: str
    function: str
    by: str = OURS
    once: bool = False
    needs: Mapping[str, str] = field(default_factory=dict, hash=False)
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
        return ""

    def fits(self, size: Size) -> bool:
        """Whether it is to be measured at this size."""
        if self.only is not None:
            return size == self.only
        return self.largest is None or size.n * size.steps <= self.largest

"""RobustnessRecord: robustness of a plan, as written by `validate robust` (docs/robustness.md).

record = RobustnessRecord.model_validate(result, from_attributes=True)
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Annotated, Any

from pydantic import BeforeValidator

from reports.records.record import Finite, FoundRecord, ShareRecord


def _text(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and math.isinf(value) else value


_Word = Annotated[str, BeforeValidator(_text)]


_OrEnded = Annotated[Finite | None, BeforeValidator(_known)]


class CheckedRecord(FoundRecord):
    """Repeated worlds; differ: (number, share by the everyday replay, share by the reference).

    A share is None if the motion ended early.
    """

    count: int
    differ: tuple[tuple[int, _OrEnded, _OrEnded], ...]
    largest_difference: Finite
    by: str = "by the reference"


class WayRecord(FoundRecord):
    """Inputs alone, or with feedback; fails_by: worlds by metric or ending."""

    name: str
    share: ShareRecord
    fails_by: dict[str, int]
    checked: CheckedRecord | None

    @property
    def fails(self) -> str:
        """Return the failing metrics, the most frequent first, or ""."""
        counts = sorted(self.fails_by.items(), key=lambda item: -item[1])
        return "; ".join(f"{name.replace('_', ' ')} in {count:,}" for name, count in counts)


class PerturbationRecord(FoundRecord):
    """One perturbation, and its size [unit]."""

    kind: _Word
    name: str
    nominal: Finite
    size: Finite
    unit: str
    reason: str


class FailureRecord(FoundRecord):
    """The first failure of one perturbation in one direction; sizes None: none up to `tried`."""

    cause: PerturbationRecord
    direction: int
    sizes: Finite | None
    amount: Finite | None
    tried: Finite
    by: str

    @property
    def words(self) -> str:
        """Return `c by -0.0833 N s/m (0.83 of its size)`."""
        of = "" if self.cause.unit == "1" else f" {self.cause.unit}"
        return f"{self.cause.name} by {self.amount:+.3g}{of} ({self.sizes:.2f} of its size)"


class RobustnessRecord(FoundRecord):
    """Robustness of a plan; complete: False if interrupted; followed: failures with feedback."""

    scene: str
    verdict: _Word
    seed: int
    fineness: int
    causes: tuple[PerturbationRecord, ...]
    ways: tuple[WayRecord, ...]
    failures: tuple[FailureRecord, ...]
    weakest: FailureRecord | None
    trials: int
    seconds: Finite
    complete: bool
    followed: bool

    @property
    def summary(self) -> str:
        """Return the shares of worlds, and the weakest perturbation."""
        shares = "; ".join(f"{way.name} it arrives in {way.share.words}" for way in self.ways)
        weakest = "" if self.weakest is None else f" It takes least of: {self.weakest.words}."
        return f"{shares[:1].upper()}{shares[1:]}.{weakest}{'' if self.complete else ' The work was interrupted.'}"

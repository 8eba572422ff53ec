"""RobustnessRecord: how much a plan can take, as `validate robust` writes it (docs/robustness.md).

# of validate.judge.robustness
record = RobustnessRecord.model_validate(found, from_attributes=True)
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
    """None for the share of a motion that did not come to its end: JSON has no infinity."""
    return None if isinstance(value, float) and math.isinf(value) else value


_Word = Annotated[str, BeforeValidator(_text)]


_OrEnded = Annotated[Finite | None, BeforeValidator(_known)]


class CheckedRecord(FoundRecord):
    """How many worlds the reference was asked about too.

    differ: (number of the world, its largest share of a limit by the everyday replay, by the
        reference), None where the motion did not come to its end;
    by: what the second word is of, such as "by the reference".
    """

    count: int
    differ: tuple[tuple[int, _OrEnded, _OrEnded], ...]
    largest_difference: Finite
    by: str = "by the reference"


class WayRecord(FoundRecord):
    """Inputs alone, or with feedback; fails_by: metric or end of the motion -> worlds."""

    name: str
    share: ShareRecord
    fails_by: dict[str, int]
    checked: CheckedRecord | None

    @property
    def fails(self) -> str:
        """What fails in the worlds in which the plan does not arrive, the most frequent first.

        Empty where it arrives in all.
        """
        counts = sorted(self.fails_by.items(), key=lambda item: -item[1])
        return "; ".join(f"{name.replace('_', ' ')} in {count:,}" for name, count in counts)


class PerturbationRecord(FoundRecord):
    """What may be otherwise, and by how much [unit]."""

    kind: _Word
    name: str
    nominal: Finite
    size: Finite
    unit: str
    reason: str


class FailureRecord(FoundRecord):
    """The first failure along one perturbation, one way.

    sizes: in its sizes, None: none up to `tried`; amount [unit].
    """

    cause: PerturbationRecord
    direction: int
    sizes: Finite | None
    amount: Finite | None
    tried: Finite
    by: str

    @property
    def words(self) -> str:
        """C by -0.0833 N s/m (0.83 of its size)."""
        of = "" if self.cause.unit == "1" else f" {self.cause.unit}"
        return f"{self.cause.name} by {self.amount:+.3g}{of} ({self.sizes:.2f} of its size)"


class RobustnessRecord(FoundRecord):
    """How much a plan can take; complete: False where the work was interrupted.

    followed: whether failures are those with feedback, because the plan holds only with it.
    """

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
        """In what share of the worlds the plan arrives, and what it takes least of."""
        shares = "; ".join(f"{way.name} it arrives in {way.share.words}" for way in self.ways)
        weakest = "" if self.weakest is None else f" It takes least of: {self.weakest.words}."
        return f"{shares[:1].upper()}{shares[1:]}.{weakest}{'' if self.complete else ' The work was interrupted.'}"

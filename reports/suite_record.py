"""What `python -m validate bench` leaves for the report: every stage beside its peers, and the figures that were set as targets."""

from __future__ import annotations

from statistics import median, quantiles
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from reports.record import Finite, ProvenanceRecord

Count = Annotated[int, Field(ge=0)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def middle(samples: tuple[float, ...]) -> float | None:
    """The median; None of nothing."""
    return median(samples) if samples else None


def spread(samples: tuple[float, ...]) -> float | None:
    """Half of the samples lie within this much of each other, relative to the median; None of fewer than three."""
    if len(samples) < 3 or median(samples) == 0:
        return None
    first, _, third = quantiles(samples, n=4, method="inclusive")
    return (third - first) / abs(median(samples))


class SuiteRow(_Model):
    """One way (`by`) through one stage at one size; n = 0: it knows no size.

    cpu_s [s], memory_mib [MiB]: a sample of each round, in order; clock: what the seconds are of; value: a number that all ways through a stage must agree on;
    failed: why there are no samples.
    """

    stage: str
    title: str
    by: str
    n: Count
    steps: Count
    cpu_s: tuple[Finite, ...]
    memory_mib: tuple[Finite, ...]
    clock: Literal["CPU", "wall"] = "CPU"
    outcome: str = ""
    iterations: Count = 0
    value: Finite | None = None
    failed: str = ""


class SuiteFigure(_Model):
    """One target: measured is the median of `samples`, one of each round, and should be at most `target`.

    met: None where it was not measured, or not at the size the target is set for; why: then the reason, else what else there is to say.
    """

    name: str
    what: str
    n: Count
    steps: Count
    target: Finite
    unit: str = ""
    samples: tuple[Finite, ...] = ()
    measured: Finite | None = None
    met: bool | None = None
    why: str = ""


class SuiteRecord(_Model):
    """repeats: rounds asked for; load: the system's load average before and after, None where it has none; left_out: what was not measured, in
    sentences."""

    kind: Literal["suite"]
    rows: tuple[SuiteRow, ...]
    figures: tuple[SuiteFigure, ...]
    repeats: Count
    quick: bool = False
    load: tuple[Finite, Finite] | None = None
    left_out: tuple[str, ...] = ()
    provenance: ProvenanceRecord

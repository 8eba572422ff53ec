"""The records that benchmarks store in DIR/NAME.json: a suite, or tables."""

from __future__ import annotations

from statistics import median, quantiles
from typing import Annotated, Literal

from pydantic import Field, JsonValue

from reports.records.record import Finite, Model, ProvenanceRecord

Count = Annotated[int, Field(ge=0)]


def middle(samples: tuple[float, ...]) -> float | None:
    """The median; None of nothing."""
    return median(samples) if samples else None


def spread(samples: tuple[float, ...]) -> float | None:
    """Half of the samples lie within this much of each other, relative to the median.

    None of fewer than three.
    """
    if len(samples) < 3 or median(samples) == 0:
        return None
    first, _, third = quantiles(samples, n=4, method="inclusive")
    return (third - first) / abs(median(samples))


class SuiteRow(Model):
    """One way (`by`) through one stage at one size; n = 0: it knows no size.

    cpu_s [s], memory_mib [MiB]: a sample of each round, in order; clock: what the seconds are of;
        value: a number that all ways through a stage must agree on;
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


class SuiteFigure(Model):
    """One target: measured is the median of `samples`, one of each round, and should be at most `target`.

    met: None where it was not measured, or not at the size the target is set for; why: then the
        reason, else what else there is to say.
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


class SuiteRecord(Model):
    """repeats: rounds asked for.

    load: the system's load average before and after, None where it has none; left_out: what was not
    measured, in

    sentences.
    """

    kind: Literal["suite"]
    rows: tuple[SuiteRow, ...]
    figures: tuple[SuiteFigure, ...]
    repeats: Count
    quick: bool = False
    load: tuple[Finite, Finite] | None = None
    left_out: tuple[str, ...] = ()
    provenance: ProvenanceRecord


class Table(Model):
    """columns: their heads, with units; notes: sentences below it."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | Finite | None, ...], ...]
    notes: tuple[str, ...] = ()


class TableRecord(Model):
    """about: a sentence above the tables.

    runs: every single run that they are made of, as JSON data.
    """

    kind: Literal["table"]
    name: str
    title: str
    about: str
    tables: tuple[Table, ...]
    runs: tuple[dict[str, JsonValue], ...] = ()
    provenance: ProvenanceRecord

"""What benchmarks leave for their page: DIR/*.json, one record a file, told apart by `kind`.

BenchRecord.model_validate_json(text).root        a CosimRecord, a ReplaySpeedRecord ..
"""

from __future__ import annotations

from statistics import median, quantiles
from typing import Annotated, Literal

from pydantic import Field, JsonValue, RootModel

from reports.records.record import Finite, Model, ProvenanceRecord

Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Record(Model):
    """provenance: of the command that measured it; None in records of before it was stored."""

    provenance: ProvenanceRecord | None = None


class CosimRow(Model):
    """One master at one macro step h [s]. energy_error: relative, with its sign, the largest of the run; momentum_error [kg m/s],
    position_error [m]; cpu_per_s: CPU seconds a simulated second; mean_step [s]: the steps really
    made.
    """

    h: Positive
    mean_step: Positive
    energy_error: Finite
    momentum_error: Finite
    position_error: Finite
    cpu_per_s: Finite


class CosimMaster(Model):
    """failed: why rows are missing, or nothing."""

    name: str
    rows: tuple[CosimRow, ...]
    failed: str = ""


class CosimCase(Model):
    """frequency: omega of the bodies on closed contacts [rad/s]; horizon [s]."""

    name: str
    title: str
    frequency: Positive
    horizon: Positive
    masters: tuple[CosimMaster, ...]


class CosimRecord(_Record):
    kind: Literal["cosim"]
    cases: tuple[CosimCase, ...]


class SpeedRow(Model):
    """One replay: setting is rtol of Model Exchange, or the internal steps a plan step of Co-Simulation; error_m None: it did not reach the end."""

    kind: str
    setting: Positive
    cpu_s: Finite
    error_m: Finite | None
    outcome: str


class SpeedScene(Model):
    """default_cpu_s: what a replay as `python -m validate all` runs it takes.

    self_error_m: what that replay says of itself [m].
    """

    name: str
    default_cpu_s: Finite
    reference_cpu_s: Finite
    everyday_cpu_s: Finite
    parent_cpu_s_of_a_child: Finite
    self_error_m: Finite | None
    closed_form_relative_errors: dict[str, Finite]
    sweep: tuple[SpeedRow, ...]


class ReplaySpeedRecord(_Record):
    kind: Literal["replay_speed"]
    scenes: tuple[SpeedScene, ...]


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


class TableRecord(_Record):
    """What is told in tables alone. about: a sentence above them.

    runs: every single run that they are made of, as JSON data.
    """

    kind: Literal["table"]
    name: str
    title: str
    about: str
    tables: tuple[Table, ...]
    runs: tuple[dict[str, JsonValue], ...] = ()


AnyRecord = CosimRecord | ReplaySpeedRecord | SuiteRecord | TableRecord


class BenchRecord(RootModel[Annotated[AnyRecord, Field(discriminator="kind")]]):
    """A record of any kind, in `root`."""

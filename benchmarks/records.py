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


class OrderRow(Model):
    """One grid of one scheme, h [s]. replay_error, plan_error: largest position differences to the replay of the plan's inputs and to the finest plan;
    None: no plan, or no replay to the end. switch_error: bound of the velocity errors where
        contacts open and close.
    """

    scheme: str
    steps: Annotated[int, Field(ge=1)]
    h: Positive
    outcome: str
    cpu_s: Finite
    iterations: Annotated[int, Field(ge=0)]
    cost: Finite | None
    replay_error: Finite | None
    plan_error: Finite | None
    switch_error: Finite | None


class OrderChoice(Model):
    """A grid that is good enough."""

    scheme: str
    steps: Annotated[int, Field(ge=1)]
    cpu_s: Finite
    replay_error: Finite


class OrderAnswer(Model):
    """The cheapest grid whose replay error is within the target: of all schemes, and of semi-implicit Euler; None: no grid that was tried."""

    target: Positive
    best: OrderChoice | None
    euler: OrderChoice | None


class OrderScene(Model):
    """unit: of positions.

    orders: slope of log(replay error) over log(h) by scheme, None with too few grids.
    """

    name: str
    unit: str
    horizon: Positive
    orders: dict[str, Finite | None]
    rows: tuple[OrderRow, ...]
    answers: tuple[OrderAnswer, ...]


class OrderRecord(_Record):
    kind: Literal["order"]
    scenes: tuple[OrderScene, ...]


class ScalingRow(Model):
    """One size: n bodies, T = steps. cpu_s, memory_mib None: no answer within the limit.

    Cost None: the stage finds no plan.
    """

    n: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(ge=1)]
    cpu_s: Finite | None
    memory_mib: Finite | None
    iterations: Count
    outcome: str
    cost: Finite | None


class ScalingStage(Model):
    """Exponents: slopes of log(CPU s), log(CPU s an iteration), log(MiB) over log(n T).

    None: too few sizes.
    """

    name: str
    time_exponent: Finite | None
    iteration_exponent: Finite | None
    memory_exponent: Finite | None
    rows: tuple[ScalingRow, ...]


class ScalingRecord(_Record):
    kind: Literal["scaling"]
    stages: tuple[ScalingStage, ...]


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


AnyRecord = (
    CosimRecord | OrderRecord | ReplaySpeedRecord | ScalingRecord | SuiteRecord | TableRecord
)


class BenchRecord(RootModel[Annotated[AnyRecord, Field(discriminator="kind")]]):
    """A record of any kind, in `root`."""

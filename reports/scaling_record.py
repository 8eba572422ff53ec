"""What `benchmarks/bench_scaling.py` leaves for the report: CPU time and memory of each stage over the size of the problem."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from reports.record import Finite

Count = Annotated[int, Field(ge=0)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ScalingRow(_Model):
    """One size: n bodies, T = steps. cpu_s, memory_mib None: no answer within the limit; cost None: the stage finds no plan."""

    n: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(ge=1)]
    cpu_s: Finite | None
    memory_mib: Finite | None
    iterations: Count
    outcome: str
    cost: Finite | None


class ScalingStage(_Model):
    """Exponents: slopes of log(CPU s), log(CPU s an iteration), log(MiB) over log(n T); None: too few sizes."""

    name: str
    time_exponent: Finite | None
    iteration_exponent: Finite | None
    memory_exponent: Finite | None
    rows: tuple[ScalingRow, ...]


class ScalingRecord(_Model):
    kind: Literal["scaling"]
    stages: tuple[ScalingStage, ...]

"""What `benchmarks/bench_order.py` leaves for the report: replay and plan error over the step, scheme by scheme, with CPU time."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from reports.record import Finite

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class OrderRow(_Model):
    """One grid of one scheme, h [s]. replay_error, plan_error: largest position differences to the replay of the plan's inputs and to the finest plan;
    None: no plan, or no replay to the end. switch_error: bound of the velocity errors where contacts open and close."""

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


class OrderChoice(_Model):
    """A grid that is good enough."""

    scheme: str
    steps: Annotated[int, Field(ge=1)]
    cpu_s: Finite
    replay_error: Finite


class OrderAnswer(_Model):
    """The cheapest grid whose replay error is within the target: of all schemes, and of semi-implicit Euler; None: no grid that was tried."""

    target: Positive
    best: OrderChoice | None
    euler: OrderChoice | None


class OrderScene(_Model):
    """unit: of positions; orders: slope of log(replay error) over log(h) by scheme, None with too few grids."""

    name: str
    unit: str
    horizon: Positive
    orders: dict[str, Finite | None]
    rows: tuple[OrderRow, ...]
    answers: tuple[OrderAnswer, ...]


class OrderRecord(_Model):
    kind: Literal["order"]
    scenes: tuple[OrderScene, ...]

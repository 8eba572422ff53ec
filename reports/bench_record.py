"""What benchmarks leave for the report: DIR/bench/*.json, one record a file, told apart by `kind`.

BenchRecord.model_validate_json(text).root        a CosimRecord, a ReplaySpeedRecord ..
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, RootModel

from reports.balance_record import BalanceRecord
from reports.order_record import OrderRecord
from reports.record import Finite
from reports.scaling_record import ScalingRecord
from reports.suite_record import SuiteRecord

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class CosimRow(_Model):
    """One master at one macro step h [s]. energy_error: relative, with its sign, the largest of the run; momentum_error [kg m/s],
    position_error [m]; cpu_per_s: CPU seconds a simulated second; mean_step [s]: the steps really made."""

    h: Positive
    mean_step: Positive
    energy_error: Finite
    momentum_error: Finite
    position_error: Finite
    cpu_per_s: Finite


class CosimMaster(_Model):
    """failed: why rows are missing, or nothing."""

    name: str
    rows: tuple[CosimRow, ...]
    failed: str = ""


class CosimCase(_Model):
    """frequency: omega of the bodies on closed contacts [rad/s]; horizon [s]."""

    name: str
    title: str
    frequency: Positive
    horizon: Positive
    masters: tuple[CosimMaster, ...]


class CosimRecord(_Model):
    kind: Literal["cosim"]
    cases: tuple[CosimCase, ...]


class SpeedRow(_Model):
    """One replay: setting is rtol of Model Exchange, or the internal steps a plan step of Co-Simulation; error_m None: it did not reach the end."""

    kind: str
    setting: Positive
    cpu_s: Finite
    error_m: Finite | None
    outcome: str


class SpeedScene(_Model):
    """default_cpu_s: what a replay as `python -m validate all` runs it takes; self_error_m: what that replay says of itself [m]."""

    name: str
    default_cpu_s: Finite
    reference_cpu_s: Finite
    everyday_cpu_s: Finite
    parent_cpu_s_of_a_child: Finite
    self_error_m: Finite | None
    closed_form_relative_errors: dict[str, Finite]
    sweep: tuple[SpeedRow, ...]


class ReplaySpeedRecord(_Model):
    kind: Literal["replay_speed"]
    scenes: tuple[SpeedScene, ...]


class StiffnessRow(_Model):
    """One contact stiffness k [N/m]. omega_h: the contact's frequency times the time step; outcomes, costs: of each try by its start; cost: of the
    best plan, None without one; replayed_cost: of its inputs in the continuous dynamics."""

    k: Positive
    steps: int = Field(gt=0)
    omega_h: Positive
    outcomes: dict[str, str]
    costs: dict[str, Finite | None]
    cost: Finite | None
    replayed_cost: Finite | None
    cpu_s: Finite


class RigidLimitCase(_Model):
    """rigid: the optimum in the limit of rigid bodies."""

    name: str
    title: str
    rigid: Positive
    rows: tuple[StiffnessRow, ...]


class RigidLimitRecord(_Model):
    kind: Literal["rigid_limit"]
    cases: tuple[RigidLimitCase, ...]


AnyBench = BalanceRecord | CosimRecord | OrderRecord | ReplaySpeedRecord | RigidLimitRecord | ScalingRecord | SuiteRecord


class BenchRecord(RootModel[Annotated[AnyBench, Field(discriminator="kind")]]):
    """A record of any kind, in `root`."""

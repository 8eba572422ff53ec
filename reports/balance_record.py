"""What benchmarks/bench_cart_pole.py leaves: random starts of an unstable scene, and whether each is balanced."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

_Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class BalanceStart(_Model):
    """x [m], theta [rad]: the start, at rest; share: of the inputs' bounds that the plan was given; wall_impulse [N s] in the replay with feedback; ends: norm of
    the state's distance from the goal, None without a plan; effort, peak: of the feedback, as shares of half the inputs' range; CPU seconds of all that
    was tried for this start."""

    x: _Finite
    theta: _Finite
    share: _Finite
    outcome: str
    balanced: bool
    why: str
    wall_impulse: _Finite
    tracked_end: _Finite | None
    open_end: _Finite | None
    plan_end: _Finite | None
    effort: _Finite | None
    peak: _Finite | None
    amplification: _Finite | None
    plan_cpu_s: _Finite
    judge_cpu_s: _Finite


class BalanceRecord(_Model):
    """limit: of the scene on the judged replay's end, within which a start is balanced."""

    kind: Literal["unstable_starts"]
    scene: str
    pipeline: str
    seed: int
    limit: _Finite
    starts: tuple[BalanceStart, ...]

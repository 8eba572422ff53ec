"""What is stored of a replay with feedback, beside the one of the inputs alone."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

_Finite = Annotated[float, Field(allow_inf_nan=False)]


class TrackedRecord(BaseModel):
    """rms, peak: what the feedback added to the plan's inputs, of each input in its unit; rms_share, peak_share: the largest over the inputs as a share of
    half the input's range; plan_share: of all, as a share of the plan's own inputs (None: those are 0); saturated: share of the steps at a bound by the feedback; the rest as in ReplayRecord."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    error_estimate: _Finite | None
    events: int = 0
    seconds_reference: _Finite = 0.0
    seconds_everyday: _Finite = 0.0
    message: str = ""
    rms: tuple[_Finite, ...] = ()
    peak: tuple[_Finite, ...] = ()
    rms_share: _Finite = 0.0
    peak_share: _Finite = 0.0
    plan_share: _Finite | None = 0.0
    saturated: _Finite = 0.0

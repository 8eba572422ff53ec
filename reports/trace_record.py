"""TraceRecord: thinned arrays of a plan or a replay, for plots and the player."""

from __future__ import annotations

from typing import Self

from pydantic import BaseModel, ConfigDict, model_validator

from reports.series import Floats, Poses


class TraceRecord(BaseModel):
    """Thinned arrays of one stage for plots: plan and replay on their own thinned times, at most 1500 of them.

    Columns: coordinates, velocities and inputs by their own names; per contact `lam_<contact>` [N] and `gap_<contact>` [m]
    (gap = -penetration); per friction its force [N] by its own name; in a replay also `position_error`, the largest over the coordinates against the plan. Each column is
    as long as `t` or shorter (quantities of steps: one less); what is missing is shown as missing.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    t: Floats
    columns: dict[str, Floats]
    poses: dict[str, Poses] = {}  # shape -> (x, y, angle) per thinned time

    @model_validator(mode="after")
    def _is_not_longer_than_its_times(self) -> Self:
        for name, values in (*self.columns.items(), *self.poses.items()):
            if len(values) > len(self.t):
                raise ValueError(f"{name} has {len(values)} values at {len(self.t)} times")
        return self

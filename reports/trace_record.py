"""TraceRecord: thinned arrays of a plan or a replay, for plots and the player.

Columns of numbers are tuples in memory and in JSON the base64 of their bytes (float64, little-endian, row by row): read ten times as fast as digits, and
a third as long. A list of numbers is read as well.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, FiniteFloat, PlainSerializer, model_validator

Pose = tuple[float, float, float]
_TYPE = "<f8"


def _text(values: Sequence[Any]) -> str:
    return base64.b64encode(np.asarray(values, _TYPE).tobytes()).decode("ascii")


def _floats(value: Any) -> Any:
    """The numbers of a text, which raises ValueError where it holds none; anything else as it is."""
    return tuple(np.frombuffer(base64.b64decode(value, validate=True), _TYPE).tolist()) if isinstance(value, str) else value


def _poses(value: Any) -> Any:
    return tuple(map(tuple, np.reshape(_floats(value), (-1, 3)).tolist())) if isinstance(value, str) else value


_written = PlainSerializer(_text, return_type=str, when_used="json")
Floats = Annotated[tuple[FiniteFloat, ...], BeforeValidator(_floats), _written]
Poses = Annotated[tuple[tuple[FiniteFloat, FiniteFloat, FiniteFloat], ...], BeforeValidator(_poses), _written]


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

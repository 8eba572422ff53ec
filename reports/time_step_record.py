"""TimeStepRecord: whether the time step of a scene is stable while contacts are closed, found out before anything ran."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]


class TimeStepRecord(BaseModel):
    """radius: spectral radius of the step's Jacobian with these contacts closed; growth [1/s] of the motion itself there.

    largest_step [s]: below it the step is stable with every set of contacts (None: always); warning: a sentence, empty where it is stable; digest:
    of the scene, so that it is looked at once.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    scene: str
    digest: str
    step: Finite
    radius: Finite
    contacts: tuple[str, ...]
    growth: Finite
    largest_step: Finite | None
    warning: str = ""

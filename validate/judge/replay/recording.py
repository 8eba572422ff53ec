"""What one simulation of a replay records, point by point, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Fatal

from validate.judge.replay.result import ReplayOutcome

# A state this many times its nominal (and its start) has left every bound; in Co-Simulation, which tells no nominals, this itself.
DIVERGENCE = 1e9


@dataclass(kw_only=True)
class Run:
    """What one simulation recorded, point by point.

    Times, outputs of the model and accumulated quantities per point; rows that are nodes; events as (time, indicator, closes); with feedback the
    inputs applied from the start of each step on; with rollback what halving each step changed.
    """

    t: list[float] = field(default_factory=list)
    outputs: list[np.ndarray] = field(default_factory=list)
    accumulated: list[np.ndarray] = field(default_factory=list)
    knots: list[int] = field(default_factory=list)
    events: list[tuple[float, int, bool]] = field(default_factory=list)
    applied: list[np.ndarray] = field(default_factory=list)
    local: list[np.ndarray] = field(default_factory=list)
    outcome: ReplayOutcome = ReplayOutcome.OK
    message: str = ""

    def end_without_number(self, time: float) -> None:
        """The outputs at a time [s] are not all finite."""
        self.outcome, self.message = ReplayOutcome.NOT_A_NUMBER, f"An output was not a finite number at t = {time:.6g} s."

    def end_out_of_bounds(self, time: float) -> None:
        """A state is beyond any bound at a time [s] that was stepped to."""
        self.outcome, self.message = ReplayOutcome.DIVERGED, f"A state left every bound by t = {time:.6g} s."

    def end_refused(self, error: FMICallException, begin: float) -> None:
        """The FMU refused a call; begin: the first time of the run [s]."""
        self.outcome = ReplayOutcome.FATAL if error.status == fmi2Fatal else ReplayOutcome.FMU_FAILED
        self.message = f"{str(error).rstrip('.')} (after t = {self.t[-1] if self.t else begin:.6g} s)."


class Stop(Exception):  # noqa: N818 - it ends a run, and is no error of the program
    """A run cannot go on: its outcome, and a sentence."""

    def __init__(self, outcome: ReplayOutcome, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome
        self.message = message

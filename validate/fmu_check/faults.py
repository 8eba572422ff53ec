"""What keeps a check from going on: the FMU's fault, this machine's, or the FMU's right to end a simulation."""

from __future__ import annotations


class Misbehaviour(Exception):  # noqa: N818 - a finding about the FMU, not an error of ours
    """The FMU did something that leaves the check nothing to do but to fail, with this sentence."""


class Lacking(Exception):  # noqa: N818 - says what this machine does not have
    """The FMU's code needs something of the machine that is not there."""


class Ended(Exception):  # noqa: N818 - what a sound FMU may do
    """The FMU asked for the end of the simulation: a run cannot reach `time` [s]. It is run again, and shorter."""

    def __init__(self, time: float) -> None:
        super().__init__(f"it asked to end the simulation at t = {time:.6g} s")
        self.time = time

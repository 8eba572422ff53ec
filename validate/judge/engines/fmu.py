"""Our FMU, the reference: Model Exchange by CVODE, stopped at every event."""

from __future__ import annotations

from contextlib import closing

from validate.fmi.description import Package
from validate.judge.engines._runs import motion_of
from validate.judge.replay.reference import PARTS, ExchangeModel, integrate
from validate.judge.replay.result import Run
from validate.judge.replay.run import EVENT_BUDGET
from validate.judge.replay.wiring import HeldInputs, Variables
from validate.judge.simulator import Drive, SimulatedMotion, Simulator

ENGINE = Simulator(title="our FMU, reference (CVODE)", tolerances=(1e-7, 1e-9, 1e-11, 1e-13), law="the scene's own, events located")


def simulate(drive: Drive) -> SimulatedMotion:
    """The motion of a drive at its tolerance. Raises FmuError."""

    def steps(package: Package, variables: Variables, inputs: HeldInputs) -> Run:
        """Of its Model Exchange. Raises FmuError."""
        with closing(ExchangeModel(package, variables)) as model:
            return integrate(model, drive.start, inputs, drive.tolerance, EVENT_BUDGET, parts=PARTS)

    return motion_of(drive, steps)

"""Our FMU, the reference: Model Exchange by CVODE, stopped at every event."""

from __future__ import annotations

import time

from models.fmu import build_fmu
from validate.fmi.description import read_package, unpacked
from validate.judge.engines._runs import motion_of
from validate.judge.replay.reference import PARTS, ExchangeModel, integrate
from validate.judge.replay.run import EVENT_BUDGET
from validate.judge.replay.subject import find_variables
from validate.judge.replay.wiring import HeldInputs
from validate.judge.simulator import Drive, SimulatedMotion, Simulator

ENGINE = Simulator(title="our FMU, reference (CVODE)", tolerances=(1e-7, 1e-9, 1e-11, 1e-13), law="the scene's own, events located")


def simulate(drive: Drive) -> SimulatedMotion:
    """The motion of a drive at its tolerance. Raises FmuError."""
    with unpacked(read_package(build_fmu(drive.scene, results=False))) as package:
        variables = find_variables(package, drive.scene)
        model = ExchangeModel(package, variables)
        began = time.process_time()
        try:
            run = integrate(model, drive.start, HeldInputs(drive.plan, drive.feedback), drive.tolerance, EVENT_BUDGET, parts=PARTS)
        finally:
            model.close()
        return motion_of(drive, variables, run, steps=0, seconds=time.process_time() - began)

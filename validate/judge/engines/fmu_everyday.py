"""Our FMU, every day: Co-Simulation with its own internal step."""

from __future__ import annotations

import time

from models.fmu import build_fmu
from validate.fmi.description import read_package, unpacked
from validate.judge.engines._runs import motion_of
from validate.judge.replay.everyday import simulate as step_through
from validate.judge.replay.subject import find_variables
from validate.judge.replay.wiring import HeldInputs
from validate.judge.simulator import Drive, SimulatedMotion, Simulator

ENGINE = Simulator(title="our FMU, every day (fixed step)", law="the scene's own, at its internal steps")


def simulate(drive: Drive) -> SimulatedMotion:
    """The motion of a drive at its step. Raises FmuError."""
    with unpacked(read_package(build_fmu(drive.scene, results=False))) as package:
        variables, inputs = find_variables(package, drive.scene), HeldInputs(drive.plan, drive.feedback)
        began = time.process_time()
        run = step_through(package, variables, drive.start, inputs, drive.parts)
        return motion_of(drive, variables, run, steps=drive.plan.steps * drive.parts, seconds=time.process_time() - began)

"""Our FMU by Co-Simulation with its own internal step."""

from __future__ import annotations

from validate.judge.engines.adapters.fmu import motion_of
from validate.judge.engines.simulator import Drive, SimulatedMotion, Simulator
from validate.judge.replay.everyday import simulate as step_through

ENGINE = Simulator(
    title="our FMU, every day (fixed step)", law="the scene's own, at its internal steps"
)


def simulate(drive: Drive) -> SimulatedMotion:
    """Return the motion of a drive. Raises FmuError."""
    return motion_of(
        drive,
        lambda package, variables, inputs: step_through(
            package, variables, drive.start, inputs, drive.parts
        ),
    )

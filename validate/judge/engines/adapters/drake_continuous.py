"""Drake's continuous plant: point contact, Runge-Kutta 5 with error control."""

from __future__ import annotations

from validate.judge.engines.adapters._drake import Plant
from validate.judge.engines.simulator import Drive, SimulatedMotion, Simulator, stepped

ENGINE = Simulator(
    title="Drake, continuous (Runge-Kutta 5)",
    package="pydrake",
    extra="bench-drake",
    tolerances=(1e-7, 1e-9, 1e-11, 1e-13),
    law="points between balls and half-spaces, Hunt and Crossley; friction regularised below 0.1 mm/s",
)


def simulate(drive: Drive) -> SimulatedMotion:
    """Return the motion of a drive. Raises CannotExpressError."""
    return stepped(drive, Plant(drive).advance("runge_kutta5", drive))

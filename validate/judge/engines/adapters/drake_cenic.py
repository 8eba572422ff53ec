"""Drake CENIC: convex, error-controlled integration of the continuous plant."""

from __future__ import annotations

from validate.judge.engines.adapters._drake import Plant
from validate.judge.engines.simulator import Drive, SimulatedMotion, Simulator, stepped

ENGINE = Simulator(
    title="Drake, CENIC",
    package="pydrake",
    extra="bench-drake",
    tolerances=(1e-4, 1e-5, 1e-6, 1e-7),
    law="points between balls and half-spaces, Hunt and Crossley, convex; friction regularised below 0.1 mm/s",
)


def simulate(drive: Drive) -> SimulatedMotion:
    """Return the motion of a drive. Raises CannotExpressError."""
    return stepped(drive, Plant(drive).advance("cenic", drive))

"""Which Ipopt runs: the fastest one that is installed and knows the options asked for."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from formulations.ipopt.backend import Backend
from formulations.ipopt.backend_cyipopt import Cyipopt
from formulations.ipopt.backend_ipyopt import Ipyopt
from formulations.ipopt.linear_solver import MUMPS, linear_solver
from models.errors import MachineError


def backends() -> tuple[Backend, ...]:
    """All back ends, fastest first."""
    return (Ipyopt(), Cyipopt())


def default_backend(options: Iterable[str] = ()) -> Backend:
    """The fastest installed back end that knows all these options; $TOUCHSTONE_IPOPT names one to insist on.

    Raises MachineError if there is none.
    """
    wanted = os.environ.get("TOUCHSTONE_IPOPT", "")
    names = tuple(options)
    for backend in backends():
        if wanted in ("", backend.name) and backend.available() and all(backend.knows(name) for name in names):
            return backend
    if wanted:
        known = ", ".join(backend.name for backend in backends())
        raise MachineError(
            f"the environment variable TOUCHSTONE_IPOPT asks for {wanted!r}, which is not installed or lacks an option; there are {known}."
        )
    raise MachineError("no Ipopt is installed; install it with: pip install cyipopt-wheels==1.7.0.dev0")


# MUMPS permutes the KKT matrix before it orders it, unless told otherwise; where softplus' tiny slopes stand on the diagonal that destroys the band
# of time steps: 10 carts at T = 500 take 0.04 instead of 1.1 CPU s an iteration, and 7 instead of 31 of them; three carts take the same.
_KEEP_THE_BAND = {"mumps_permuting_scaling": 0}


def band_options() -> dict[str, Any]:
    """What keeps the band of time steps where MUMPS factorises by default; nothing where our own does, because an option of MUMPS asks for MUMPS."""
    return dict(_KEEP_THE_BAND) if linear_solver("", default_backend()) == MUMPS else {}

"""Who factorises Ipopt's linear systems: our own L D L^T by fronts (`ldlt/`), or the MUMPS of the wheel.

The wheel's Ipopt can be handed a library with the calls of HSL's MA27, solver by solver; ours stand
    behind those. An optimality system of a plan is
a chain of small dense pieces: a general solver spends most of its time on itself there. An
    iteration but for its evaluations, with MUMPS and with
ours: two_discs 53 and 14 ms (`python -m benchmarks suite -k linear_algebra` measures the paper's
    scene).
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from pathlib import Path
from typing import Any

import cyipopt
import numpy as np

from models.codegen.compiler import cached_library
from models.errors import MachineError

LDLT = "ldlt"
MUMPS = "mumps"
LINEAR_SOLVERS = (LDLT, MUMPS)

_FOLDER = Path(__file__).with_name("ldlt")
_OPTIMISED = ("-O3",)
_CALLS = ("ma27ad_", "ma27bd_", "ma27cd_", "ma27id_")
# What decides which compiler there is and where its work is kept.
_DECISIVE = ("CC", "PATH", "HOME", "TOUCHSTONE_CACHE", "XDG_CACHE_HOME")

_known: dict[tuple[str | None, ...], Path] = {}


def ldlt_library() -> Path:
    """The compiled library, with the entry points ma27id_, ma27ad_, ma27bd_, ma27cd_.

    Compiled again if it has gone.

    Raises
    ------
    MachineError
        without a compiler or a cache folder, and where what was compiled cannot be loaded here
    """
    place = tuple(map(os.environ.get, _DECISIVE))
    known = _known.get(place)
    if known is None or not known.exists():
        known = _known[place] = _compiled()
    return known


def _compiled() -> Path:
    path = cached_library(
        {path.name: path.read_text(encoding="utf-8") for path in _FOLDER.glob("*.[ch]")}, _OPTIMISED
    )
    try:
        loaded = ctypes.CDLL(str(path))
        for name in _CALLS:
            getattr(loaded, name)
    except (OSError, AttributeError) as error:
        raise MachineError(
            f"the compiled linear solver {path} cannot be loaded ({error}); remove it, or set TOUCHSTONE_CACHE elsewhere."
        ) from error
    return path


def linear_solver(asked: str = "") -> str:
    """Return the solver that is asked for, else that of $TOUCHSTONE_LINEAR_SOLVER, else `ldlt` if this Ipopt can load one.

    Raises
    ------
    MachineError
        for an unknown name, an `ldlt` that cannot be compiled, and one that this Ipopt cannot load
    """
    insisted = asked or os.environ.get("TOUCHSTONE_LINEAR_SOLVER", "")
    if insisted and insisted not in LINEAR_SOLVERS:
        raise MachineError(
            f"the environment variable TOUCHSTONE_LINEAR_SOLVER asks for {insisted!r}; there are {' and '.join(LINEAR_SOLVERS)}."
        )
    if insisted == MUMPS:
        return MUMPS
    ldlt_library()
    if loads_solvers():
        return LDLT
    if insisted:
        raise MachineError(
            "the installed Ipopt was built without loading linear solvers at run time; use linear_solver 'mumps'."
        )
    return MUMPS


@cache
def loads_solvers() -> bool:
    """Whether this Ipopt was built to load linear solvers at run time, as that of the wheel is."""

    class Nothing:  # a problem that is never solved
        objective = gradient = staticmethod(np.zeros_like)

    nlp = cyipopt.Problem(1, 0, Nothing(), [0.0], [1.0])
    try:
        for name, value in settings("linear_solver", LDLT):
            nlp.add_option(name, value)
    except TypeError:
        return False
    finally:
        nlp.close()
    return True


def settings(name: str, value: str | int | float) -> tuple[tuple[str, str | int | float], ...]:
    """An option in Ipopt's words: our factorisation stands behind the calls of MA27."""
    if name == "linear_solver" and value == LDLT:
        return (("hsllib", str(ldlt_library())), ("linear_solver", "ma27"))
    return ((name, value),)


# MUMPS permutes the KKT matrix before it orders it, unless told otherwise; where softplus' tiny
# slopes stand on the diagonal that destroys the band of time steps: 10 carts at T = 500 take 0.04
# instead of 1.1 CPU s an iteration, and 7 instead of 31 of them; three carts take the same.
_KEEP_THE_BAND = {"mumps_permuting_scaling": 0}


def band_options() -> dict[str, Any]:
    """What keeps the band of time steps where MUMPS factorises by default.

    Nothing where our own does, because an option of MUMPS asks for MUMPS.
    """
    return dict(_KEEP_THE_BAND) if linear_solver() == MUMPS else {}

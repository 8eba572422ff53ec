"""Select the linear solver of Ipopt: our L D L^T by fronts (`ldlt/`), or the wheel's MUMPS.

Ipopt loads our library through the calls of HSL's MA27. The KKT matrix of a plan is a chain of
small dense blocks: an iteration on two_discs takes 53 ms with MUMPS and 14 ms with `ldlt`.
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
# Environment variables that decide the compiler and the cache folder.
_DECISIVE = ("CC", "PATH", "HOME", "TOUCHSTONE_CACHE", "XDG_CACHE_HOME")

_known: dict[tuple[str | None, ...], Path] = {}


def ldlt_library() -> Path:
    """Return the path of the compiled library; compile it if it does not exist.

    Raises MachineError without a compiler or a cache folder, or if the library cannot be loaded.
    """
    place = tuple(map(os.environ.get, _DECISIVE))
    library = _known.get(place)
    if library is None or not library.exists():
        library = _known[place] = _compiled()
    return library


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


def linear_solver(selected: str = "") -> str:
    """Return `selected`, else $TOUCHSTONE_LINEAR_SOLVER, else `ldlt` if this Ipopt can load it.

    Raises MachineError for an unknown name, or if `ldlt` cannot be compiled or loaded.
    """
    name = selected or os.environ.get("TOUCHSTONE_LINEAR_SOLVER", "")
    if name and name not in LINEAR_SOLVERS:
        raise MachineError(
            f"the environment variable TOUCHSTONE_LINEAR_SOLVER is {name!r}; expected {' or '.join(LINEAR_SOLVERS)}."
        )
    if name == MUMPS:
        return MUMPS
    ldlt_library()
    if loads_solvers():
        return LDLT
    if name:
        raise MachineError(
            "the installed Ipopt was built without loading linear solvers at run time; use linear_solver 'mumps'."
        )
    return MUMPS


@cache
def loads_solvers() -> bool:
    """Return whether this Ipopt can load linear solvers at run time, as the wheel's can."""

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
    """Return an option under Ipopt's names; `ldlt` becomes ma27 with our library."""
    if name == "linear_solver" and value == LDLT:
        return (("hsllib", str(ldlt_library())), ("linear_solver", "ma27"))
    return ((name, value),)


# MUMPS permutes the KKT matrix before ordering it. The tiny softplus slopes on the diagonal then
# destroy the band of time steps. Ten carts at T = 500 then take 1.1 instead of 0.04 CPU s an
# iteration, and 31 instead of 7 iterations.
_KEEP_THE_BAND = {"mumps_permuting_scaling": 0}


def band_options() -> dict[str, Any]:
    """Return the options that keep the band of time steps, if MUMPS is the default solver.

    Empty for our solver, because a MUMPS option selects MUMPS.
    """
    return dict(_KEEP_THE_BAND) if linear_solver() == MUMPS else {}

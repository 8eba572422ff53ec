"""Who factorises Ipopt's linear systems: our own L D L^T by fronts (`ldlt/`), or the MUMPS of the wheels.

Both wheels' Ipopt can be handed the calls of HSL's MA27 at run time; ours stand behind those. An optimality system of a plan is a chain of small
dense pieces: a general solver spends most of its time on itself there. An iteration but for its evaluations, with MUMPS and with ours: two_discs
22 and 11 ms with ipyopt, 53 and 14 with cyipopt, two_finger 46 and 22 (`python -m validate bench -k linear_algebra` measures the paper's scene).
"""

from __future__ import annotations

import ctypes
import logging
import os
import platform
import sys
from functools import cache
from pathlib import Path
from typing import Protocol

from models.codegen.cache import cached
from models.codegen.compiler import FLAGS, compile_shared, find_compiler
from models.errors import MachineError

LDLT, MUMPS = "ldlt", "mumps"
LINEAR_SOLVERS = (LDLT, MUMPS)

_FOLDER = Path(__file__).with_name("ldlt")
_OPTIMISED = ("-O3",)
_CALLS = ("ma27ad_", "ma27bd_", "ma27cd_", "ma27id_")
# What decides which compiler there is and where its work is kept.
_DECISIVE = ("CC", "PATH", "HOME", "TOUCHSTONE_CACHE", "XDG_CACHE_HOME")

logger = logging.getLogger(__name__)
_known: dict[tuple[str | None, ...], Path | str] = {}


def ldlt_library() -> Path:
    """The compiled library, with the entry points ma27id_, ma27ad_, ma27bd_, ma27cd_; tried once, and again if it has gone.

    Raises MachineError without a compiler or a cache folder, and where what was compiled cannot be loaded here.
    """
    place = tuple(map(os.environ.get, _DECISIVE))
    known = _known.get(place)
    if known is None or (isinstance(known, Path) and not known.exists()):
        try:
            known = _compiled()
        except MachineError as error:
            known = str(error)
        _known[place] = known
    if isinstance(known, str):
        raise MachineError(known)
    return known


def _compiled() -> Path:
    compiler = find_compiler()
    sources = {path.name: path.read_text(encoding="utf-8") for path in sorted(_FOLDER.glob("*.[ch]"))}
    machine = f"{sys.platform} {platform.machine()}"
    key = "\n".join([compiler.describe(), machine, " ".join((*FLAGS, *_OPTIMISED)), *(f"{name}\n{text}" for name, text in sources.items())])
    path = cached(key, ".so", lambda path: compile_shared(compiler, sources, path, extra_flags=_OPTIMISED))
    try:
        loaded = ctypes.CDLL(str(path))
        for name in _CALLS:
            getattr(loaded, name)
    except (OSError, AttributeError) as error:
        raise MachineError(
            f"the compiled linear solver {path} cannot be loaded ({error}); remove it, or set TOUCHSTONE_CACHE elsewhere."
        ) from error
    return path


def available() -> bool:
    """Whether the library can be had here; if not, the log says why, once."""
    try:
        ldlt_library()
    except MachineError as error:
        _tell(str(error))
        return False
    return True


@cache
def _tell(why: str) -> None:
    logger.info("Ipopt's linear systems are factorised by MUMPS: %s", why)


class TakesLdlt(Protocol):
    name: str

    def takes_ldlt(self) -> bool: ...


def linear_solver(asked: str, backend: TakesLdlt) -> str:
    """What a back end factorises with: what is asked for, else what $TOUCHSTONE_LINEAR_SOLVER names, else `ldlt` where it can be had.

    Raises MachineError for a name there is not, and where `ldlt` is insisted on and cannot be had.
    """
    insisted = asked or os.environ.get("TOUCHSTONE_LINEAR_SOLVER", "")
    if insisted and insisted not in LINEAR_SOLVERS:
        raise MachineError(
            f"the environment variable TOUCHSTONE_LINEAR_SOLVER asks for {insisted!r}; there are {' and '.join(LINEAR_SOLVERS)}."
        )
    if insisted == MUMPS:
        return MUMPS
    if insisted == LDLT:
        ldlt_library()
    if backend.takes_ldlt():
        return LDLT
    if insisted:
        raise MachineError(f"the Ipopt of {backend.name} was built without loading linear solvers at run time; use linear_solver 'mumps'.")
    return MUMPS


@cache
def hand_to(extension: str) -> bool:
    """Hand the library to the Ipopt (before 3.14) that a loaded extension module is linked to; False where that cannot be handed one."""
    try:
        register = ctypes.CDLL(extension).LSL_setMA27
    except (OSError, AttributeError):
        return False
    library = ctypes.CDLL(str(ldlt_library()))
    calls = [getattr(library, name) for name in _CALLS]
    register.restype, register.argtypes = None, [ctypes.c_void_p] * len(calls)
    register(*(ctypes.cast(call, ctypes.c_void_p) for call in calls))
    return True

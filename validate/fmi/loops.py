"""The loops of a replay in C (loops.c), over the addresses of an FMU's functions.

    loops = load()                     # built once, then taken from the cache
    fmu = describe(instance, ...)      # the struct of an FMU

Python makes one call per step of the plan, instead of one per call of FMI.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Sequence
from enum import IntEnum
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from models.codegen.compiler import cached_library
from models.errors import MachineError
from validate.fmi.instance import Instance, References, TerminationRequested, endless

_SOURCE = Path(__file__).with_suffix(".c").read_text(encoding="utf-8")
_SIZE = ctypes.c_int64
_ADDRESS = ctypes.c_void_p

# The functions of FMI 2.0 and FMI 3.0, in the order of loops.c; FMI 3.0 has no call for slopes of
# inputs.
CALLS = (
    ("GetReal", "GetFloat64"), ("SetReal", "SetFloat64"), ("SetTime", "SetTime"),
    ("SetContinuousStates", "SetContinuousStates"),
    ("GetContinuousStates", "GetContinuousStates"),
    ("GetDerivatives", "GetContinuousStateDerivatives"),
    ("GetEventIndicators", "GetEventIndicators"),
    ("CompletedIntegratorStep", "CompletedIntegratorStep"), ("EnterEventMode", "EnterEventMode"),
    ("NewDiscreteStates", "UpdateDiscreteStates"),
    ("EnterContinuousTimeMode", "EnterContinuousTimeMode"), ("DoStep", "DoStep"),
    ("SetRealInputDerivatives", ""),
)  # fmt: skip

# The functions of SUNDIALS that the loops call, in the order of loops.c; a solver is made in Python
# (cvode.py).
SOLVER = (
    "N_VGetArrayPointer",
    "CVodeReInit",
    "CVodeSetStopTime",
    "CVodeClearStopTime",
    "CVode",
    "CVodeGetRootInfo",
)
_COUNTS = {"CALLS": len(CALLS), "SOLVER_CALLS": len(SOLVER)}


# Reasons of a loop to return, in the order of loops.c.
Reason = IntEnum(
    "Reason",
    "DONE EVENT CALL_REFUSED RATE_NOT_FINITE OUT_OF_BOUNDS SUM_NOT_FINITE OUTPUT_NOT_FINITE SOLVER_FAILED STOP_TIME_REFUSED SETUP_REFUSED WANTS_END "
    "NEVER_SETTLES EARLY_RETURN",
    start=0,
)


@cache
def structure(name: str) -> type[ctypes.Structure]:
    """Return a struct of loops.c for ctypes, with the fields declared there."""
    body = re.search(
        rf"^struct {name} {{$(.*?)^}};$",
        re.sub(r"/\*.*?\*/", "", _SOURCE, flags=re.DOTALL),
        re.DOTALL | re.MULTILINE,
    )
    assert body is not None, name
    kinds = {"double": ctypes.c_double, "int64_t": _SIZE, "function": _ADDRESS}
    fields: list[tuple[str, Any]] = []
    for kind, declared in re.findall(r"(?:const )?(struct \w+|\w+) (.*?);", body[1], re.DOTALL):
        for star, field, count in re.findall(r"(\*?)(\w+)(?:\[(\w+)\])?", declared):
            one = (
                _ADDRESS
                if star
                else structure(kind.removeprefix("struct "))
                if kind.startswith("struct ")
                else kinds[kind]
            )
            fields.append((field, one * _COUNTS[count] if count else one))
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def library_path() -> Path:
    """Return the compiled loops, built if they are not in the cache.

    Raises MachineError without a suitable compiler.
    """
    return cached_library({"loops.c": _SOURCE})


_adopted: list[Path] = []


def adopt(path: Path) -> None:
    """Use loops that the parent built: limits of this process would hold for its compiler, too."""
    _adopted[:] = [path]
    load.cache_clear()


@lru_cache(maxsize=1)
def load() -> Any:
    """Load the loops. Raises MachineError."""
    path = _adopted[0] if _adopted else library_path()
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise MachineError(
            f"{path} cannot be loaded ({error}); let TOUCHSTONE_CACHE name a folder that may hold programs."
        ) from error
    for name, arguments in {
        "step_through": (_ADDRESS, _SIZE, _SIZE),
        "integration_restart": (_ADDRESS,),
        "integration_jump": (_ADDRESS,),
        "integration_advance": (_ADDRESS, _ADDRESS, _SIZE, ctypes.c_double, _ADDRESS, _ADDRESS),
    }.items():
        function = getattr(library, name)
        function.argtypes, function.restype = arguments, _SIZE
    return library


def describe(
    instance: Instance,
    needed: Sequence[str],
    *,
    inputs: References,
    outputs: References,
    rates: References | None = None,
    states: int = 0,
    indicators: int = 0,
) -> ctypes.Structure:
    """Return the struct of an FMU for a loop that calls `needed` (names of FMI 2.0).

    The arguments must live as long as the struct.
    """
    is_three = instance.major == 3
    fmu = structure("fmu")(
        component=instance.fmu.component, three=is_three, states=states, indicators=indicators
    )
    for name, group in (("input", inputs), ("output", outputs), ("rate", rates or References([]))):
        setattr(fmu, f"{name}s", group.count)
        setattr(fmu, f"{name}_references", ctypes.addressof(group.array))
    for place, names in enumerate(CALLS):
        if names[0] in needed:
            fmu.call[place] = instance.fmu.address(names[is_three])
    return fmu


def refuse(instance: Instance, fmu: Any) -> NoReturn:
    """Raise FMICallException for the refused call."""
    instance.refuse(CALLS[fmu.fault_call][instance.major == 3], int(fmu.fault_status))


def unsettled(reason: Reason, time: float) -> NoReturn:
    """Raise Fault for an event, at `time` [s], that did not end."""
    raise TerminationRequested(time) if reason is Reason.WANTS_END else endless()


def address_of(array: np.ndarray) -> int:
    """Return the address of an array (n,) or (rows, n) [any unit]. Raises nothing."""
    return array.ctypes.data

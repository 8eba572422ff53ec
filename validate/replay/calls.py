"""The few FMI calls that both kinds of FMU share, on FMPy's low-level classes."""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from validate.replay.package import FmuError, Package


def load_instance(kind: type, package: Package, identifier: str) -> Any:
    """An instance of FMPy's class `kind`. Raises FmuError."""
    try:
        # FMPy goes to the library's folder to load it, and stays there if that fails - in a folder that is about to be removed.
        with contextlib.chdir(os.getcwd()):
            fmu = kind(
                guid=package.description.guid,
                modelIdentifier=identifier,
                unzipDirectory=str(package.folder),
                instanceName=f"replay_{identifier}",
            )
        fmu.instantiate()
    except Exception as error:  # FMPy raises a bare Exception where a binary is missing or does not load
        raise FmuError(f"FMU {package.path}: it cannot be loaded on this machine ({error}).") from error
    return fmu


def close_instance(fmu: Any) -> None:
    """Terminate and free, whatever happened before."""
    from fmpy.fmi1 import FMICallException

    with contextlib.suppress(FMICallException):  # it failed before, and that is what the outcome says
        fmu.terminate()
    fmu.freeInstance()


def set_reals(fmu: Any, references: Sequence[int], values: Sequence[float] | np.ndarray) -> None:
    """Set Real variables, if there are any."""
    if len(references):
        fmu.setReal(list(references), [float(value) for value in values])


def reference_array(references: Sequence[int]) -> Any:
    """Value references for C."""
    return (ctypes.c_uint * len(references))(*references)


def buffer(size: int) -> tuple[Any, np.ndarray]:
    """Doubles for C, and the same memory as an array."""
    memory: Any = (ctypes.c_double * size)()
    return memory, np.frombuffer(memory) if size else np.empty(0)

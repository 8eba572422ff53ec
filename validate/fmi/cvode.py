"""CVODE, the integrator of SUNDIALS 7, in the libraries of scikit-sundae.

    solver = Cvode(ADAMS, y, rates=.., data=.., rtol=1e-9, absolute=.., min_step=0.0, max_step=0.1, max_steps=1000)
    solver.renew(0.0)                                # from y at t = 0 on
    solver.advance(0.5, 1.0, one_step=False)         # to t = 0.5, never beyond 1
    solver.time, solver.y, solver.roots
    solver.close()

The functions are called by ctypes, as scikit-sundae's CVODE(..) calls them: to import scikit-sundae
takes 0.45 s, with SciPy.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import os
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import MachineError

# The major version with these signatures.
_VERSION = 7
_TYPES = {
    "i": ctypes.c_int,
    "l": ctypes.c_long,
    "n": ctypes.c_int64,
    "d": ctypes.c_double,
    "p": ctypes.c_void_p,
}
# Result and arguments of SUNDIALS' functions.
_SIGNATURES = {
    "SUNContext_Create": "i:ip", "SUNContext_ClearErrHandlers": "i:p",
    "SUNContext_GetLogger": "i:pp", "SUNContext_Free": "i:p",
    "SUNLogger_SetWarningFilename": "i:pp", "N_VNew_Serial": "p:np", "N_VGetArrayPointer": "p:p",
    "N_VDestroy": "i:p", "SUNDenseMatrix": "p:nnp", "SUNMatDestroy": "i:p",
    "SUNLinSol_Dense": "p:ppp", "SUNLinSolFree": "i:p", "CVodeCreate": "p:ip",
    "CVodeFree": "i:p", "CVodeInit": "i:ppdp", "CVodeReInit": "i:pdp", "CVodeSVtolerances": "i:pdp",
    "CVodeSetUserData": "i:pp",
    "CVodeSetLinearSolver": "i:ppp", "CVodeSetMaxNonlinIters": "i:pi",
    "CVodeSetMaxConvFails": "i:pi", "CVodeRootInit": "i:pip",
    "CVodeSetRootDirection": "i:pp", "CVodeSetInitStep": "i:pd", "CVodeSetMinStep": "i:pd",
    "CVodeSetMaxStep": "i:pd", "CVodeSetMaxOrd": "i:pi",
    "CVodeSetMaxNumSteps": "i:pl", "CVodeSetStopTime": "i:pd", "CVodeClearStopTime": "i:p",
    "CVode": "i:pdppi", "CVodeGetRootInfo": "i:pp",
}  # fmt: skip
# Adams' method, with the highest order.
ADAMS = (1, 12)
# Backward differentiation formulas, with the highest order.
BDF = (2, 5)

_NONLINEAR_ITERATIONS = 3
_FAILURES = 10
_NORMAL = 1
_ONE_STEP = 2
ROOT_RETURN = 2
# Negative flags of `advance`.
_WHY = {
    -1: "Could not reach endpoint after 'max_num_steps'.",
    -2: "Could not satisfy demanded accuracy for an internal step.",
    -3: "Error tests failed too many times, or reached min step size.",
    -4: "Convergence tests failed too many times, or reached min step size.",
    -5: "Linear solver initialization routine failed.",
    -6: "Linear solver setup function unrecoverably failed.",
    -7: "Linear solver solve function unrecoverably failed.",
    -8: "The right-hand-side function had a non-recoverable error.",
    -9: "The right-hand-side function failed on the first call.",
    -12: "Event-detection routine unrecoverably failed.",
    -22: "One of the function inputs is invalid.",
    -27: "The output and initial times are too close to each other.",
}  # fmt: skip
# CVRhsFn and CVRootFn: time, address of y's vector, address of the result, data.
FILLS = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p
)


def why(flag: int) -> str:
    """Return the sentence of a negative flag of `Cvode.advance`."""
    return _WHY.get(flag, f"CVODE's flag {flag}.")


@lru_cache(maxsize=1)
def functions() -> Any:
    """Load the library, whose functions are its attributes. Raises MachineError."""
    what, found = "the integrator of Model Exchange, CVODE,", importlib.util.find_spec("sksundae")
    folders = map(Path, (found.submodule_search_locations or ()) if found is not None else ())
    path = next(
        (
            path
            for folder in folders
            for path in sorted(folder.glob("_cy_cvode*"))
            if path.suffix in (".so", ".dylib")
        ),
        None,
    )
    if path is None:
        raise MachineError(
            f"{what} is missing: scikit-sundae has no module _cy_cvode here; install scikit-sundae."
        )
    version = [ctypes.c_int() for _ in range(3)]
    label = ctypes.create_string_buffer(32)
    try:
        # A lookup by this handle includes the libraries that the module needs.
        module = ctypes.CDLL(str(path))
        module.SUNDIALSGetVersionNumber(*map(ctypes.byref, version), label, len(label))
        for name, signature in _SIGNATURES.items():
            function, (result, arguments) = getattr(module, name), signature.split(":")
            function.restype, function.argtypes = (
                _TYPES[result],
                [_TYPES[letter] for letter in arguments],
            )
    except (OSError, AttributeError) as error:
        raise MachineError(
            f"{what} cannot be reached in {path} ({error}); install scikit-sundae again."
        ) from error
    if (major := version[0].value) != _VERSION:
        raise MachineError(
            f"{what} is of SUNDIALS {major} in {path}, not {_VERSION}; install another scikit-sundae."
        )
    return module


def address(name: str) -> int:
    """Return the address of a function of SUNDIALS. Raises MachineError."""
    return ctypes.cast(functions()[name], ctypes.c_void_p).value or 0


def array_of(vector: int) -> int:
    """Return the address of the numbers of a vector of SUNDIALS."""
    return functions().N_VGetArrayPointer(vector)


@dataclass(eq=False)
class Cvode:
    """A solver with dense Newton iterations.

    - y: (n,) the state, from which `renew` starts and which `advance` moves [unit of each state].
    - rates, indicators: right-hand side and root functions, FILLS or their addresses.
    - count: number of indicators.
    - data: last argument of both functions.
    - absolute: (n,) tolerances [unit of each state].
    - time: of y [s].
    - roots: (count,) sign of the slope of each indicator at which `advance` stopped, else 0 [-].
    """

    method: tuple[int, int]
    y: np.ndarray
    _: KW_ONLY
    rates: Any
    indicators: Any = 0
    count: int = 0
    data: int = 0
    rtol: float
    absolute: np.ndarray
    min_step: float
    max_step: float
    max_steps: int

    def __post_init__(self) -> None:
        self.time, self.roots = 0.0, np.zeros(self.count, dtype=np.int32)
        self.memory = self.vector = 0  # addresses, 0 without a solver
        given = self.rates, self.indicators, self.data
        self._rates, self._indicators, self._data = (
            ctypes.cast(item, ctypes.c_void_p) for item in given
        )
        self._made = contextlib.ExitStack()  # frees what was made

    def renew(self, time: float) -> None:
        """Make a new solver from y at `time` [s].

        Raises RuntimeError if CVODE refuses an argument.
        """
        self.close()
        self.time = time
        call, context, logger = functions(), ctypes.c_void_p(), ctypes.c_void_p()
        # CVODE refuses systems of size 0; a model without states has one constant number here.
        size = max(1, len(self.y))

        def made(pointer: int | None, free: Callable[[Any], Any]) -> int:
            self._accepted(0 if pointer else -1)
            self._made.callback(free, pointer)
            return pointer or 0

        self._accepted(call.SUNContext_Create(0, ctypes.byref(context)))
        self._made.callback(call.SUNContext_Free, ctypes.byref(context))
        call.SUNContext_ClearErrHandlers(context)
        self._accepted(
            call.SUNContext_GetLogger(context, ctypes.byref(logger)),
            call.SUNLogger_SetWarningFilename(logger, os.devnull.encode()),
        )
        self.vector = made(call.N_VNew_Serial(size, context), call.N_VDestroy)
        tolerances = made(call.N_VNew_Serial(size, context), call.N_VDestroy)
        for vector, values in ((self.vector, self.y), (tolerances, self.absolute)):
            padded = values if len(values) else np.ones(size)
            ctypes.memmove(array_of(vector), padded.ctypes.data, 8 * size)
        matrix = made(call.SUNDenseMatrix(size, size, context), call.SUNMatDestroy)
        linear = made(call.SUNLinSol_Dense(self.vector, matrix, context), call.SUNLinSolFree)
        memory = made(
            call.CVodeCreate(self.method[0], context),
            lambda place: call.CVodeFree(ctypes.byref(ctypes.c_void_p(place))),
        )
        self.memory = memory
        self._accepted(
            call.CVodeSetUserData(memory, self._data),
            call.CVodeInit(memory, self._rates, time, self.vector),
            call.CVodeSVtolerances(memory, self.rtol, tolerances),
            call.CVodeSetLinearSolver(memory, linear, matrix),
            call.CVodeSetMaxNonlinIters(memory, _NONLINEAR_ITERATIONS),
            call.CVodeSetMaxConvFails(memory, _FAILURES),
        )
        if len(self.roots):
            self.roots[:] = 0  # in whichever direction
            self._accepted(call.CVodeRootInit(memory, len(self.roots), self._indicators))
            self._accepted(call.CVodeSetRootDirection(memory, self.roots.ctypes.data))
        self._accepted(
            call.CVodeSetInitStep(memory, 0.0),
            call.CVodeSetMinStep(memory, self.min_step),
            call.CVodeSetMaxStep(memory, self.max_step),
            call.CVodeSetMaxOrd(memory, self.method[1]),
            call.CVodeSetMaxNumSteps(memory, self.max_steps),
        )

    def _accepted(self, *flags: int) -> None:
        if min(flags) < 0:
            raise RuntimeError(f"CVODE refused to be set up at t = {self.time:.6g} s")

    def advance(self, target: float, stop: float, *, one_step: bool) -> int:
        """Integrate to `target` [s], or one step towards it, never beyond `stop` [s].

        Returns CVODE's flag, negative for a failure. Raises RuntimeError for a stop in the past.
        """
        call, time = functions(), ctypes.c_double()
        if call.CVodeSetStopTime(self.memory, stop) < 0:
            raise RuntimeError(f"CVODE refused its stop time at t = {self.time:.6g} s")
        flag = call.CVode(
            self.memory, target, self.vector, ctypes.byref(time), _ONE_STEP if one_step else _NORMAL
        )
        if flag == ROOT_RETURN:
            call.CVodeGetRootInfo(self.memory, self.roots.ctypes.data)
        call.CVodeClearStopTime(self.memory)
        if flag >= 0:
            self.time = time.value
            ctypes.memmove(self.y.ctypes.data, array_of(self.vector), 8 * len(self.y))
        return flag

    def close(self) -> None:
        """Free the memory of CVODE."""
        self._made.close()
        self.memory = self.vector = 0

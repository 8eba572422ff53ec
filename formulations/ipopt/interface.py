"""Ipopt's C interface, reached in the library that the wheel of cyipopt brings.

    nlp = Nlp(problem, functions)
    nlp.set_option("tol", 1e-8)
    status = nlp.solve(x, lagrange, zl, zu)  # the arrays hold the start, then the answer
    nlp.close()

cyipopt itself copies derivatives entry by entry in Python, 40 ns each: 15 % of a solve. Here they are
copied as blocks.

An exception in a callback cannot pass through Ipopt: the first is kept, every later callback refuses,
and `solve` raises it. Ctrl-C may strike before the first line of a callback; then Python hands the
exception to `sys.unraisablehook`, which keeps it too.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import ipopt_wrapper  # pyright: ignore[reportMissingImports] - of cyipopt, without stubs
import numpy as np

from models.errors import MachineError

if TYPE_CHECKING:
    from formulations.ipopt.problem import Evaluations, IpoptProblem

_TYPES = {
    "i": ctypes.c_int,
    "d": ctypes.c_double,
    "b": ctypes.c_bool,
    "p": ctypes.c_void_p,
    "s": ctypes.c_char_p,
}
# Result and arguments.
_SIGNATURES = {
    "CreateIpoptProblem": "p:ippippiiippppp",
    "FreeIpoptProblem": ":p",
    "AddIpoptStrOption": "b:pss",
    "AddIpoptNumOption": "b:psd",
    "AddIpoptIntOption": "b:psi",
    "SetIntermediateCallback": "b:pp",
    "IpoptSolve": "i:pppppppp",
}
# Arguments of Eval_F_CB, Eval_G_CB, Eval_Grad_F_CB, Eval_Jac_G_CB, Eval_H_CB and Intermediate_CB.
_CALLBACKS = (
    "ipbpp",
    "ipbipp",
    "ipbpp",
    "ipbiipppp",
    "ipbdipbipppp",
    "iiddddddddip",
)
_C_INDICES = 0


class UndefinedError(ArithmeticError):
    """A function that is not a finite number at a point: Ipopt then shortens its step."""


@lru_cache(maxsize=1)
def _library() -> Any:
    """The functions of Ipopt. Raises MachineError where the wheel does not show them."""
    try:
        library = ctypes.CDLL(ipopt_wrapper.__file__)
        for name, signature in _SIGNATURES.items():
            result, _, arguments = signature.partition(":")
            function = getattr(library, name)
            function.restype = _TYPES[result] if result else None
            function.argtypes = [_TYPES[letter] for letter in arguments]
    except (OSError, AttributeError) as error:
        raise MachineError(
            f"Ipopt cannot be reached in {ipopt_wrapper.__file__} ({error}); reinstall cyipopt-wheels."
        ) from error
    return library


def _read(address: int, count: int) -> np.ndarray:
    numbers = np.empty(count)
    ctypes.memmove(numbers.ctypes.data, address, numbers.nbytes)
    return numbers


def _write(address: int, values: Any, kind: type = float) -> None:
    array = np.ascontiguousarray(values, dtype=kind)
    ctypes.memmove(address, array.ctypes.data, array.nbytes)


class Nlp:
    """A problem in Ipopt's hands, until `close`."""

    def __init__(self, problem: IpoptProblem, functions: Evaluations) -> None:
        self._library = _library()
        self._error: BaseException | None = None

        def objective(n, x, _new, value, _data):
            _write(value, functions.objective(_read(x, n)))

        def constraints(n, x, _new, _m, values, _data):
            _write(values, functions.constraints(_read(x, n)))

        def gradient(n, x, _new, values, _data):
            _write(values, functions.gradient(_read(x, n)))

        def jacobian(n, x, _new, _m, _count, rows, columns, values, _data):
            if values is None:
                self._write_places(rows, columns, problem.jacobianstructure())
            else:
                _write(values, functions.jacobian(_read(x, n)))

        def hessian(n, x, _new, factor, m, lagrange, _new_l, _count, rows, columns, values, _data):
            if values is None:
                self._write_places(rows, columns, problem.hessianstructure())
            else:
                _write(values, functions.hessian(_read(x, n), _read(lagrange, m), factor))

        def intermediate(*numbers):
            return functions.intermediate(*numbers[:-1])

        called = (objective, constraints, gradient, jacobian, hessian, intermediate)
        self._callbacks = [
            ctypes.CFUNCTYPE(ctypes.c_bool, *(_TYPES[letter] for letter in arguments))(
                self._keeping(function)
            )
            for arguments, function in zip(_CALLBACKS, called, strict=True)
        ]
        bounds = [
            np.ascontiguousarray(side, dtype=float)
            for side in (
                problem.lower,
                problem.upper,
                problem.constraint_lower,
                problem.constraint_upper,
            )
        ]
        lower, upper, constraint_lower, constraint_upper = (side.ctypes.data for side in bounds)
        *evaluations, after = self._callbacks
        self._handle = self._library.CreateIpoptProblem(
            problem.n,
            lower,
            upper,
            problem.m,
            constraint_lower,
            constraint_upper,
            len(problem.jacobianstructure()[0]),
            len(problem.hessianstructure()[0]),
            _C_INDICES,
            *evaluations,
        )
        if not self._handle:
            raise MachineError(f"Ipopt made no problem of {problem.n} variables.")
        self._library.SetIntermediateCallback(self._handle, after)

    @staticmethod
    def _write_places(rows: int, columns: int, places: tuple[np.ndarray, np.ndarray]) -> None:
        _write(rows, places[0], np.int32)
        _write(columns, places[1], np.int32)

    def _keeping(self, function: Callable[..., bool | None]) -> Callable[..., bool]:
        """The function as Ipopt calls it: False where it has no number, and after any exception."""

        def call(*arguments: Any) -> bool:
            if self._error is None:
                try:
                    return function(*arguments) is not False
                except UndefinedError:
                    pass
                except BaseException as error:  # noqa: BLE001 - raised after the solve, KeyboardInterrupt too
                    self._error = error
            return False

        return call

    def set_option(self, name: str, value: str | int | float) -> bool:
        """Set an option; False if Ipopt does not accept the value."""
        kind = {str: "Str", int: "Int", float: "Num"}[type(value)]
        text = value.encode() if isinstance(value, str) else value
        return getattr(self._library, f"AddIpopt{kind}Option")(self._handle, name.encode(), text)

    def solve(self, x: np.ndarray, lagrange: np.ndarray, zl: np.ndarray, zu: np.ndarray) -> int:
        """Run Ipopt from the point and multipliers in these contiguous arrays, which then hold the answer.

        Returns Ipopt's status. Raises what a callback raised, as it was.
        """
        hook = sys.unraisablehook

        def keep(lost: Any) -> None:
            if "ctypes callback" in (lost.err_msg or "") and self._error is None:
                self._error = lost.exc_value
            else:
                hook(lost)

        sys.unraisablehook = keep
        try:
            status = self._library.IpoptSolve(
                self._handle,
                x.ctypes.data,
                None,
                None,
                *(array.ctypes.data for array in (lagrange, zl, zu)),
                None,
            )
        finally:
            sys.unraisablehook = hook
        if self._error is not None:
            raise self._error
        return status

    def close(self) -> None:
        """Give the problem back."""
        self._library.FreeIpoptProblem(self._handle)

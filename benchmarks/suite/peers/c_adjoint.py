"""A forward pass and an adjoint of this one scene, written by hand in C (cart_adjoint.c), with the step on the inputs: the limit of one core."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import Size, Work
from benchmarks.suite.carts import INPUT_WEIGHT, numbers_of, push
from models.codegen.compiler import compile_shared, find_compiler

_SOURCE = Path(__file__).with_name("cart_adjoint.c")
_RATE = 1e-9


def iteration(size: Size, folder: Path) -> Work:
    carts = numbers_of(size)
    library = folder / f"cart_adjoint_{size.n}_{size.steps}_{id(carts)}.so"
    compile_shared(find_compiler(), {_SOURCE.name: _SOURCE.read_text(encoding="utf-8")}, library)
    function = ctypes.CDLL(str(library)).cart_gradient
    function.restype = ctypes.c_double
    function.argtypes = [ctypes.c_int] * 2 + [ctypes.c_double] * 6 + [ctypes.c_void_p] * 6
    u = np.ascontiguousarray(push(size.steps))
    gradient = np.empty_like(u)
    motion = np.empty((2, size.steps + 1, size.n))
    addresses = [
        array.ctypes.data for array in (carts.start, carts.goal, u, motion[0], motion[1], gradient)
    ]
    plain = (
        size.n,
        size.steps,
        carts.step,
        carts.mass,
        carts.damping,
        carts.stiffness,
        carts.length,
        INPUT_WEIGHT,
    )

    def work() -> Mapping[str, Any]:
        loss = function(*plain, *addresses)
        norm = float(np.sqrt(np.vdot(gradient, gradient)))
        np.subtract(u, _RATE * gradient, out=u)
        np.clip(u, -carts.limit, carts.limit, out=u)
        return {
            "iterations": 1,
            "value": norm,
            "outcome": "ok"
            if np.isfinite(loss) and np.isfinite(motion[0, -1, 0])
            else "not a number",
        }

    return work

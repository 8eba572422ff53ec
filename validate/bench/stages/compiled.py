"""What is compiled, with nothing found in a cache: a scene's time step, and its FMU."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from models.codegen.kernel import load_kernel
from models.fmu import build_fmu
from models.scene import Scene
from validate.bench.carts import scene_of
from validate.bench.case import Size, Work, scratch

_OTHER = Size(2, 5)


def scene_compile(size: Size, folder: Path) -> Work:
    """Equations of motion, C code, and the compiler's run."""
    return _afresh(lambda scene: load_kernel(scene).path, size, folder)


def fmu_build(size: Size, folder: Path) -> Work:
    """A whole FMU 2.0: code, description, binary, archive."""
    return _afresh(build_fmu, size, folder)


def _afresh(build: Callable[[Scene], Path], size: Size, folder: Path) -> Work:
    """Another scene first, so that libraries and the compiler itself are in memory."""
    os.environ["TOUCHSTONE_CACHE"] = str(scratch(folder))
    build(scene_of(_OTHER))

    def work() -> Mapping[str, Any]:
        os.environ["TOUCHSTONE_CACHE"] = str(scratch(folder))
        return {"value": float(build(scene_of(size)).stat().st_size)}

    return work

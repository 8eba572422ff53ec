"""Doubles that C and numpy share: what FMI's functions read and write."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np


def buffer(size: int) -> tuple[Any, np.ndarray]:
    """Doubles for C, and the same memory as an array."""
    memory: Any = (ctypes.c_double * size)()
    return memory, np.frombuffer(memory) if size else np.empty(0)


class References:
    """Some variables, read or written at once. values: (n,) the memory that C reads and writes."""

    def __init__(self, references: Sequence[int]) -> None:
        self.count = len(references)
        self.array = (ctypes.c_uint * self.count)(*references)
        self.memory, self.values = buffer(self.count)

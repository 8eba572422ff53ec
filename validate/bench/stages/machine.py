"""A fixed piece of work, measured in every round: how fast this machine is while the others are measured."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from validate.bench.case import Size, Work


def yardstick(size: Size, folder: Path) -> Work:
    """Python objects, a sort, small vectors and matrices: what the stages are made of."""
    matrix = np.random.default_rng(0).normal(size=(60, 60)) + 60.0 * np.eye(60)

    def work() -> Mapping[str, Any]:
        table = {k: float(k % 97) for k in range(20_000)}
        total = sum(sorted(table.values())[::3])
        for _ in range(60):
            total += float(np.linalg.solve(matrix, matrix[0]).sum())
            total += float(np.exp(-np.abs(matrix)).sum())
        return {"value": total}

    return work

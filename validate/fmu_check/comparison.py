"""How far two runs are apart, and which variable shows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from validate.fmu_check.subject import Subject

# Runs that should be equal may differ by this share of a variable's size where an FMU's own integrator starts afresh.
_RESTART = 1e-6


@dataclass(frozen=True)
class Difference:
    """The largest difference, as a share of the variable's size over the run; its variable and row. equal: bit for bit."""

    equal: bool
    share: float
    absolute: float
    name: str
    row: int

    def where(self, subject: Subject, first: int = 0) -> str:
        return f"{self.name} differs by {self.absolute:.2g} at t = {subject.time(first + self.row):.6g} s"


def compare(subject: Subject, one: np.ndarray, other: np.ndarray) -> Difference:
    """Two (rows, observed) arrays of values."""
    rows = min(len(one), len(other))
    if len(one) != len(other):
        return Difference(False, np.inf, np.inf, f"the length of the run ({len(one)} against {len(other)} steps)", rows)
    if np.array_equal(one, other, equal_nan=True):
        return Difference(True, 0.0, 0.0, "", 0)
    names = [item.name for item in subject.observed for _ in range(item.size)]
    scales = np.concatenate([np.full(item.size, item.scale) for item in subject.observed])
    with np.errstate(invalid="ignore"):
        apart = np.where(one == other, 0.0, np.abs(one - other))
    apart = np.where(np.isnan(one) & np.isnan(other), 0.0, np.nan_to_num(apart, nan=np.inf, posinf=np.inf))
    size = np.maximum(np.nan_to_num(np.abs(one), nan=0.0, posinf=0.0).max(axis=0), scales * 1e-6)
    shares = apart / size
    row, column = np.unravel_index(int(np.argmax(shares)), shares.shape)
    return Difference(False, float(shares[row, column]), float(apart[row, column]), names[column], int(row))


def restart_limit(subject: Subject) -> float:
    """Up to this share a continued run may differ from the first one: the FMU's tolerance, at most 1e-6."""
    return min(subject.tolerance, _RESTART)

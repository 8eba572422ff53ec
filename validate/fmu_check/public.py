"""The function `check` of `import touchstone`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from models.arguments import check_positive, check_text, listed
from validate.fmu_check.check import CheckReport
from validate.fmu_check.host import check_fmu


def check(
    fmu: str | Path, *, only: Sequence[str] | None = None, seconds: float = 60.0
) -> CheckReport:
    """Check an FMU's files, and in child processes its behaviour (docs/fmu_check.md).

    Parameters
    ----------
    only
        Names of checks; None for all.
    seconds
        For each check [s].

    Raises
    ------
    FmuError
        For no FMU of version 2.0 or 3.0.
    """
    check_text("fmu", fmu)
    check_positive("seconds", seconds)
    return check_fmu(Path(fmu), names=None if only is None else listed(only), seconds=seconds)

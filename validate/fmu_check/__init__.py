"""Checks of any FMU: its files, and the behaviour of its code.

    report = check_fmu(Path("model.fmu"))
    report.ok, report.failures()

A check is one function with a claim about a sound FMU; host.py lists them. Each check runs in a fork
of an isolated child, with limits of time and memory: an FMU that hangs or crashes fails the check.
"""

from validate.fmu_check.check import CheckReport, FmuCheckRow, Status
from validate.fmu_check.host import CHECK_SECONDS, DECISIVE, check_fmu

__all__ = ["CHECK_SECONDS", "DECISIVE", "CheckReport", "FmuCheckRow", "Status", "check_fmu"]

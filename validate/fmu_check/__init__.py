"""Checks any FMU: what its files say, and how its code behaves.

    report = check_fmu(Path("model.fmu"))
    report.ok, [row for row in report.rows if row.status is Status.FAILED]

Each check is one function that claims something of a sound FMU and finds out; host.py lists them.
They run in forks of an isolated child, each with its time and memory: an FMU that hangs or crashes
has failed a check, and nothing else happens.
"""

from validate.fmu_check.check import CheckReport, FmuCheckRow, Status
from validate.fmu_check.host import CHECK_SECONDS, DECISIVE, check_fmu

__all__ = ["CHECK_SECONDS", "DECISIVE", "CheckReport", "FmuCheckRow", "Status", "check_fmu"]

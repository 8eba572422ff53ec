"""Which process a cell was begun by, seen from its child."""

import psutil


def begun_by() -> int:
    """The number of the process, a campaign or a Dask worker, above the supervisor of this child and what that was forked from."""
    above = (
        parent for parent in psutil.Process().parents() if not any("validate.execution.supervisor" in word for word in parent.cmdline())
    )
    return next(above).pid

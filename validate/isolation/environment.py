"""What every child process is given: one thread for every library, no hash randomisation, temporary files in its own folder."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from validate.reaper import TOKEN_VARIABLE

ROOT = Path(__file__).resolve().parents[2]
# One thread for every library of a child: times compare, sums are added in one order, and -j N uses N cores.
THREADS = 1
PARENT_VARIABLE = "TOUCHSTONE_PARENT"
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


def child_environment(token: str, temporary: Path) -> dict[str, str]:
    """The environment of a child that carries a token. A child of a child carries both, so that whoever ends the outer ends the inner."""
    given = [str(Path(part).resolve()) for part in os.environ.get("PYTHONPATH", "").split(os.pathsep) if part]
    # What the parent can import because it was started with `python -m`, the child can import too.
    here = [os.getcwd()] if {"", os.getcwd()} & set(sys.path) else []
    return {
        **os.environ,
        **dict.fromkeys(_THREAD_VARIABLES, str(THREADS)),
        "PYTHONHASHSEED": "0",
        "PYTHONUNBUFFERED": "1",
        "PYTHONFAULTHANDLER": "1",
        "PYTHONPATH": os.pathsep.join([str(ROOT), *given, *here]),
        "TMPDIR": str(temporary),
        PARENT_VARIABLE: str(os.getpid()),
        TOKEN_VARIABLE: ",".join(filter(None, [os.environ.get(TOKEN_VARIABLE, ""), token])),
    }

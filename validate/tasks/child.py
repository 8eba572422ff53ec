"""Run the task of FOLDER/task.json in a child process, and write FOLDER/record.json.

The record is written last and atomically, so that its presence means success. Imports are inside
`main`, so that the task's profile includes them.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

from models.errors import MachineError
from models.results.stored import from_data, to_json
from validate.processes.disk import disk_error, disk_refuses, write_durably
from validate.processes.isolated import limit_resources
from validate.tasks.profile import Profile

# Exit code after writing MACHINE; only the file counts.
_EXIT_MACHINE = 3
# Larger than any file of a task; stops a runaway log before the disk is full.
_LARGEST_FILE = 2 * 1024**3


def main(folder: Path) -> int:
    """Run the task of a folder; return the exit code."""
    profile = Profile.since_process_start()
    limit_resources(file_bytes=_LARGEST_FILE)
    import random

    import numpy as np

    from models.results.run import ProvenanceRecord
    from validate.store.provenance import SEED
    from validate.store.store import RECORD, REQUEST
    from validate.tasks.check import run_check
    from validate.tasks.path import run_path, survey_run
    from validate.tasks.task import CheckTask, task_from_json

    random.seed(SEED)
    np.random.seed(SEED)
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    try:
        provenance = from_data(ProvenanceRecord, request["provenance"])
        task = task_from_json(request["task"])
        if isinstance(task, CheckTask):
            record = run_check(task, provenance, folder, profile.began)
        else:
            profile.lap("imports")
            record = (
                survey_run(task, folder, profile)
                if task.worlds
                else run_path(task, provenance, folder, profile)
            )
        write_durably(folder / RECORD, to_json(record))
    except MachineError as error:
        return _machine(folder, error)
    except OSError as error:
        if not disk_refuses(error):
            raise
        return _machine(folder, disk_error(folder, error))
    return 0


def _machine(folder: Path, error: Exception) -> int:
    """Write why this machine cannot run the task; the file is incomplete if the disk refuses."""
    from validate.store.store import MACHINE

    with contextlib.suppress(OSError):
        (folder / MACHINE).write_text(f"{error}\n", encoding="utf-8")
    return _EXIT_MACHINE

"""Run one task in a child process (validate.tasks.worker). FOLDER/task.json names the task.

FOLDER/record.json is the answer.

The record is written last and whole, so that its presence alone says that the task came to its end.
What a task needs is imported inside `main`, so that its profile says what that took.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

from models.errors import MachineError
from validate.processes.disk import disk_error, disk_refuses, write_durably
from validate.processes.isolated import limit_resources
from validate.tasks.profile import Profile

# A task that wrote MACHINE ends with this; the file, not the code, is what counts.
_EXIT_MACHINE = 3
# No file of a task comes near this size; a log that runs away stops here instead of at the end of
# the disk.
_LARGEST_FILE = 2 * 1024**3


def main(folder: Path) -> int:
    """Run the task of a folder; the process's exit code."""
    profile = Profile.since_process_start()
    limit_resources(file_bytes=_LARGEST_FILE)
    import random

    import numpy as np

    from reports.records.record import ProvenanceRecord
    from validate.store.provenance import SEED
    from validate.store.store import RECORD, REQUEST
    from validate.tasks.check import run_check
    from validate.tasks.path import run_path, survey_run
    from validate.tasks.task import CheckTask, task_from_json

    random.seed(SEED)
    np.random.seed(SEED)
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    try:
        provenance = ProvenanceRecord.model_validate(request["provenance"])
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
        write_durably(folder / RECORD, record.model_dump_json())
    except MachineError as error:
        return _machine(folder, error)
    except OSError as error:
        if not disk_refuses(error):
            raise
        return _machine(folder, disk_error(folder, error))
    return 0


def _machine(folder: Path, error: Exception) -> int:
    """Say why this machine cannot.

    A disk may refuse even that: whoever reads it sees whether the line is whole.
    """
    from validate.store.store import MACHINE

    with contextlib.suppress(OSError):
        (folder / MACHINE).write_text(f"{error}\n", encoding="utf-8")
    return _EXIT_MACHINE

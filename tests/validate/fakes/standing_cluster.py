"""A Dask scheduler and workers that stand by themselves, as on a cluster, and waiting for what comes."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

# A test that waits in vain has failed; this only ends it.
_LOOKS = 2400
_PAUSE = 0.1


def come(condition: Callable[[], object]) -> None:
    """Wait for something that comes."""
    for _ in range(_LOOKS):
        if condition():
            return
        time.sleep(_PAUSE)
    raise AssertionError("it never came")


@contextmanager
def standing_cluster(
    folder: Path, environment: Mapping[str, str], workers: int
) -> Iterator[tuple[Path, subprocess.Popen[bytes]]]:
    """The scheduler's file and its process; all of it ends with the block."""
    file = folder / "scheduler.json"
    scheduler = [
        "dask_scheduler",
        "--scheduler-file",
        str(file),
        "--port",
        "0",
        "--no-dashboard",
        "--host",
        "127.0.0.1",
    ]
    worker = [
        "dask_worker",
        "--scheduler-file",
        str(file),
        "--nworkers",
        str(workers),
        "--nthreads",
        "1",
        "--memory-limit",
        "0",
    ]
    started: list[subprocess.Popen[bytes]] = []
    try:
        for words in (scheduler, [*worker, "--no-dashboard", "--local-directory", str(folder)]):
            with open(folder / f"{words[0]}.log", "wb") as log:
                command = [sys.executable, "-m", f"distributed.cli.{words[0]}", *words[1:]]
                started.append(
                    subprocess.Popen(
                        command, stdout=log, stderr=log, env=environment, start_new_session=True
                    )
                )
            come(file.exists)
        yield file, started[0]
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()

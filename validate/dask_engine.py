"""The engine that runs cells on the workers of a Dask cluster: one of this machine's processes, or one that stands somewhere.

    with open_dask("", 2, site) as engine: ...                      # two worker processes here, which end with the campaign
    with open_dask("tcp://10.0.0.1:8786", None, site) as engine: ...      # or the path of a scheduler file, FILE.json

A cell whose worker is lost is run again by Dask's scheduler, as often as its `allowed-failures` says (3 times); then it has crashed. The scheduler also
counts against a cell that it only waited on a worker that was lost: one that was begun less often is given to it anew. What is left of a
worker that went without a trace is removed when the campaign ends.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import json
import shutil
import time
import uuid
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.errors import MachineError
from validate.dask_cell import run_on_worker
from validate.dask_cluster import local_cluster, quieten, remote_cluster
from validate.disk import write_durably
from validate.engine import Site
from validate.isolation.process import Watchdog
from validate.store import LOG, PROGRESS, RECORD, REQUEST, Store

if TYPE_CHECKING:
    from reports.examination_record import ExaminationRecord
    from reports.record import RunRecord
    from validate.worker import Job

# Pause between two looks at what is not a cell's end [s]; a cell that ends is seen at once.
_LOOK = 0.5
# How soon it is said that a cluster has no workers, and how long these may take to tidy up [s].
_NO_WORKERS, _TIDY = 5.0, 10.0
# How often a cell is given anew to workers that are lost before they begin it.
_GIVEN_ANEW = 5
_GONE = "the Dask scheduler is gone; what finished is stored, and the same command goes on from there."


@contextmanager
def open_dask(where: str, jobs: int | None, site: Site) -> Iterator[DaskEngine]:
    """The engine of a cluster. where: address or scheduler file, "" for worker processes here; jobs: that many of them, or cells at a time.

    Raises MachineError where there is no cluster.
    """
    quieten()
    token = uuid.uuid4().hex[:16]
    with contextlib.ExitStack() as open_now:
        watchdog = open_now.enter_context(Watchdog())
        mark = site.store.open_partial("campaign", token + uuid.uuid4().hex[:16]).resolve()
        open_now.callback(shutil.rmtree, mark, ignore_errors=True)
        watchdog.tell("start", uuid.uuid4().hex, str(mark))
        client = open_now.enter_context(remote_cluster(where) if where else local_cluster(jobs or 1, watchdog))
        yield DaskEngine(client, site, jobs if where else None, token, mark)


@contextmanager
def _gone_in_words() -> Iterator[None]:
    """What Dask raises where its scheduler cannot be reached, as a MachineError. Raises it."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # no connection, or a client that has given up
        raise MachineError(_GONE) from error


class _Submitted:
    """A cell that Dask has. begun: its unfinished folder, once there is one; name: what its beginnings are counted by; lost: how often Dask gave
    it up."""

    def __init__(self, cell: Job) -> None:
        self.cell, self.since = cell, time.monotonic()
        self.name, self.lost = uuid.uuid4().hex, 0
        self.begun: Path | None = None

    def progress(self) -> str:
        """Where the cell is, in words."""
        try:
            return (self.begun / PROGRESS).read_text(encoding="utf-8") if self.begun else "waiting for a worker"
        except OSError:
            return "its start"


class DaskEngine:
    """See the module docstring. jobs: at most so many cells are given to Dask at a time; token: what the unfinished folders of this
    campaign's cells are known by; mark: the folder by which a worker sees that it has the campaign's folder before it."""

    def __init__(self, client: Any, site: Site, jobs: int | None, token: str, mark: Path) -> None:
        from validate.provenance import fingerprint

        self._client, self._site, self._jobs, self._token = client, site, jobs, token
        self._store = Store(site.store.folder.resolve())
        self._request = {
            "provenance": site.provenance.model_dump(mode="json"),
            "folder": str(self._store.folder),
            "mark": mark.name,
            "token": token,
            "fingerprint": fingerprint(),
        }
        self._said = False

    def run(self, cells: Sequence[Job]) -> Generator[tuple[Job, RunRecord | ExaminationRecord], None, None]:
        waiting = list(cells)
        running: dict[concurrent.futures.Future[dict[str, str]], _Submitted] = {}
        executor = self._client.get_executor(pure=False)
        self._request["cells"] = len(cells) // max(1, self._threads())
        try:
            while waiting or running:
                self._submit(waiting, running, executor)
                self._look(tuple(running.values()))
                done, _ = concurrent.futures.wait(running, timeout=_LOOK, return_when=concurrent.futures.FIRST_COMPLETED)
                for future in done:
                    submitted = running[future]
                    record = self._record(submitted, future)
                    del running[future]
                    if record is None:
                        running[self._give(submitted, executor)] = submitted
                    elif self._site.again(record):
                        waiting.insert(0, submitted.cell)
                    else:
                        yield submitted.cell, record
        finally:
            for future in running:
                future.cancel()
            executor.shutdown(wait=False)
            self._tidy()

    def _submit(self, waiting: list[Job], running: dict[Any, _Submitted], executor: concurrent.futures.Executor) -> None:
        """Give Dask all that may run beside what it has: a cluster grows by what waits for it."""
        at_work = [submitted.cell for submitted in running.values()]
        for cell in tuple(waiting):
            if self._jobs is not None and len(at_work) >= self._jobs:
                return
            if not at_work or not self._site.must_wait(cell, at_work):
                waiting.remove(cell)
                submitted = _Submitted(cell)
                running[self._give(submitted, executor)] = submitted
                at_work.append(cell)

    def _give(self, submitted: _Submitted, executor: concurrent.futures.Executor) -> concurrent.futures.Future[dict[str, str]]:
        request = {**self._request, "cell": submitted.cell.to_json(), "name": submitted.name}
        with _gone_in_words():
            return executor.submit(run_on_worker, request)

    def _threads(self) -> int:
        """How many cells the workers of the cluster can run at a time."""
        with _gone_in_words():
            return sum(self._client.nthreads().values())

    def _look(self, submitted: Sequence[_Submitted]) -> None:
        folders = {path.name.split("-")[1]: path for path in self._unfinished()}
        for item in submitted:
            item.begun = folders.get(item.cell.key[:12])
        self._site.watch([item for item in submitted if item.begun])
        if folders:
            self._said = True
        elif not self._said and any(time.monotonic() - item.since > _NO_WORKERS for item in submitted):
            self._said = True
            if not self._threads():
                self._site.warn(
                    f"the Dask cluster at {self._client.scheduler.address} has no workers yet; {len(submitted)} cells wait for one"
                )

    def _unfinished(self) -> list[Path]:
        """Folders of this campaign's cells that are being written."""
        return [path for path in self._store.runs.glob(f".partial-*-{self._token}*") if path.name != self._request["mark"]]

    def _record(self, submitted: _Submitted, future: concurrent.futures.Future[dict[str, str]]) -> RunRecord | ExaminationRecord | None:
        """What came of a cell; None if it is to be given to Dask anew."""
        from distributed import KilledWorker  # pyright: ignore[reportMissingImports]

        from reports.examination_record import StoredRecord

        try:
            answer = future.result()
        except concurrent.futures.CancelledError as error:
            raise MachineError(_GONE) from error
        except KilledWorker as error:
            begun = len(list((self._store.runs / self._request["mark"]).glob(f"{submitted.name}*")))
            if begun > error.allowed_failures:
                return self._crashed(submitted, f"{begun} workers of the Dask cluster were lost while they ran it.")
            answer = {}
        except Exception as error:  # of any type: what a worker with other packages raises while it reads the cell
            told = (str(error).splitlines() or [""])[0]
            raise MachineError(
                f"a Dask worker could not run {submitted.cell.title} ({type(error).__name__}: {told}); "
                "install the same touchstone-contact where the workers run."
            ) from error
        if "machine" in answer:
            raise MachineError(answer["machine"])
        if "record" in answer:
            return StoredRecord.model_validate_json(answer["record"]).root
        submitted.lost += 1  # before it was begun, or with a worker that took itself for dismissed
        if submitted.lost > _GIVEN_ANEW:
            raise MachineError(f"workers of the Dask cluster are lost before they begin {submitted.cell.title}; their logs say why.")
        return None

    def _crashed(self, submitted: _Submitted, message: str) -> RunRecord | ExaminationRecord:
        """The record of a cell that took its workers with it, stored."""
        from validate.worker import Lost

        cell = submitted.cell
        wall = time.monotonic() - submitted.since
        record = self._site.lost(cell)(Lost(outcome="crashed", message=message, wall=wall, cpu=0.0, log=""))
        folder = self._store.open_partial(cell.key, self._token + uuid.uuid4().hex[:16])
        write_durably(folder / REQUEST, json.dumps({"cell": cell.to_json(), "provenance": self._request["provenance"]}, indent=1))
        write_durably(folder / LOG, "")
        write_durably(folder / RECORD, record.model_dump_json(indent=1))
        self._store.commit(folder, record.key)
        return record

    def _tidy(self) -> None:
        """Wait until workers have left nothing of what was stopped, then remove what those left that are gone."""
        until = time.monotonic() + _TIDY
        while self._unfinished() and time.monotonic() < until:
            time.sleep(0.05)
        for folder in self._unfinished():
            shutil.rmtree(folder, ignore_errors=True)

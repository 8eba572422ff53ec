"""A cell on a worker of a Dask cluster: the same child process, watched by the thread of the Dask task, into the folder of the campaign.

    answer = run_on_worker(request)     # {"record": JSON}, {"machine": sentence}, or {} if the campaign wanted it no longer

The folder is reached by its path: campaign and workers share a file system. A worker that sees another folder there, or that has other sources,
libraries or another compiler than the campaign, says so and runs nothing, since a record is filed under a key that all of them decide.
"""

from __future__ import annotations

import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.errors import MachineError
from validate.disk import disk_error
from validate.store import Store

if TYPE_CHECKING:
    from reports.examination_record import ExaminationRecord
    from reports.record import ProvenanceRecord, RunRecord
    from validate.fork_server import ForkServer
    from validate.worker import Job, Lost

# How often a child is looked at [s], as on the campaign's own machine.
_LOOK = 0.05
# How long a folder that another machine has just made may be invisible: file systems over a network remember for so long what was not there [s].
_PATIENCE = 5.0
_OF_THREAD = threading.local()


def job_from_json(data: Mapping[str, Any]) -> Job:
    """The cell or the examination of a request."""
    from validate.cell import Cell
    from validate.examination import Examination

    return Examination.from_json(data) if "examination" in data else Cell.from_json(data)


def run_on_worker(request: Mapping[str, Any]) -> dict[str, str]:
    """Run one cell to its end. request: cell and provenance (JSON), folder, its mark, the campaign's token, fingerprint of its sources,
    cells: how many will come to one thread, which may be worth a fork server, name: by which the campaign counts how often the cell was begun."""
    from reports.record import ProvenanceRecord
    from validate.isolation.process import shared_watchdog
    from validate.worker import Worker

    wanted = _wanted()
    try:
        _check(request)
        _begin(request)
        job, provenance = job_from_json(request["cell"]), _here(ProvenanceRecord.model_validate(request["provenance"]))
        store, server = Store(Path(request["folder"])), _server(request["cells"])
        worker = Worker(job, _lost(job, provenance), provenance, store, shared_watchdog(), server, token_begins=request["token"])
        try:
            while wanted():
                time.sleep(_LOOK)
                record = worker.poll()
                if record is not None:
                    return {"record": record.model_dump_json()}
        except BaseException:
            worker.stop()
            raise
        worker.stop()
    except MachineError as error:
        return {"machine": f"{error} (said by {_name()})"}
    return {}


def _server(cells: int) -> ForkServer | None:
    """The process that forks the cells of this thread, with which it ends; None where there can be none."""
    from validate.fork_server import WORTH, ForkServer, ForkServerError, modules_for

    if cells < WORTH:
        return None
    if not hasattr(_OF_THREAD, "server"):
        try:
            _OF_THREAD.server = ForkServer(modules_for(cells))
        except ForkServerError:
            _OF_THREAD.server = None
    return _OF_THREAD.server


def _name() -> str:
    return f"the Dask worker on {socket.gethostname()}, process {os.getpid()}"


def _wanted() -> Callable[[], bool]:
    """Whether somebody still waits for this task: Dask cannot stop a running one, it only marks it."""
    from distributed import Status, get_worker  # pyright: ignore[reportMissingImports]

    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        ends = worker.status in {Status.closing, Status.closed, Status.failed}  # its scheduler is gone, or has dismissed it
        return not ends and task is not None and task.state in {"executing", "long-running", "resumed"}

    return wanted


def _check(request: Mapping[str, Any]) -> None:
    """That the campaign's folder and sources are what they are where the campaign is. Raises MachineError."""
    from validate.provenance import fingerprint

    runs, until = Store(Path(request["folder"])).runs, time.monotonic() + _PATIENCE
    while not (runs / request["mark"]).is_dir():
        if time.monotonic() > until:
            raise MachineError(
                f"the campaign's folder {request['folder']} is not seen here: a campaign and its Dask workers need a file system that they "
                "share; choose with --out a folder that lies at the same path on all of them."
            )
        time.sleep(_LOOK)
    if fingerprint() != request["fingerprint"]:
        raise MachineError(
            "the sources, libraries or compiler here are not those of the campaign, so that its records would lie; start the workers anew, from "
            "the same environment as the campaign."
        )


def _begin(request: Mapping[str, Any]) -> None:
    """Leave a sign that the cell was begun once more. Raises MachineError."""
    sign = Store(Path(request["folder"])).runs / request["mark"] / f"{request['name']}-{uuid.uuid4().hex}"
    try:
        sign.touch()
    except OSError as error:
        raise disk_error(Path(request["folder"]), error) from error


def _here(provenance: ProvenanceRecord) -> ProvenanceRecord:
    """The campaign's provenance with the machine that this is."""
    from validate.provenance import machine

    return provenance.model_copy(update=machine())


def _lost(job: Job, provenance: ProvenanceRecord) -> Callable[[Lost], RunRecord | ExaminationRecord]:
    """Makes the record of a child that left none."""
    from validate.cell import Cell
    from validate.examination import Examination, lost_examination

    def record(lost: Lost) -> RunRecord | ExaminationRecord:
        if isinstance(job, Examination):
            return lost_examination(job, provenance, lost)
        assert isinstance(job, Cell)
        return _lost_cell(job, provenance, lost)

    return record


def _lost_cell(cell: Any, provenance: ProvenanceRecord, lost: Lost) -> RunRecord:
    from models.catalog import load_scene
    from validate.records import lost_run, planned_stages
    from validate.scene_record import scene_record
    from validate.tools import load_tools
    from validate.variant import varied

    tools, scene = load_tools(cell.tools), load_scene(cell.scene)
    if cell.variant is not None:
        scene = varied(scene, cell.variant)
    plan = planned_stages(cell.pipeline, {leg.method: tools.load_method(leg.method) for leg in cell.pipeline.legs})
    return lost_run(cell, scene_record(scene), plan, provenance, lost)

"""A cell that ends during a certificate keeps what it had: plans, replays, scores, and the certificates that were finished."""

import contextlib
import os
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from killed_campaigns import FAKES_FOLDER
from wording import unsaid

from models.results.run import RunRecord
from models.results.stored import from_json
from validate.campaign.engine import MODULES
from validate.campaign.results import rows
from validate.processes.disk import PARTIAL
from validate.processes.process import Preloaded
from validate.store.provenance import gather
from validate.store.store import Store, progress_in
from validate.tasks import worker as module
from validate.tasks.leg import planned_legs, planned_stages
from validate.tasks.task import RunTask
from validate.tasks.worker import Worker

pytestmark = pytest.mark.process


@pytest.fixture
def in_reach(monkeypatch):
    """The fakes can be imported, here and by a child."""
    monkeypatch.syspath_prepend(str(FAKES_FOLDER))
    monkeypatch.setenv(
        "PYTHONPATH",
        os.pathsep.join(filter(None, [str(FAKES_FOLDER), os.environ.get("PYTHONPATH", "")])),
    )


def _task(last: str) -> RunTask:
    from certificate_fakes import PLUGIN, pipeline

    chosen = pipeline(last)
    plan = planned_stages(chosen, PLUGIN.methods_of(chosen))
    return RunTask(
        key=f"key_of_{last}", scene="three_cart", scene_name="three_cart", pipeline=chosen,
        plugin="certificate_fakes:PLUGIN",
        time_limit=1e5,
        legs=planned_legs(plan, lambda stages: "-".join(planned.name for planned in stages)),
    )  # fmt: skip


def _run(
    last: str, folder: Path, preloaded: Preloaded | None, monkeypatch: pytest.MonkeyPatch
) -> tuple[RunRecord, Path]:
    """The record of a run whose time is up once its last certificate has begun, and its folder in the store."""
    task, store = _task(last), Store(folder)
    store.prepare()
    worker, late = (
        Worker(task, gather("a test"), store, preloaded=preloaded),
        time.monotonic() + 2 * task.time_limit,
    )

    def look() -> bool:
        (partial,) = store.runs.glob(f"{PARTIAL}*")
        if progress_in(partial) == "the certificate of stage 3 (endless)":
            monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: late))
        return True

    record = worker.run(wanted=look)
    assert isinstance(record, RunRecord)
    assert from_json(RunRecord, (store.runs / task.key / "record.json").read_bytes()) == record
    return record, store.runs / task.key


@pytest.mark.slow
@pytest.mark.parametrize(("last", "outcome", "why"), [
    ("endless", "solved",
     "certificate is missing … limit of 100000 s, during … stage 3 (endless)."),
    ("crashing", "crashed",
     "certificate is missing: … signal 11 (SIGSEGV) during … stage 3 (crashing)."),
])  # fmt: skip
def test_nothing_but_the_certificate_is_lost(last, outcome, why, in_reach, tmp_path, monkeypatch):
    with (
        contextlib.closing(Preloaded(MODULES))
        if last == "endless"
        else contextlib.nullcontext() as preloaded
    ):
        record, folder = _run(last, tmp_path, preloaded, monkeypatch)
    soft, quick, late = record.stages
    assert (record.outcome, record.message, record.verdict) == (outcome, late.message, "holds")
    assert not unsaid(late.message, why)
    assert [stage.outcome for stage in record.stages] == ["solved"] * 3
    assert [stage.certificate is not None for stage in record.stages] == [False, True, False]
    assert (soft.message, quick.message) == ("", "")
    for stage in record.stages:
        assert stage.has_plan
        assert stage.replay is not None
        assert [figure.name for figure in stage.metrics] == [
            "terminal_error",
            "physics",
            "replay_error",
        ]
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "record.json",
        "task.json",
        "log.txt",
        "files.json",
        "trajectory.nc",
        "trajectory_1.nc",
        "trajectory_2.nc",
    }
    assert sum(record.profile.values()) == pytest.approx(record.wall_seconds)
    assert record.profile["certificate"] > 0.0
    told = rows([record])
    assert [row["verdict"] for row in told] == ["holds"] * 3
    assert told[-1]["cost"] == record.stages[-1].cost is not None

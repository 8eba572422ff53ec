"""A campaign's folder with spoilt files, and what goes on from one: resume, `plan`, --lf, `compare`, shared stages; and other small JSON files."""

import hashlib
import json
import random
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from hostile_mutations import spoilt_json
from hostile_records import KEY, good_record, spoilt_campaign

from models.errors import TouchstoneError
from reports.records.load import ReportError

_PLAN = b"no plan, and not read: no stage says that it has one"


def _each(*reads: Callable[[], object]) -> None:
    """All are tried. Raises the last refusal where there was one."""
    refused: list[Exception] = []
    for read in reads:
        try:
            read()
        except (TouchstoneError, ReportError) as error:
            refused.append(error)
    if refused:
        raise refused[-1]


def spoilt_folder(rng: random.Random, folder: Path) -> Path:
    """As spoilt_campaign; what is stored ended in different ways, so that it is asked how long it was allowed to run."""
    path = spoilt_campaign(rng, folder)
    run = path / "runs" / KEY
    if rng.random() < 0.5:
        (run / "record.json").write_text(
            json.dumps({**good_record(), "outcome": rng.choice(["time_limit", "crashed", "failed"]), "verdict": "no plan"})
        )
    request = {"task": {"key": KEY, "scene_name": "s", "pipeline": {"name": "p", "part": []}, "time_limit": 5.0}}
    (run / "task.json").write_bytes(spoilt_json(rng, request))
    (run / "files.json").write_bytes(spoilt_json(rng, {"trajectory_0.nc": 10}))
    return path


@cache
def _entry() -> Any:
    from formulations.method import Leg, Pipeline
    from models.catalog import load_scene
    from validate.plan.runs import PlannedRun
    from validate.tasks.path import LoadedRun
    from validate.tasks.task import RunTask

    pipeline = Pipeline(name="p", title="p", legs=(Leg(method="m"),))
    task = RunTask(key=KEY, scene="three_cart", scene_name="s", pipeline=pipeline, plugin="", time_limit=9.0)
    return PlannedRun(task, LoadedRun(scene=load_scene("three_cart"), plan=()))


def resume(path: Path) -> None:
    from reports.records.load import load
    from validate.cli.compare import compare
    from validate.execution.campaign import time_steps
    from validate.plan.runs import CampaignSettings, only_last_failed, reasons, with_stored
    from validate.store.store import Store
    from validate.store.stored import campaign_text, earlier_schema

    store, settings = Store(path), CampaignSettings(out=path)
    store.prepare()
    found = with_stored([_entry()], store, settings)
    reasons(found, store)
    store.damaged_file(KEY)
    earlier_schema(path)
    time_steps((), path)
    campaign_text(path)
    good = path.with_name("good")
    if not good.exists():
        spare = spoilt_campaign(_Unspoilt(), path.with_name("spare"))
        shutil.move(spare, good)
    _each(lambda: only_last_failed(found, store), lambda: compare(load(good), load(path)), lambda: compare(load(path), load(good)))


class _Unspoilt(random.Random):
    """Decides against every mutation."""

    def random(self) -> float:
        return 1.0


def spoilt_stored_leg(rng: random.Random, folder: Path) -> Path:
    """A stored leg, what it says spoilt."""
    stage = good_record()["stages"][0]
    content = {
        "key": KEY, "pipeline": "p", "limit": None, "profile": {}, "stages": [{**stage, "has_plan": False}],
        "files": {"trajectory_1.nc": hashlib.sha256(_PLAN).hexdigest()},
    }  # fmt: skip
    source = folder / "legs" / KEY
    source.mkdir(parents=True, exist_ok=True)
    (source / "trajectory_1.nc").write_bytes(_PLAN)
    (source / "leg.json").write_bytes(spoilt_json(rng, content))
    return folder


def take_leg(path: Path) -> None:
    from validate.tasks.leg import take

    run = path / "run"
    run.mkdir(exist_ok=True)
    taken = take(path / "legs", KEY, 1.0, 1, run / "leg_1", _entry().scene)
    shutil.rmtree(run)
    if taken is None:
        raise TouchstoneError("it is put aside")


def spoilt_scheduler(rng: random.Random, folder: Path) -> Path:
    path = folder / "scheduler.json"
    path.write_bytes(spoilt_json(rng, {"type": "Scheduler", "id": "x", "address": "tcp://127.0.0.1:9", "services": {}, "workers": {}}))
    return path


def read_scheduler(path: Path) -> None:
    from validate.execution.engine import check_engine

    check_engine(f"dask:{path}")


@cache
def _suite() -> dict[str, Any]:
    row = {
        "stage": "solve", "title": "t", "by": "touchstone", "n": 3, "steps": 100, "cpu_s": [1.0, 1.1, 1.2, 1.0, 1.1],
        "memory_mib": [9.0] * 5,
    }  # fmt: skip
    rows = [
        row,
        {**row, "by": "peer"},
        {**row, "stage": "yardstick"},
        {**row, "stage": "build", "cpu_s": [], "memory_mib": [], "failed": "f"},
    ]
    provenance = good_record()["provenance"]
    return {"kind": "suite", "rows": rows, "figures": [], "repeats": 5, "load": [0.5, 0.5], "provenance": provenance}


def spoilt_suite(rng: random.Random, folder: Path) -> Path:
    path = folder / "suite.json"
    path.write_bytes(spoilt_json(rng, _suite()))
    return path


def compare_suite(path: Path) -> None:
    """Both ways, since a campaign's own figures are read by its report."""
    import click

    from benchmarks.records import SuiteRecord
    from benchmarks.suite.command import read_suite
    from benchmarks.suite.compare import compare

    good = SuiteRecord.model_validate(_suite())
    try:
        earlier = read_suite(path)
    except click.UsageError as error:
        raise TouchstoneError(error.message) from error
    compare(earlier, good)
    compare(good, earlier)

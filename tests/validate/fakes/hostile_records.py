"""A campaign's folder with spoilt records and files, and all that reads one: load, results, `report`, `show`, resume, --dry-run, --lf, shared stages; spoilt results of a planner, a compiler, a cell, an isolated call; and what reads them."""

import gzip
import hashlib
import json
import random
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hostile_mutations import spoilt_bytes, spoilt_json, spoilt_text

from models.errors import TouchstoneError
from models.results.verdict import Question

KEY = "a" * 64


def good_record() -> dict[str, Any]:
    """As little of a record as the schema allows."""
    provenance = dict.fromkeys(
        ("touchstone", "commit", "python", "platform", "cpu", "compiler", "started", "command"), "x"
    )
    provenance |= {"cores": 1, "threads": 1, "packages": {}, "seed": 0}
    scene = {
        name: []
        for name in (
            "coordinates",
            "velocities",
            "inputs",
            "contacts",
            "parameters",
            "start",
            "goal",
        )
    }
    metric = {
        "name": "physics",
        "value": 1.0,
        "unit": "N^2",
        "meaning": "m",
        "question": Question.FORCES.value,
        "error": 0.1,
        "limit": 2.0,
        "ok": True,
    }
    stage = {
        "index": 0, "method": "m", "method_title": "", "kind": "direct", "eps": 0.5,
        "outcome": "solved", "advice": "", "metrics": [metric],
        "questions": [{"number": 3, "text": "t", "answer": "yes"}], "not_asked": ["n"],
    }  # fmt: skip
    return {
        "key": KEY,
        "scene": {"name": "s", "title": "", "source": "", "step": 0.01, "steps": 2, **scene},
        "pipeline": "p", "pipeline_title": "",
        "stages": [{**stage, "options": {"a": 1}, "cost": 2.0, "verdict": "holds"}],
        "outcome": "solved", "must_hold": True, "wall_seconds": 1.0,
        "cpu_seconds": 1.0, "provenance": provenance, "log_tail": "l",
    }  # fmt: skip


def spoilt_campaign(rng: random.Random, folder: Path) -> Path:
    run = folder / "campaign" / "runs" / KEY
    run.mkdir(parents=True, exist_ok=True)
    record = good_record()
    campaign = {
        "title": "t",
        "command": "c",
        "started": "",
        "keys": [KEY],
        "provenance": record["provenance"],
    }
    for path, data in (
        (run / "record.json", record),
        (folder / "campaign" / "campaign.json", campaign),
        (run / "task.json", {"task": {"key": KEY}}),
    ):
        path.write_bytes(
            spoilt_json(rng, data) if rng.random() < 0.6 else json.dumps(data).encode()
        )
    return folder / "campaign"


def read_record(path: Path) -> None:
    import contextlib
    import os

    from reports.load import load
    from validate.campaign.results import tables
    from validate.campaign.stored import campaign_of
    from validate.cli.show import command
    from validate.store.store import Store

    load(path)
    list(Store(path).requests())
    store = Store(path)
    records = [record for key in campaign_of(path).keys if (record := store.read(key)) is not None]
    tables([record for record in records if hasattr(record, "stages")], (), ())
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        for record in records:
            command.main([record.key, "--in", str(path)], standalone_mode=False)


# ---- somebody's plan
#   --------------------------------------------------------------------------------------------------------------------------
def spoilt_table(rng: random.Random, folder: Path) -> Path:
    mark = rng.choice([",", ";", "\t"])
    rows = [
        ["t", "x", "v_x", "F"],
        *([f"{0.1 * row:.1f}", "0", "1e-3", "" if row == 5 else "1"] for row in range(6)),
    ]
    path = folder / "foreign.csv"
    path.write_bytes(spoilt_text(rng, "# a plan\n" + "\n".join(mark.join(row) for row in rows)))
    return path


def read_table(path: Path) -> None:
    from models.plan_table import PlanTable

    table = PlanTable(path)
    for name in {"t", "x", "v_x", "F"} & set(table.names):
        table.column(name, last_is_open=name == "F")


# ---- what a child left
#   ------------------------------------------------------------------------------------------------------------------------
def spoilt_leg(rng: random.Random, folder: Path) -> Path:
    """What a run that was lost left of its first leg."""
    content = {
        "key": KEY, "pipeline": "p", "limit": None, "profile": {"solve": 1.0}, "files": {},
        "stages": [{**good_record()["stages"][0], "has_plan": False}],
    }  # fmt: skip
    (folder / "leg_1").mkdir(exist_ok=True)
    (folder / "leg_1" / "leg.json.gz").write_bytes(gzip.compress(spoilt_json(rng, content)))
    return folder


def recover(path: Path) -> None:
    from validate.tasks.leg import PlannedLeg, legs_in

    if not legs_in(path, [PlannedLeg(0, 1, KEY, KEY)]):
        raise TouchstoneError("there is none")


def spoilt_answer(rng: random.Random, folder: Path) -> Path:
    """What an isolated call left: foreign code runs in the same process, and may write there, too."""
    from validate.processes.isolated import ANSWER, TAKEN

    np.savez(folder / TAKEN, allow_pickle=False, t=np.arange(3.0), q=np.zeros((3, 2)))
    if rng.random() < 0.5:
        (folder / TAKEN).write_bytes(spoilt_bytes(rng, (folder / TAKEN).read_bytes()))
    told = {
        "ending": rng.choice(["OK", "ERROR", "MACHINE", "EXCEPTION"]),
        "value": {"a": 1},
        "sentence": "a sentence",
    }
    (folder / ANSWER).write_bytes(
        json.dumps(told).encode() if rng.random() < 0.3 else spoilt_json(rng, told)
    )
    return folder


def read_answer(path: Path) -> None:
    from validate.processes.isolated import left_by

    answer, arrays = left_by(path)
    if (
        not answer
        or not {"value", "sentence"} <= answer.keys()
        or any(not isinstance(array, np.ndarray) for array in arrays.values())
    ):
        raise TouchstoneError("it left no result")


_PLAN = b"no plan, and not read: no stage says that it has one"


def spoilt_folder(rng: random.Random, folder: Path) -> Path:
    """As spoilt_campaign.

    What is stored ended in different ways, so that it is asked how long it was allowed to run.
    """
    path = spoilt_campaign(rng, folder)
    run = path / "runs" / KEY
    if rng.random() < 0.5:
        (run / "record.json").write_text(
            json.dumps(
                {
                    **good_record(),
                    "outcome": rng.choice(["time_limit", "crashed", "failed"]),
                    "verdict": "no plan",
                }
            )
        )
    request = {
        "task": {
            "key": KEY,
            "scene_name": "s",
            "pipeline": {"name": "p"},
            "time_limit": 5.0,
        }
    }
    (run / "task.json").write_bytes(spoilt_json(rng, request))
    (run / "files.json").write_bytes(spoilt_json(rng, {"trajectory_0.nc": 10}))
    return path


@cache
def _entry() -> Any:
    from formulations.method import Leg, Pipeline
    from models.catalog import load_scene
    from validate.campaign.runs import PlannedTask
    from validate.tasks.path import LoadedRun
    from validate.tasks.task import RunTask

    pipeline = Pipeline(name="p", title="p", legs=(Leg(method="m"),))
    task = RunTask(
        key=KEY, scene="three_cart", scene_name="s", pipeline=pipeline, plugin="", time_limit=9.0
    )
    return PlannedTask(task, LoadedRun(scene=load_scene("three_cart"), plan=()))


def resume(path: Path) -> None:
    from validate.campaign.runs import CampaignSettings, only_last_failed, reasons, with_stored
    from validate.campaign.stored import found_campaign
    from validate.store.store import Store

    store, settings = Store(path), CampaignSettings(out=path)
    store.prepare()
    found = with_stored([_entry()], store, settings)
    reasons(found, store)
    store.damaged_file(KEY)
    found_campaign(path)
    only_last_failed(found, store)


def spoilt_stored_leg(rng: random.Random, folder: Path) -> Path:
    """A stored leg, what it says spoilt."""
    stage = good_record()["stages"][0]
    content = {
        "key": KEY, "pipeline": "p", "limit": None, "profile": {},
        "stages": [{**stage, "has_plan": False}],
        "files": {"trajectory_1.nc": hashlib.sha256(_PLAN).hexdigest()},
    }  # fmt: skip
    source = folder / "legs" / KEY
    source.mkdir(parents=True, exist_ok=True)
    (source / "trajectory_1.nc").write_bytes(_PLAN)
    (source / "leg.json.gz").write_bytes(gzip.compress(spoilt_json(rng, content)))
    return folder


def take_leg(path: Path) -> None:
    from validate.tasks.leg import take

    run = path / "run"
    run.mkdir(exist_ok=True)
    taken = take(path / "legs", KEY, 1.0, 1, run / "leg_1", _entry().loaded.scene)
    shutil.rmtree(run)
    if taken is None:
        raise TouchstoneError("it is put aside")


def spoilt_scheduler(rng: random.Random, folder: Path) -> Path:
    path = folder / "scheduler.json"
    path.write_bytes(
        spoilt_json(
            rng,
            {
                "type": "Scheduler",
                "id": "x",
                "address": "tcp://127.0.0.1:9",
                "services": {},
                "workers": {},
            },
        )
    )
    return path


def read_scheduler(path: Path) -> None:
    from validate.campaign.engine import check_engine

    check_engine(f"dask:{path}")

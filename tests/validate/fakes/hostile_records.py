"""A campaign's folder with spoilt records, and all that reads one: load, results, `report` and `show`."""

import json
import random
from pathlib import Path
from typing import Any

from hostile_mutations import spoilt_json

KEY = "a" * 64


def good_record() -> dict[str, Any]:
    """As little of a record as the schema allows."""
    provenance = dict.fromkeys(("touchstone", "commit", "python", "platform", "cpu", "compiler", "started", "command"), "x")
    provenance |= {"cores": 1, "threads": 1, "packages": {}, "seed": 0}
    scene = {name: [] for name in ("coordinates", "velocities", "inputs", "contacts", "parameters", "start", "goal")}
    metric = {"name": "physics", "value": 1.0, "unit": "N^2", "meaning": "m", "question": 3, "error": 0.1, "limit": 2.0, "ok": True}
    stage = {
        "index": 0, "method": "m", "method_title": "", "kind": "direct", "eps": 0.5, "outcome": "solved", "advice": "", "metrics": [metric],
        "questions": [{"number": 3, "text": "t", "answer": "yes"}], "not_asked": ["n"],
    }  # fmt: skip
    return {
        "key": KEY, "scene": {"name": "s", "title": "", "source": "", "step": 0.01, "steps": 2, **scene}, "pipeline": "p", "pipeline_title": "",
        "stages": [{**stage, "options": {"a": 1}, "cost": 2.0, "verdict": "holds"}], "outcome": "solved", "must_hold": True, "wall_seconds": 1.0,
        "cpu_seconds": 1.0, "provenance": provenance, "log_tail": "l",
    }  # fmt: skip


def spoilt_campaign(rng: random.Random, folder: Path) -> Path:
    run = folder / "campaign" / "runs" / KEY
    run.mkdir(parents=True, exist_ok=True)
    record = good_record()
    campaign = {"title": "t", "command": "c", "started": "", "keys": [KEY], "provenance": record["provenance"]}
    for path, data in (
        (run / "record.json", record),
        (folder / "campaign" / "campaign.json", campaign),
        (run / "task.json", {"task": {"key": KEY}}),
    ):
        path.write_bytes(spoilt_json(rng, data) if rng.random() < 0.6 else json.dumps(data).encode())
    return folder / "campaign"


def read_record(path: Path) -> None:
    import contextlib
    import os

    from reports.records.load import load
    from validate.cli.show import command
    from validate.store.results import tables
    from validate.store.store import Store
    from validate.store.stored import stored_campaign

    load(path)
    list(Store(path).requests())
    campaign, records = stored_campaign(path)
    del campaign
    tables([record for record in records if hasattr(record, "stages")], (), ())
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        for record in records:
            command.main([record.key, "--in", str(path)], standalone_mode=False)

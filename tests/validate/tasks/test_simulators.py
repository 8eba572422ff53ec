"""Other simulators asked of the plans of a campaign: the plan that was stored, on the scene it was made for; rows kept from call to call."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from wording import unsaid

from reports.records.engines_record import SIMULATORS
from reports.records.load import Stored, load
from reports.records.record import RunRecord
from validate.store.stored import CampaignError
from validate.tasks.simulators import ask_simulators, stored_plan

pytestmark = pytest.mark.slow

CAMPAIGN = """
pipelines = ["short"]

[pipeline.short]
title = "An exact plan from one relaxed one"

[[pipeline.short.legs]]
method = "softplus_dc"
eps = [0.01]

[[pipeline.short.legs]]
method = "strict_lcp"

[[scenes]]
scene = "three_cart"
parameters = { m = 1.25 }
steps = 250
"""


@pytest.fixture(scope="module")
def ran(cli, tmp_path_factory) -> Path:
    """A campaign of one run, on a scene whose number of steps and whose mass are changed."""
    base = tmp_path_factory.mktemp("varied")
    (base / "campaign.toml").write_text(CAMPAIGN)
    done = cli("run", str(base / "campaign.toml"), "--no-robust", "--out", str(base / "out"))
    assert done.returncode == 0, done.stderr
    return base / "out"


def _record(folder: Path) -> RunRecord:
    return load(folder).runs[0]


def test_a_stored_plan_comes_with_the_scene_as_its_campaign_changed_it(ran: Path):
    scene, plan = stored_plan(ran, _record(ran))
    values = {item.name: item.value for item in scene.parameters}
    assert (values["m"], scene.task.steps, plan.steps) == (1.25, 250, 250)
    assert scene.name == _record(ran).scene.name
    assert np.isfinite(plan.u).all()


def test_a_run_without_a_plan_has_none(ran: Path):
    record = _record(ran)
    with pytest.raises(CampaignError, match=r"left no plan"):
        stored_plan(ran, record.model_copy(update={"stages": ()}))


def test_engines_are_asked_of_it_and_earlier_ones_keep_their_rows(ran: Path, cli):
    key = _record(ran).key
    first = cli("report", str(ran), "--engine", "fmu_everyday")
    assert first.returncode == 0, first.stderr
    told = json.loads((ran / SIMULATORS).read_bytes())
    assert list(told["plans"]) == [key]
    (everyday,) = told["plans"][key]
    assert (everyday["engine"], everyday["verdict"], everyday["agrees"]) == (
        "fmu_everyday",
        "holds",
        True,
    )
    assert max(level["distance"] for level in everyday["levels"]) < 1e-3
    assert "fmu_everyday: holds" in first.stderr
    assert "simulators.html" in (ran / "report.html").read_text(encoding="utf-8")
    page = (ran / "pages" / "simulators.html").read_text(encoding="utf-8")
    assert "fmu_everyday gives our verdict on 1 of 1 plan" in page
    second = cli("report", str(ran), "--engine", "fmu")
    assert second.returncode == 0, second.stderr
    assert [row["engine"] for row in json.loads((ran / SIMULATORS).read_bytes())["plans"][key]] == [
        "fmu_everyday",
        "fmu",
    ]
    again = cli("report", str(ran))
    assert again.returncode == 0
    assert (ran / "pages" / "simulators.html").read_text(encoding="utf-8").count(
        '<th scope="col">fmu'
    ) == 2


def test_an_unknown_engine_is_one_sentence(ran: Path, cli):
    before = (ran / "results.csv").read_bytes()
    done = cli("report", str(ran), "--engine", "mujocco")
    assert done.returncode == 2
    assert "mujocco" in done.stderr
    assert "Traceback" not in done.stderr
    assert (ran / "results.csv").read_bytes() == before


def test_a_plan_that_is_gone_is_told_and_the_report_is_written(ran: Path, cli):
    key = _record(ran).key
    files = sorted((ran / "runs" / key).glob("trajectory*.nc"))
    kept = {path: path.read_bytes() for path in files}
    for path in files:
        path.unlink()
    done = cli("report", str(ran), "--engine", "fmu_everyday")
    for path, content in kept.items():
        path.write_bytes(content)
    assert done.returncode == 0
    assert "no simulator was asked" in done.stderr
    assert "Traceback" not in done.stderr


def test_where_no_plan_holds_that_is_said(tmp_path: Path):
    said: list[str] = []
    found = ask_simulators(tmp_path, Stored(None, ()), ("fmu",), said.append)
    assert (found.plans, len(said)) == ({}, 1)
    assert not unsaid(said[0], "no plan … holds … no simulator was asked")

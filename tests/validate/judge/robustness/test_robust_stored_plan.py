"""`robust` on a run of a campaign: the stored plan, on the scene it was made for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from models.results.run import RunRecord
from reports.load import load
from validate.campaign.stored import CampaignError
from validate.cli.robust import stored_plan

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
    done = cli("run", str(base / "campaign.toml"), "--no-worlds", "--out", str(base / "out"))
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
        stored_plan(ran, replace(record, stages=()))

"""A step past its stability limit is told before anything runs, stored with the campaign and shown in the report."""

import json

import numpy as np
import pytest

from models.catalog import load_scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid, write_csv
from validate.campaign import campaign
from validate.campaign.campaign import time_steps
from validate.campaign.stored import campaign_of

UNSTABLE = """from models.catalog import load_scene
from dataclasses import replace
SCENE = replace(load_scene("two_body_collision"), name="stiff_pair", limits=(), answers=()).with_parameters(k=4e6)
"""


def test_a_stable_step_is_stored_without_a_warning(tmp_path):
    (found,) = time_steps([load_scene("three_cart")])
    assert found.sentence == ""
    assert found.radius <= 1.0 + 1e-6
    assert found.largest_step > 0.01


@pytest.mark.slow
def test_a_step_past_the_limit_is_told_before_the_cells_stored_shown_and_used_again(
    cli, tmp_path, monkeypatch
):
    path = tmp_path / "stiff_pair.py"
    path.write_text(UNSTABLE)
    done = cli(
        "all", "--scene", str(path), "-k", "free_motion and stiff", "--out", str(tmp_path / "out")
    )
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    warned = next(
        index
        for index, line in enumerate(lines)
        if line.startswith("warning: scene stiff_pair: with pair closed")
    )
    finished = [index for index, line in enumerate(lines) if line.startswith("[1/")]
    assert "take a step below 0.000866 s" in lines[warned]
    assert not finished or warned < finished[0]
    stored = json.loads((tmp_path / "out" / "campaign.json").read_text())
    (step,) = stored["time_steps"]
    assert step["radius"] > 1.0
    assert "past the stability limit" in (tmp_path / "out" / "report.html").read_text(
        encoding="utf-8"
    )
    monkeypatch.setattr(
        campaign, "step_stability", lambda scene: None
    )  # asked again, it would fail
    (found,) = time_steps([load_scene(str(path))], campaign_of(tmp_path / "out").time_steps)
    assert found.sentence


@pytest.mark.slow
@pytest.mark.parametrize("as_json", [(), ("--json",)])
def test_a_dry_run_tells_it_too(dry_run, tmp_path, as_json):
    path = tmp_path / "stiff_pair.py"
    path.write_text(UNSTABLE)
    words = ("-k", "free_motion and stiff", "--scene", str(path), *as_json)
    done = dry_run(*words, "--out", str(tmp_path / "out"))
    assert done.returncode == 0
    assert "warning: scene stiff_pair: with pair closed" in done.stderr
    assert "take a step below 0.000866 s" in done.stderr


@pytest.mark.slow
def test_a_plan_on_a_step_too_long_is_told_before_its_score(cli, tmp_path):
    """The same scene and plan on its own step and on one of 0.2 s."""
    scene, said = load_scene("three_cart"), {}
    for step in (scene.task.step, 0.2):
        coarse = scene.with_task(step=step, steps=5)
        q = np.tile(np.array(scene.task.start[:3]), (6, 1))
        none = np.zeros((5, 2))
        plan = Trajectory(
            t=uniform_grid(step, 5),
            q=q,
            v=0.0 * q,
            u=none,
            lam=none,
            scheme=Scheme.SEMI_IMPLICIT_EULER,
        )
        write_csv(tmp_path / "plan.csv", plan, coarse)
        said[step] = cli("replay", str(tmp_path / "plan.csv"), "--scene", "three_cart").stderr
    assert "past the stability limit" not in said[scene.task.step]
    assert "past the stability limit" in said[0.2]

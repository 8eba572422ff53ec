"""`python -m benchmarks verdict-matrix`: a plan that is kept is used, the page is equal twice, and each disagreement stands there with its class."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.verdict_matrix import PIPELINES, as_markdown, command
from formulations.pipelines import pipeline_names
from models.catalog import load_scene
from models.trajectory import Trajectory, uniform_grid
from models.trajectory_netcdf import write_netcdf
from validate.judge.disagreement import Otherwise
from validate.judge.elsewhere import EngineVerdict
from validate.judge.simulator import Came


def test_at_least_ten_scenes_three_of_them_with_friction():
    assert len(PIPELINES) >= 10
    assert sum(bool(load_scene(name).frictions) for name in PIPELINES) >= 3
    assert set(PIPELINES.values()) <= set(pipeline_names())


def test_a_disagreement_is_bold_and_told_below():
    rows = [
        EngineVerdict(
            engine="fmu_everyday", came=Came.DONE, agrees=True, sentence="1e-9 from ours"
        ),
        EngineVerdict(
            engine="mujoco",
            came=Came.DONE,
            agrees=False,
            kind=Otherwise.FRICTION,
            sentence="it creeps | and creeps",
        ),
        EngineVerdict(engine="drake_sap", came=Came.CANNOT, sentence="contact rim: no such thing"),
    ]
    page = as_markdown(
        [row.engine for row in rows], {"transport": ("relaxed+strict", "holds", rows)}
    )
    assert (
        "| transport | relaxed+strict | holds | done | **done**: friction regularisation | cannot express it |"
        in page
    )
    assert "| transport | mujoco | friction regularisation | it creeps / and creeps |" in page
    assert "| transport | drake_sap |  | contact rim: no such thing |" in page
    assert "1e-9 from ours" not in page


@pytest.mark.slow
@pytest.mark.process
def test_the_page_is_made_from_plans_that_are_kept_and_is_equal_twice(tmp_path: Path):
    scene = load_scene("wall_pendulum")
    nq, steps = scene.nq, scene.task.steps
    plan = Trajectory(
        t=uniform_grid(scene.task.step, steps), q=np.zeros((steps + 1, nq)),
        v=np.zeros((steps + 1, nq)), u=np.full((steps, scene.nu), 0.1),
        lam=np.zeros((steps, scene.nl)),
    )  # fmt: skip
    write_netcdf(tmp_path / "wall_pendulum.nc", plan, scene)
    pages = []
    for name in ("one.md", "other.md"):
        arguments = [
            "--scene",
            "wall_pendulum",
            "--engine",
            "fmu,fmu_everyday",
            "--plans",
            str(tmp_path),
            "--markdown",
            str(tmp_path / name),
        ]
        done = CliRunner().invoke(command, arguments, standalone_mode=False)
        assert done.exception is None, done.output
        pages.append((tmp_path / name).read_text(encoding="utf-8"))
    assert pages[0] == pages[1]
    assert "| wall_pendulum | mpcc | violates | violates |" in pages[0]

"""Scenes, plans and solutions as the report reads them."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene
from models.netcdf import read_columns
from models.scene.text import scene_text
from models.trajectory import Trajectory, uniform_grid
from models.trajectory_netcdf import write_netcdf
from validate.execution.process import ROOT
from validate.store import provenance
from validate.store.provenance import content_key, source_digests

SCENE = load_scene("three_cart")
OSCILLATOR = Path(__file__).parents[2] / "scenes" / "oscillator.py"


def _plan(steps: int = 500) -> Trajectory:
    q = np.tile([2.0, 2.6, 3.0], (steps + 1, 1))  # gaps 0.1 and -0.1
    q[:, 0] += np.linspace(0.0, 0.05, steps + 1)
    return Trajectory(t=uniform_grid(0.01, steps), q=q, v=np.zeros_like(q), u=np.ones((steps, 2)), lam=np.full((steps, 2), 2.0))


def test_files_of_plans_have_gaps_and_poses(tmp_path):
    write_netcdf(tmp_path / "trajectory.nc", _plan(), SCENE)
    columns, _ = read_columns(tmp_path / "trajectory.nc")
    assert columns["gap_left"].values[0] == pytest.approx(0.1)
    assert columns["gap_left"].values[-1] == pytest.approx(0.05)
    assert columns["gap_right"].values[0] == pytest.approx(-0.1)
    assert [columns[f"pose_{part}_1"].values[-1] for part in ("x", "y", "angle")] == pytest.approx([2.05, 0.25, 0.0])
    assert (columns["pose_x_2"].description, columns["pose_angle_2"].unit) == ("x of middle", "rad")


def test_a_key_is_content():
    stages = [("strict_lcp", None, {"a": "1"})]
    key = content_key(SCENE, stages, ["strict_lcp"])
    assert key == content_key(load_scene("three_cart"), [list(stages[0])], ["strict_lcp"])
    others = [
        content_key(SCENE.with_parameters(k=31.0), stages, ["strict_lcp"]), content_key(SCENE.with_task(steps=499), stages, ["strict_lcp"]),
        content_key(SCENE, [("strict_lcp", None, {"a": "2"})], ["strict_lcp"]), content_key(SCENE, stages, ["strict_lcp"], "another judge"),
    ]  # fmt: skip
    assert len({key, *others}) == 5


def test_a_scene_text_sees_assumptions_and_every_field():
    contact = SCENE.contacts[0]
    weaker = replace(contact, penetration=sp.Symbol("d") - sp.Symbol("q2"))
    stronger = replace(contact, penetration=sp.Symbol("d", positive=True) - sp.Symbol("q2"))
    assert scene_text(weaker) != scene_text(stronger)
    assert "replay_terminal_velocity_error" in scene_text(SCENE)


def _imported_reports(name: str) -> set[str]:
    """Modules of the room of reports that a file of ours imports when it runs."""
    tree = ast.parse((ROOT / name).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = [ast.Pass()]
    found = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    return {f"{module.replace('.', '/')}.py" for module in found if module.startswith("reports.")}


@pytest.mark.slow
def test_whatever_writes_records_is_part_of_their_keys():
    """Of the files that count, each imports of the room of reports only what counts too, or what tells of records that are written already."""
    counted = provenance._source_digests()
    # the last is of a page of one plan, which no run stores
    telling = {"reports/records/load.py", "reports/render.py", "reports/records/robustness_record.py"}
    imported = {name: _imported_reports(name) for name in counted if name.endswith(".py")}
    assert "reports/records/record.py" in imported["validate/tasks/records.py"]
    assert {name: missing for name, modules in imported.items() if (missing := modules - set(counted) - telling)} == {}
    # a cell's record holds columns of numbers and the paper's figures
    assert {"reports/records/record.py", "reports/paper.py"} <= set(source_digests(["strict_lcp"]))
    assert "reports/records/check_record.py" not in source_digests(["strict_lcp"])


def test_the_file_of_a_scene_without_contacts_or_inputs_has_its_motion_alone(tmp_path):
    scene = load_scene(str(OSCILLATOR))
    assert (scene.nc, scene.nu) == (0, 0)
    nodes = 4
    q = np.linspace(0.0, 0.3, nodes)[:, None]
    write_netcdf(
        tmp_path / "trajectory.nc", Trajectory(t=uniform_grid(0.1, 3), q=q, v=0 * q, u=np.zeros((3, 0)), lam=np.zeros((3, 0))), scene
    )
    columns, _ = read_columns(tmp_path / "trajectory.nc")
    moving = {name for name in columns if not name.startswith("pose_")}
    assert moving == {"t", scene.coordinates[0].name, scene.coordinates[0].velocity_name}
    assert columns[scene.coordinates[0].name].values == pytest.approx(q[:, 0])

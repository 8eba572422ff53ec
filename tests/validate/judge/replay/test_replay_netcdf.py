"""Plans and replays in NetCDF files: bit for bit, and one sentence for a file that is stale, foreign or garbled."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5netcdf
import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import MachineError, TrajectoryError
from models.fmu import build_fmu
from models.netcdf import Column, read_columns
from models.scene import Scene
from models.trajectory import Hold, Trajectory, uniform_grid
from models.trajectory_netcdf import read_netcdf, write_netcdf
from validate.judge.replay import Replay
from validate.judge.replay.netcdf import storable, write_replay
from validate.judge.replay.run import replay

STEPS = 40


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_cart").with_task(steps=STEPS, start=(2.0, 2.45, 3.0, 0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def plan(scene: Scene) -> Trajectory:
    u = np.random.default_rng(7).normal(size=(STEPS, 2)) / 3
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, 0.01)
    return Trajectory(t=uniform_grid(0.01, STEPS), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, hold=Hold.LINEAR)


@pytest.fixture(scope="module")
def replayed(scene: Scene, plan: Trajectory) -> Replay:
    return replay(scene, build_fmu(load_scene("three_cart")), plan)


def edited(path: Path, change: Callable[[h5netcdf.File], None]) -> Path:
    with h5netcdf.File(path, "a") as file:
        change(file)
    return path


def test_a_plan_reads_back_bit_for_bit(tmp_path: Path, scene: Scene, plan: Trajectory):
    path = tmp_path / "trajectory.nc"
    write_netcdf(path, plan, scene)
    back = read_netcdf(path, scene)
    for field in ("t", "q", "v", "u", "lam"):
        assert getattr(back, field).tobytes() == getattr(plan, field).tobytes()
    assert back.hold is Hold.LINEAR
    with h5netcdf.File(path, "r") as file:
        units = {name: variable.attrs["units"] for name, variable in file.variables.items()}
    assert units == {
        **{"t": "s", "q1": "m", "q2": "m", "q3": "m", "v1": "m/s", "v2": "m/s", "v3": "m/s"},
        **{"u1": "N", "u3": "N", "lam_left": "N", "lam_right": "N", "gap_left": "m", "gap_right": "m"},
        **{f"pose_{part}_{place}": unit for place in (1, 2, 3) for part, unit in (("x", "m"), ("y", "m"), ("angle", "rad"))},
    }
    assert [item.name for item in tmp_path.iterdir()] == ["trajectory.nc"]  # no temporary file is left


def test_the_same_plan_is_the_same_file(tmp_path: Path, scene: Scene, plan: Trajectory):
    first, second = tmp_path / "a.nc", tmp_path / "b.nc"
    write_netcdf(first, plan, scene)
    write_netcdf(second, plan, scene)
    assert first.read_bytes() == second.read_bytes()


def test_a_replay_is_written_bit_for_bit(tmp_path: Path, scene: Scene, replayed: Replay):
    path = tmp_path / "replay.nc"
    write_replay(path, replayed, scene)
    columns, attributes = read_columns(path)
    arrays = {"t": replayed.t, "knots": replayed.knots}
    arrays |= {
        name: getattr(replayed, name) for name in ("kinetic_energy", "potential_energy", "contact_energy", "input_work", "dissipated_work")
    }
    for group, names in {"q": "q1 q2 q3", "v": "v1 v2 v3", "lam": "lam_left lam_right", "gap": "gap_left gap_right"}.items():
        arrays |= dict(zip(names.split(), getattr(replayed, group).T, strict=True))
    assert replayed.contact_impulse is not None
    arrays |= dict(zip(("impulse_left", "impulse_right"), replayed.contact_impulse.T, strict=True))
    for name, array in arrays.items():
        assert columns[name].values.dtype == array.dtype
        assert columns[name].values.tobytes() == array.tobytes()
    assert columns.keys() - arrays.keys() == {f"pose_{part}_{place}" for place in (1, 2, 3) for part in ("x", "y", "angle")}
    facts = json.loads(str(attributes["facts"]))
    assert replayed.events
    assert facts["events"] == [[event.time, event.contact, event.closes] for event in replayed.events]
    assert (facts["outcome"], facts["error"]) == ("OK", replayed.error.as_json())
    assert (attributes["scene"], attributes["fmu_sha256"]) == ("three_cart", replayed.fmu)


def test_a_replay_without_work_is_written_without(tmp_path: Path, scene: Scene, replayed: Replay):
    path = tmp_path / "replay.nc"
    write_replay(path, replace(replayed, input_work=None, dissipated_work=None, contact_impulse=None), scene)
    assert not {"input_work", "dissipated_work", "impulse_left", "impulse_right"} & read_columns(path)[0].keys()


@pytest.mark.parametrize("content", [b"", b"no netcdf at all", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_a_garbled_file_is_named(tmp_path: Path, scene: Scene, content: bytes):
    path = tmp_path / "garbled.nc"
    path.write_bytes(content)
    with pytest.raises(TrajectoryError, match=r"garbled\.nc: it cannot be read as NetCDF-4"):
        read_netcdf(path, scene)


def test_a_file_cut_short_is_named(tmp_path: Path, scene: Scene, plan: Trajectory):
    path = tmp_path / "cut.nc"
    write_netcdf(path, plan, scene)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(TrajectoryError, match=r"cut\.nc"):
        read_netcdf(path, scene)


def test_a_missing_file_is_named(tmp_path: Path, scene: Scene):
    with pytest.raises(TrajectoryError, match="there is no such file"):
        read_netcdf(tmp_path / "absent.nc", scene)


def test_a_file_of_another_kind_or_scene_is_refused(tmp_path: Path, scene: Scene, plan: Trajectory, replayed: Replay):
    plan_file, replay_file = tmp_path / "plan.nc", tmp_path / "replay.nc"
    write_netcdf(plan_file, plan, scene)
    write_replay(replay_file, replayed, scene)
    with pytest.raises(TrajectoryError, match="not a plan"):
        read_netcdf(replay_file, scene)
    other = load_scene("bouncing_mass")
    with pytest.raises(TrajectoryError, match="plan of scene 'three_cart', not of 'bouncing_mass'"):
        read_netcdf(plan_file, other)


def _no_column(file: h5netcdf.File) -> None:
    file._h5group.__delitem__("u3")


def _other_unit(file: h5netcdf.File) -> None:
    file.variables["q1"].attrs["units"] = "mm"


def _no_number(file: h5netcdf.File) -> None:
    file.variables["q2"][3] = np.nan


def _other_hold(file: h5netcdf.File) -> None:
    file.attrs["hold"] = "cubic"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (_no_column, "the column 'u3' is missing"),
        (_other_unit, "q1 is in 'mm', but 'm' is expected"),
        (_no_number, r"q\[3, 1\] is nan.*stale\.nc"),
        (_other_hold, "hold is 'cubic'"),
    ],
)
def test_a_stale_plan_is_refused_by_name(
    tmp_path: Path, scene: Scene, plan: Trajectory, change: Callable[[h5netcdf.File], None], sentence: str
):
    path = tmp_path / "stale.nc"
    write_netcdf(path, plan, scene)
    with pytest.raises(TrajectoryError, match=sentence):
        read_netcdf(edited(path, change), scene)


def test_a_folder_that_is_not_there_is_a_matter_of_the_machine(tmp_path: Path, scene: Scene, plan: Trajectory):
    with pytest.raises(MachineError, match="cannot be written"):
        write_netcdf(tmp_path / "absent" / "plan.nc", plan, scene)


def test_a_plan_of_other_size_is_not_written(tmp_path: Path, scene: Scene, plan: Trajectory):
    small = Trajectory(t=plan.t, q=plan.q[:, :2], v=plan.v[:, :2], u=plan.u, lam=plan.lam)
    with pytest.raises(TrajectoryError, match="q has 2 columns"):
        write_netcdf(tmp_path / "plan.nc", small, scene)
    assert list(tmp_path.iterdir()) == []


def test_names_that_netcdf_does_not_allow_are_changed_and_said():
    given = [("a_b", ""), ("a/b", "gap"), ("a\x00b", "force"), ("time", "of another"), (" ", "")]
    found = storable([Column(name=name, dimension="time", values=np.zeros(1), unit="m", description=text) for name, text in given])
    assert [(item.name, item.description) for item in found] == [
        ("a_b", ""),
        ("a_b_2", "a/b: gap"),
        ("a_b_3", "a\x00b: force"),
        ("time_2", "time: of another"),
        ("_", ""),
    ]
    assert {(item.dimension, item.unit) for item in found} == {("time", "m")}

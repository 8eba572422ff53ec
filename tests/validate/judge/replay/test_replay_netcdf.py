"""Plans and replays in NetCDF files: bit for bit, and one sentence for a file that is stale, foreign or garbled."""

import json
from dataclasses import replace
from pathlib import Path

import h5netcdf
import h5py
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
from validate.judge.replay import Difference, Replay, ReplayError, ReplayOutcome
from validate.judge.replay.netcdf import storable, write_drawn, write_replay
from validate.judge.replay.result import Event, Growth
from validate.judge.replay.run import replay
from validate.judge.replay.subject import (
    ForeignContact,
    ForeignCoordinate,
    ForeignInput,
    ForeignModel,
    ForeignTask,
)
from validate.judge.replay.wiring import Effort

STEPS = 40


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_cart").with_task(steps=STEPS, start=(2.0, 2.45, 3.0, 0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def plan(scene: Scene) -> Trajectory:
    u = np.random.default_rng(7).normal(size=(STEPS, 2)) / 3
    rollout = load_kernel(scene).rollout(np.array(scene.task.start), u, 0.01)
    return Trajectory(
        t=uniform_grid(0.01, STEPS),
        q=rollout.q,
        v=rollout.v,
        u=u,
        lam=rollout.lam,
        hold=Hold.LINEAR,
    )


@pytest.fixture(scope="module")
def replayed(scene: Scene, plan: Trajectory) -> Replay:
    return replay(scene, build_fmu(load_scene("three_cart")), plan)


def test_a_plan_reads_back_bit_for_bit(tmp_path: Path, scene: Scene, plan: Trajectory):
    path = tmp_path / "trajectory.nc"
    write_netcdf(path, plan, scene)
    back = read_netcdf(path, scene)
    for field in ("t", "q", "v", "u", "lam"):
        assert getattr(back, field).tobytes() == getattr(plan, field).tobytes()
    assert back.hold is Hold.LINEAR
    with h5netcdf.File(path, "r", phony_dims="sort") as file:  # a reader that is not ours
        units = {name: variable.attrs["units"] for name, variable in file.variables.items()}
    units = {
        name: value if isinstance(value, str) else value.decode() for name, value in units.items()
    }
    assert units == {
        **{"t": "s", "q1": "m", "q2": "m", "q3": "m", "v1": "m/s", "v2": "m/s", "v3": "m/s"},
        **{
            "u1": "N",
            "u3": "N",
            "lam_left": "N",
            "lam_right": "N",
            "gap_left": "m",
            "gap_right": "m",
        },
    }
    assert [item.name for item in tmp_path.iterdir()] == [
        "trajectory.nc"
    ]  # no temporary file is left


def test_the_same_plan_is_the_same_file(tmp_path: Path, scene: Scene, plan: Trajectory):
    first, second = tmp_path / "a.nc", tmp_path / "b.nc"
    write_netcdf(first, plan, scene)
    write_netcdf(second, plan, scene)
    assert first.read_bytes() == second.read_bytes()


def test_a_replay_is_written_bit_for_bit(
    tmp_path: Path, scene: Scene, plan: Trajectory, replayed: Replay
):
    path = tmp_path / "replay.nc"
    write_replay(path, replayed, scene, plan)
    columns, attributes = read_columns(path)
    arrays = {"t": replayed.t, "knots": replayed.knots}
    arrays |= {
        name: getattr(replayed, name)
        for name in (
            "kinetic_energy",
            "potential_energy",
            "contact_energy",
            "input_work",
            "dissipated_work",
        )
    }
    for group, names in {
        "q": "q1 q2 q3",
        "v": "v1 v2 v3",
        "lam": "lam_left lam_right",
        "gap": "gap_left gap_right",
    }.items():
        arrays |= dict(zip(names.split(), getattr(replayed, group).T, strict=True))
    arrays |= dict(zip(("impulse_left", "impulse_right"), replayed.contact_impulse.T, strict=True))
    for name, array in arrays.items():
        assert columns[name].values.dtype == array.dtype
        assert columns[name].values.tobytes() == array.tobytes()
    assert columns.keys() - arrays.keys() == {"position_error"}
    away = np.abs(replayed.q[replayed.knots] - plan.q).max(axis=1)
    assert columns["position_error"].values == pytest.approx(away, rel=4e-6)
    facts = json.loads(str(attributes["facts"]))
    assert replayed.events
    assert facts["events"] == [
        [event.time, event.contact, event.closes] for event in replayed.events
    ]
    assert (facts["outcome"], facts["error"]) == ("OK", replayed.error.as_json())
    assert (attributes["scene"], attributes["fmu_sha256"]) == ("three_cart", replayed.fmu)


def test_a_drawn_replay_keeps_nodes_events_and_extremes(
    tmp_path: Path, scene: Scene, plan: Trajectory, replayed: Replay
):
    """Fewer rows than the replay has nodes: the largest force and the events are there all the same."""
    peak = int(np.argmax(replayed.lam[:, 0]))
    write_drawn(tmp_path / "whole.nc", replayed, scene, plan, len(replayed.t))
    write_drawn(tmp_path / "few.nc", replayed, scene, plan, 5)
    whole, _ = read_columns(tmp_path / "whole.nc")
    few, _ = read_columns(tmp_path / "few.nc")
    assert whole["t"].values.tobytes() == replayed.t.tobytes()
    assert whole["q2"].values == pytest.approx(replayed.q[:, 1], rel=4e-6)
    assert whole.keys() == few.keys()
    assert whole.keys().isdisjoint({"v1", "kinetic_energy", "impulse_left"})
    assert few["t"].values[few["knots"].values] == pytest.approx(plan.t)
    assert len(few["t"].values) < len(replayed.t)
    assert {replayed.t[peak], *(event.time for event in replayed.events)} <= {*few["t"].values}
    assert few["lam_left"].values.max() == whole["lam_left"].values.max() > 0.0
    assert few["position_error"].values.tobytes() == whole["position_error"].values.tobytes()


@pytest.mark.parametrize("content", [b"", b"no netcdf at all", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_a_garbled_file_is_named(tmp_path: Path, scene: Scene, content: bytes):
    path = tmp_path / "garbled.nc"
    path.write_bytes(content)
    with pytest.raises(TrajectoryError, match=r"garbled\.nc: it cannot be read as NetCDF-4"):
        read_netcdf(path, scene)


def test_a_missing_file_is_named(tmp_path: Path, scene: Scene):
    with pytest.raises(TrajectoryError, match="there is no such file"):
        read_netcdf(tmp_path / "absent.nc", scene)


def test_a_file_of_another_kind_or_scene_is_refused(
    tmp_path: Path, scene: Scene, plan: Trajectory, replayed: Replay
):
    plan_file, replay_file = tmp_path / "plan.nc", tmp_path / "replay.nc"
    write_netcdf(plan_file, plan, scene)
    write_replay(replay_file, replayed, scene, plan)
    with pytest.raises(TrajectoryError, match="not a plan"):
        read_netcdf(replay_file, scene)
    other = load_scene("bouncing_mass")
    with pytest.raises(TrajectoryError, match="plan of scene 'three_cart', not of 'bouncing_mass'"):
        read_netcdf(plan_file, other)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda file: file.__delitem__("u3"), "the column 'u3' is missing"),
        (lambda file: file["q1"].attrs.update(units="mm"),
         "q1 is in 'mm', but 'm' is expected"),
        (lambda file: file["q2"].__setitem__(3, np.nan), r"q\[3, 1\] is nan.*stale\.nc"),
        (lambda file: file.attrs.update(hold="cubic"), "hold is 'cubic'"),
    ],
)  # fmt: skip
def test_a_stale_plan_is_refused_by_name(tmp_path, scene, plan, change, sentence):
    path = tmp_path / "stale.nc"
    write_netcdf(path, plan, scene)
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(TrajectoryError, match=sentence):
        read_netcdf(path, scene)


def test_a_folder_that_is_not_there_is_a_matter_of_the_machine(
    tmp_path: Path, scene: Scene, plan: Trajectory
):
    with pytest.raises(MachineError, match="cannot be written"):
        write_netcdf(tmp_path / "absent" / "plan.nc", plan, scene)


def test_a_plan_of_other_size_is_not_written(tmp_path: Path, scene: Scene, plan: Trajectory):
    small = Trajectory(t=plan.t, q=plan.q[:, :2], v=plan.v[:, :2], u=plan.u, lam=plan.lam)
    with pytest.raises(TrajectoryError, match="q has 2 columns"):
        write_netcdf(tmp_path / "plan.nc", small, scene)
    assert list(tmp_path.iterdir()) == []


def test_names_that_netcdf_does_not_allow_are_changed_and_said():
    given = [("a_b", ""), ("a/b", "gap"), ("a\x00b", "force"), ("time", "of another"), (" ", "")]
    found = storable(
        [
            Column(name=name, dimension="time", values=np.zeros(1), unit="m", description=text)
            for name, text in given
        ]
    )
    assert [(item.name, item.description) for item in found] == [
        ("a_b", ""), ("a_b_2", "a/b: gap"), ("a_b_3", "a\x00b: force"),
        ("time_2", "time: of another"), ("_", ""),
    ]  # fmt: skip
    assert {(item.dimension, item.unit) for item in found} == {("time", "m")}


def test_each_column_of_somebodys_replay_is_its_own(tmp_path: Path):
    """Two of each, every number different: names, units, what they are, and numbers beside arrays."""
    q, v, lam, gap, impulse = (np.arange(6.0).reshape(3, 2) + 10.0 * place for place in range(5))
    energies = {
        name: np.arange(3.0) + 100.0 * place
        for place, name in enumerate(
            (
                "kinetic_energy",
                "potential_energy",
                "contact_energy",
                "input_work",
                "dissipated_work",
            ),
            1,
        )
    }
    model = ForeignModel(
        name="cart", task=ForeignTask(goal=(), step=0.1),
        coordinates=(ForeignCoordinate(name="x", velocity_name="vx", unit="m", velocity_unit="m/s",
                                       description="place"),
                                       ForeignCoordinate(name="a", velocity_name="w", unit="rad",
                                           velocity_unit="rad/s")),
        inputs=(ForeignInput(name="F", unit="N"), ForeignInput(name="M", unit="N m")),
        contacts=(ForeignContact(name="stop", force_name="push", gap_name="room",
                                 description="a spring"),
                                 ForeignContact(name="wall", force_name="lam_wall",
                                                gap_name="gap_wall")),
    )  # fmt: skip
    given = Replay(
        scene="cart", outcome=ReplayOutcome.OK, message="a note", method="everyday",
        t=np.array([0.0, 0.5, 1.0]), q=q, v=v, lam=lam, gap=gap,
        friction=np.zeros((3, 0)), knots=np.array([0, 2]), contact_impulse=impulse, **energies,
        events=(Event(time=0.5, contact="stop", closes=True),),
        event_budget=77,
        error=ReplayError(estimate=Difference(position=1.0, state=2.0, gap=np.inf)),
        seconds_reference=3.0, seconds_everyday=4.0, fmu="sha",
        growth=Growth(amplification=5.0, begin=6.0, end=7.0, duration=8.0),
        applied=np.array([[51.0, 52.0]]),
        effort=Effort(rms=(1.0,), peak=(2.0,), rms_share=3.0, peak_share=4.0, plan_share=5.0,
                      saturated=6.0),
    )  # fmt: skip
    plan = Trajectory(
        t=np.array([0.0, 1.0]), q=np.array([[0.5, 1.0], [3.0, 7.0]]), v=v[::2],
        u=np.zeros((1, 2)), lam=np.zeros((1, 2)),
    )  # fmt: skip
    write_replay(tmp_path / "replay.nc", given, model, plan)
    columns, attributes = read_columns(tmp_path / "replay.nc")
    expected = {
        "t": (given.t, "s", "time"), "x": (q[:, 0], "m", "place"), "a": (q[:, 1], "rad", ""),
        "vx": (v[:, 0], "m/s", "velocity of x"),
        "w": (v[:, 1], "rad/s", "velocity of a"),
        "push": (lam[:, 0], "N", "contact force, a spring"),
        "lam_wall": (lam[:, 1], "N", "contact force, wall"),
        "room": (gap[:, 0], "m", "gap, negative in contact, a spring"),
        "gap_wall": (gap[:, 1], "m", "gap, negative in contact, wall"),
        "impulse_stop": (impulse[:, 0], "N s", "impulse since the start, a spring"),
        "impulse_wall": (impulse[:, 1], "N s", "impulse since the start, wall"),
        "kinetic_energy": (energies["kinetic_energy"], "J", "kinetic energy"),
        "potential_energy": (energies["potential_energy"], "J",
                             "potential energy without contacts"),
        "contact_energy": (energies["contact_energy"], "J", "energy stored in contacts"),
        "input_work": (energies["input_work"], "J", "work of the inputs since the start"),
        "dissipated_work": (energies["dissipated_work"], "J", "work dissipated since the start"),
        "knots": (given.knots, "1", "rows that are nodes of the plan"),
        "applied_F": (np.array([51.0]), "N", "F as applied"),
        "applied_M": (np.array([52.0]), "N m", "M as applied"),
        "position_error": (np.array([0.5, 2.0]), "m/rad",
                           "largest difference of a coordinate to the plan"),
    }  # fmt: skip
    assert {
        name: (item.values.tolist(), item.unit, item.description) for name, item in columns.items()
    } == {name: (values.tolist(), unit, text) for name, (values, unit, text) in expected.items()}
    assert {name: columns[name].dimension for name in ("x", "knots", "applied_F")} == {
        "x": "time",
        "knots": "node",
        "applied_F": "step",
    }
    facts = json.loads(str(attributes.pop("facts")))
    assert {name: attributes[name] for name in ("content", "scene", "fmu_sha256")} == {
        "content": "touchstone replay",
        "scene": "cart",
        "fmu_sha256": "sha",
    }
    assert facts.pop("error")["estimate"] == {"position": 1.0, "state": 2.0, "gap": None}
    assert facts == {
        "outcome": "OK", "message": "a note", "method": "everyday", "events": [[0.5, "stop", True]],
        "event_budget": 77, "seconds_reference": 3.0,
        "seconds_everyday": 4.0, "has_impulse": True,
        "growth": {"amplification": 5.0, "begin": 6.0, "end": 7.0, "duration": 8.0},
        "effort": {"rms": [1.0], "peak": [2.0], "rms_share": 3.0, "peak_share": 4.0,
                   "plan_share": 5.0, "saturated": 6.0},
    }  # fmt: skip
    bare = replace(
        given, contact_impulse=None, growth=None, effort=None,
        applied=given.applied[:0], input_work=None, dissipated_work=None,
    )  # fmt: skip
    write_replay(tmp_path / "bare.nc", bare, model, plan)
    columns, attributes = read_columns(tmp_path / "bare.nc")
    assert expected.keys() - columns.keys() == {
        "impulse_stop",
        "impulse_wall",
        "applied_F",
        "applied_M",
        "input_work",
        "dissipated_work",
    }
    facts = json.loads(str(attributes["facts"]))
    assert (facts["has_impulse"], facts["growth"], facts["effort"]) == (False, None, None)
    with pytest.raises(TrajectoryError, match=r"other\.nc: .*of scene cart, not of other"):
        write_replay(tmp_path / "other.nc", given, replace(model, name="other"), plan)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ReplayError(estimate=None), "state how good its results are"),
        (ReplayError(estimate=None, tolerance=Difference(position=1.0, state=1.0, gap=1.0)), ""),
        (ReplayError(estimate=None, everyday=Difference(position=1.0, state=1.0, gap=1.0)), ""),
        (ReplayError(estimate=Difference(position=np.inf, state=np.inf, gap=1.0)),
         "state [accuracy] position in"),
        (ReplayError(estimate=Difference(position=1.0, state=np.inf, gap=1.0)),
         "state [accuracy] velocity in"),
        (ReplayError(estimate=Difference(position=np.inf, state=np.inf, gap=np.inf)),
         "state [accuracy] position and gap in"),
        (ReplayError(estimate=Difference(position=1.0, state=1.0, gap=1.0),
                     stated=Difference(position=1.0, state=1.0, gap=1.0)),
         "a better stated accuracy"),
        (ReplayError(estimate=Difference(position=1.0, state=1.0, gap=1.0)),
         "a plan with shorter steps"),
    ],
)  # fmt: skip
def test_what_would_decide_an_undecided_replay(error: ReplayError, words: str):
    assert error.would_decide.startswith(words)
    assert bool(error.would_decide) is bool(words)
    assert ("offers Model Exchange (without --own-step)" in error.would_decide) is bool(words)


def test_a_replay_holds_finite_numbers_that_nobody_changes(replayed: Replay):
    with pytest.raises(ValueError, match="read-only"):
        replayed.q[0, 0] = 1.0
    broken = replayed.q.copy()
    broken[0, 0] = np.nan
    with pytest.raises(ValueError, match="finite numbers only"):
        replace(replayed, q=broken)
    assert replayed.end.tolist() == [*replayed.q[-1], *replayed.v[-1]]
    assert (
        replayed.energy.tolist()
        == (replayed.kinetic_energy + replayed.potential_energy + replayed.contact_energy).tolist()
    )
    assert Growth(amplification=0.0, begin=0.0, end=1.0, duration=2.0).rate == pytest.approx(
        np.log(1e-300) / 2.0
    )

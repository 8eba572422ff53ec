"""A robot of MuJoCo as it is read: names, units, what no FMU can carry, what is missing, and the columns of a recorded plan."""

from pathlib import Path

import numpy as np
import pytest
from robots import LEG

from models.fmu.mjcf import Recorder, RobotError, build_robot, read_robot
from validate.fmi.description import read_package

mujoco = pytest.importorskip("mujoco")


@pytest.mark.parametrize(("actuator", "unit"), [
    ('<motor joint="j"/>', "N m"), ('<motor joint="s"/>', "N"),
    ('<motor joint="j" gear="3"/>', "1"), ('<position joint="j" kp="7"/>', "rad"),
    ('<position joint="s" kp="7" kv="1"/>', "m"), ('<velocity joint="s" kv="3"/>', "m/s"),
    ('<general joint="j" gainprm="2"/>', "1"),
])  # fmt: skip
def test_an_input_has_the_unit_that_is_known(robot, actuator: str, unit: str):
    text = f"""<mujoco><worldbody><body><joint name="j"/><joint name="s" type="slide"/><geom size=".1"/></body></worldbody>
    <actuator>{actuator}</actuator></mujoco>"""
    (found,) = [variable for variable in robot(text).table if variable.causality == "input"]
    assert found.unit == unit
    assert found.name in ("u_j", "u_s")


def _body(inside: str, outside: str = "", option: str = "") -> str:
    return f'<mujoco>{option}<worldbody><body name="arm"><geom name="arm" size=".1" condim="1"/>{inside}</body></worldbody>{outside}</mujoco>'


@pytest.mark.parametrize(("text", "said"), [
    ("hello", ("MuJoCo", "does not read it", "correct it")),
    (_body('<joint name="j" apirate="1"/>'), ("apirate", "line 1", "another version")),
    (_body('<geom type="mesh" mesh="no"/>', '<asset><mesh name="no" file="no.stl"/></asset>'),
     ("no.stl", "does not read it")),
    (_body('<joint name="j"/>', '<actuator><general joint="j" dyntype="user"/></actuator>'),
     ("actuator", "user", "take them out")),
    (_body("<freejoint/>", '<sensor><user dim="1"/></sensor>'),
     ("sensor", "user", "take them out")),
    (_body("<freejoint/>", option='<option><flag sleep="enable"/></option>'),
     ("sleep", "take the flag out")),
    (_body("<freejoint/>", option='<option timestep="0"/>'),
     ("timestep", "0 s", "at least 1e-09 s")),
    (_body('<joint name="a:b"/><joint name="a_b" axis="1 0 0"/>'),
     ("a:b", "a_b", "q_a_b", "rename")),
])  # fmt: skip
def test_what_no_fmu_can_carry_is_refused_in_a_sentence(robot, text: str, said: tuple[str, ...]):
    with pytest.raises(RobotError) as refused:
        build_robot(robot(text))
    assert all(part in str(refused.value) for part in (*said, ".xml")), str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("contact", "said"),
    [
        ("foot", ("foot", "A:B")),
        ("foot:flor", ("foot:flor", "floor")),
        ("foot:foot", ("foot:foot", "two")),
        (":", ("A:B",)),
    ],
)
def test_a_contact_of_nothing_is_refused(robot, contact: str, said: tuple[str, ...]):
    with pytest.raises(RobotError) as refused:
        robot(LEG, contact)
    assert all(part in str(refused.value) for part in said), str(refused.value)


def test_names_with_colons_are_found_as_sides_of_a_contact(robot):
    text = LEG.replace('name="foot"', 'name="left:foot"').replace('name="floor"', 'name="a:floor"')
    leg = robot(text, "left:foot:a:floor")
    assert leg.contacts[0].names == ("left:foot", "a:floor")
    assert "lam_left_foot_a_floor" in [variable.name for variable in leg.table]


def test_a_cut_binary_and_a_missing_file_are_refused(robot, tmp_path: Path):
    path = tmp_path / "leg.mjb"
    mujoco.mj_saveModel(robot(LEG).model, str(path), None)
    assert read_robot(path).model.nq == 9
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(RobotError, match=r"leg\.mjb.*does not read it.*runcated"):
        read_robot(path)
    with pytest.raises(RobotError, match=r"none\.xml.*no such file"):
        read_robot(tmp_path / "none.xml")
    with pytest.raises(RobotError, match=r"'bend'.*did you mean bent"):
        robot(LEG, keyframe="bend")
    assert not list(tmp_path.glob("MUJOCO*"))


@pytest.mark.slow
def test_what_is_missing_in_a_robot_is_said_and_not_refused(robot):
    assert (
        robot(
            _body('<joint name="j"/>', '<actuator><motor joint="j" ctrlrange="-1 1"/></actuator>')
        ).notes
        == []
    )
    (bounds,) = robot(_body('<joint name="j"/>', '<actuator><motor joint="j"/></actuator>')).notes
    assert "ctrlrange" in bounds
    assert "u_j" in bounds
    (idle,) = robot(_body('<joint name="j"/>')).notes
    assert "no actuators" in idle
    delayed = robot(
        _body(
            '<joint name="j"/>',
            '<actuator><motor joint="j" ctrlrange="-1 1" delay=".01" nsample="8"/></actuator>',
        )
    )
    assert "no Model Exchange" in delayed.notes[0]
    assert "delay" in delayed.notes[0]
    assert read_package(build_robot(delayed)).exchange is None
    (rubs,) = robot(
        _body(
            '<joint name="j"/><geom size=".1"/>',
            '<actuator><motor joint="j" ctrlrange="-1 1"/></actuator>',
        )
    ).notes
    assert "no Model Exchange" in rubs
    assert "friction" in rubs


def test_a_urdf_is_a_robot(robot):
    link = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    joint = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    found = robot(
        f'<robot name="r"><link name="a">{link}</link><link name="b">{link}</link>{joint}</robot>',
        suffix=".urdf",
    )
    assert [variable.name for variable in found.table[:3]] == ["time", "q_j", "v_j"]


def test_a_recorded_row_has_the_columns_of_the_map(robot):
    leg = robot(LEG)
    data, recorder = mujoco.MjData(leg.model), Recorder(leg.model)
    data.qvel[3:6] = 0.3, -0.2, 0.1
    recorder.record(data)
    row = dict(zip(recorder.columns, recorder.rows[0], strict=True))
    assert row["q_root_z"] == 0.55
    assert row["v_root_wy"] == -0.2
    assert [row[f"v_root_{part}"] for part in ("qw", "qx", "qy", "qz")] == pytest.approx(
        [0.0, 0.15, -0.1, 0.05]
    )
    assert all(
        f'column = "{name}"' in leg.map_text
        for name in recorder.columns
        if name.startswith("v_") and not name.startswith("v_root_w")
    )


# Joints called like the parts of others: a slide and hinges beside a free and a ball joint.
_ODD = """<mujoco><option timestep="0.002"><flag contact="disable"/></option><worldbody>
  <body><joint name="head_qw" type="slide" axis="0 0 1"/><geom size=".1"/>
    <body><joint name="wz" axis="0 1 0"/><geom size=".1" pos="0 0 .3"/>
      <body><joint name="neck" type="ball"/><geom type="box" size=".1 .2 .3" pos=".1 0 .3"/></body></body></body>
  <body pos="2 0 0"><freejoint name="tip_wx"/><geom type="box" size=".1 .2 .3"/></body>
</worldbody><actuator><motor joint="wz" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_joints_are_what_the_model_says_whatever_they_are_called(robot):
    odd = robot(_ODD)
    assert [item.name for item in odd.turns] == [
        f"v_{joint}_{part}" for joint in ("neck", "tip_wx") for part in ("wx", "wy", "wz")
    ]
    assert [(name, column) for _, name, column in odd.velocities[:3]] == [
        ("v_head_qw", "v_head_qw"),
        ("v_wz", "v_wz"),
        ("der(q_neck_qw)", "v_neck_qw"),
    ]
    start = odd.map_text.partition("[start]")[2]
    assert "v_wz =" not in start
    assert "v_head_qw" not in start
    assert 'v_neck_wx = "v_neck_wx"' in start


def test_recorder_row_of_odd_names_is_mujocos(robot):
    odd = robot(_ODD)
    data, recorder = mujoco.MjData(odd.model), Recorder(odd.model)
    data.qvel[:] = 0.1 * np.arange(1, 12)
    before = data.qpos.copy()
    recorder.record(data)
    row = dict(zip(recorder.columns, recorder.rows[0], strict=True))
    assert len(row) == len(recorder.columns)
    assert (row["v_head_qw"], row["v_wz"]) == tuple(data.qvel[:2])
    assert [row[f"v_neck_{part}"] for part in ("wx", "wy", "wz")] == data.qvel[2:5].tolist()
    # The rates of both quaternions, by a short step of MuJoCo's own.
    moved, length = before.copy(), 1e-7
    mujoco.mj_integratePos(odd.model, moved, data.qvel, length)
    for joint, place in (("neck", 2), ("tip_wx", 9)):
        rates = [row[f"v_{joint}_{part}"] for part in ("qw", "qx", "qy", "qz")]
        assert rates == pytest.approx(
            ((moved - before)[place : place + 4] / length).tolist(), abs=1e-6
        )


_SERVOS = """<mujoco><option timestep="0.002">{flag}</option><worldbody>
  <body><joint name="a" axis="0 1 0" damping="1"/><geom size=".1" mass="1" pos="0 0 -.4"/>
    <body pos="0 0 -.5"><joint name="b" axis="0 1 0" damping="1"/><geom size=".1" mass="1" pos="0 0 -.3"/></body></body>
</worldbody><actuator><position name="a" joint="a" kp="30" ctrlrange="0.2 1"/><position name="b" joint="b" kp="30" ctrlrange="-1 1"/></actuator>
<keyframe><key name="far" qpos="0.3 -0.2" ctrl="0.4 2.5"/><key name="near" ctrl="0.4 -0.5"/></keyframe></mujoco>"""
_CONTACTS_OFF = '<flag contact="disable"/>'


@pytest.mark.parametrize(
    ("keyframe", "starts", "note"),
    [
        ("far", [0.4, 1.0], "keyframe 'far' is beyond the ctrlrange, and is cut as MuJoCo cuts it: u_b 2.5 to 1."),
        (None, [0.2, 0.0], "the default control is beyond the ctrlrange, and is cut as MuJoCo cuts it: u_a 0 to 0.2."),
        ("near", [0.4, -0.5], None),
    ],
)  # fmt: skip
def test_control_beyond_its_range_is_cut_as_mujoco_cuts_it(
    robot, keyframe: str | None, starts: list[float], note: str | None
):
    found = robot(_SERVOS.format(flag=_CONTACTS_OFF), keyframe=keyframe)
    inputs = [item for item in found.table if item.causality == "input"]
    assert [item.start for item in inputs] == starts
    assert found.notes == ([] if note is None else [note])
    ends = []
    for controls in (starts, found.start.ctrl.tolist()):
        data = mujoco.MjData(found.model)
        data.qpos[:], data.ctrl[:] = found.start.qpos, controls
        for _ in range(100):
            mujoco.mj_step(found.model, data)
        ends.append(data.qpos.tolist())
    assert ends[0] == ends[1], "the same motion, bit for bit"


def test_control_that_mujoco_does_not_cut_keeps_its_start(robot):
    """With the flag off there is no range in force either."""
    flag = '<flag contact="disable" clampctrl="disable"/>'
    found = robot(_SERVOS.format(flag=flag), keyframe="far")
    inputs = [item for item in found.table if item.causality == "input"]
    assert [(item.start, item.upper) for item in inputs] == [(0.4, np.inf), (2.5, np.inf)]
    (note,) = found.notes
    assert "no ctrlrange is in force for u_a, u_b" in note

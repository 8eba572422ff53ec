"""`fmu --mjcf`: an FMU and its map, or a sentence and nothing.

A recorded plan comes back to the bit.
"""

import json
import shutil
from contextlib import chdir, contextmanager
from pathlib import Path

import pytest

from models.fmu.mjcf import Recorder
from validate.cli.group import run

mujoco = pytest.importorskip("mujoco")

# A ball on a slide that a motor throws at the floor, and a paddle on a free joint that turns
# without touching anything.
ROBOT = """
<mujoco>
  <option timestep="0.004"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="ball" pos="0 0 .2"><joint name="z" type="slide" axis="0 0 1"/><geom name="ball" size=".1"/></body>
    <body name="paddle" pos="3 0 5" gravcomp="1"><freejoint name="paddle"/><geom type="box" size=".3 .2 .1"/></body>
  </worldbody>
  <actuator><motor name="push" joint="z" ctrlrange="-50 50"/></actuator>
</mujoco>
"""


@contextmanager
def within(place: Path):
    """In a folder with robot.xml."""
    (place / "robot.xml").write_text(ROBOT, encoding="utf-8")
    with chdir(place):
        yield place


@pytest.fixture
def folder(tmp_path: Path):
    with within(tmp_path):
        yield tmp_path


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """robot.fmu, robot.toml and a recorded plan.csv, made once."""
    with within(tmp_path_factory.mktemp("exported")) as made:
        assert (
            run(["fmu", "--mjcf", "robot.xml", "--contact", "ball:floor", "-o", "robot.fmu"]) == 0
        )
        record(made / "plan.csv")
    return made


@pytest.fixture
def robot(folder: Path, exported: Path, capfd: pytest.CaptureFixture[str]) -> Path:
    """A folder of one's own with what was exported."""
    for name in ("robot.fmu", "robot.toml", "plan.csv"):
        shutil.copy(exported / name, folder)
    capfd.readouterr()
    return folder


def record(path: Path) -> None:
    model = mujoco.MjModel.from_xml_path("robot.xml")
    data, recorder = mujoco.MjData(model), Recorder(model)
    data.qvel[4:7] = 1.0, -2.0, 0.5
    for step in range(100):
        data.ctrl[:] = -30.0 if step < 40 else 45.0
        recorder.record(data)
        mujoco.mj_step(model, data)
    recorder.record(data)
    recorder.write(path)


@pytest.mark.slow
def test_a_recorded_plan_comes_back_to_the_bit_by_its_own_step_alone(
    robot: Path, capfd: pytest.CaptureFixture[str]
):
    def replayed(*options: str) -> dict:
        run(["replay", "plan.csv", "--fmu", "robot.fmu", "--map", "robot.toml", "--json", *options])
        told = json.loads(capfd.readouterr().out)
        (told["error"],) = [
            metric for metric in told["metrics"] if metric["name"] == "replay_error"
        ]
        return told

    own = replayed("--own-step")
    assert own["error"]["value"] == 0.0
    assert own["error"]["error"] > 1e-4  # a quarter of the step changes the impact
    assert "one doStep" in own["replay"]["message"]
    fine = replayed()
    assert fine["error"]["value"] > 1e-4 > fine["error"]["error"]
    with Path("robot.toml").open("a") as file:
        file.write("\n[parameters]\ntimestep = 0.002\n")
    assert replayed("--own-step")["error"]["value"] > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("timestep = 0.002", ("robot.toml", "own step", "--own-step")),
        ("mas_ball = 2", ("robot.toml", "mas_ball", "mass_ball")),
        ("u_push = 2", ("u_push", "no parameter")),
        ("mass_ball = -5", ("mass_ball: -5 is not possible", "at least")),
    ],
)
def test_replay_wrong_parameter_in_map_is_refused(
    robot: Path, given: str, said: tuple[str, ...], capfd: pytest.CaptureFixture[str]
):
    with Path("robot.toml").open("a") as file:
        file.write(f"\n[parameters]\n{given}\n")
    assert run(["replay", "plan.csv", "--fmu", "robot.fmu", "--map", "robot.toml"]) == 2
    told = capfd.readouterr().err
    assert all(part in told for part in said), told


@pytest.mark.slow
def test_own_step_is_for_fmus_and_for_inputs_that_are_held(
    robot: Path, capfd: pytest.CaptureFixture[str]
):
    assert (
        run(
            [
                "replay",
                "plan.csv",
                "--fmu",
                "robot.fmu",
                "--map",
                "robot.toml",
                "--own-step",
                "--hold",
                "linear",
            ]
        )
        == 2
    )
    said = capfd.readouterr().err
    assert all(part in said for part in ("plan.csv", "--own-step", "held"))
    assert run(["replay", "plan.csv", "--scene", "three_cart", "--own-step"]) == 2
    assert "--own-step" in capfd.readouterr().err


@pytest.mark.slow
def test_a_map_that_is_there_is_kept(folder: Path, capfd: pytest.CaptureFixture[str]):
    (folder / "robot.toml").write_text("# mine\n")
    assert run(["fmu", "--mjcf", "robot.xml", "-o", "robot.fmu"]) == 0
    told = capfd.readouterr()
    assert told.out.splitlines() == ["robot.fmu"]
    assert "robot.toml" in told.err
    assert "kept" in told.err
    assert (folder / "robot.toml").read_text() == "# mine\n"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (
            ["--mjcf", "robot.xml", "-o", "robot.xml"],
            2,
            ("-o robot.xml", "named twice", "name another for -o"),
        ),
        (["--mjcf", "robot.xml", "-o", "robot.toml"], 2, ("robot.toml", "robot.fmu")),
        (["--mjcf", "none.xml", "-o", "robot.fmu"], 2, ("none.xml", "no such file")),
        (["--mjcf", "robot.xml", "three_cart", "-o", "robot.fmu"], 2, ("either", "--mjcf")),
        (["--mjcf", "robot.xml", "--platform", "win64", "-o", "robot.fmu"], 2, ("--platform",)),
        (["three_cart", "--keyframe", "home", "-o", "robot.fmu"], 2, ("--keyframe", "--mjcf")),
        (["--mjcf", "robot.xml", "-o", "robot.xml/robot.fmu"], 3, ("cannot write", "robot.xml")),
    ],
)
def test_a_mistake_is_a_sentence_and_nothing_is_written(
    folder: Path,
    words: list[str],
    code: int,
    said: tuple[str, ...],
    capfd: pytest.CaptureFixture[str],
):
    assert run(["fmu", *words]) == code
    told = capfd.readouterr().err
    assert all(part in told for part in said), told
    assert "Traceback" not in told
    assert [path.name for path in folder.iterdir()] == ["robot.xml"]
    assert (folder / "robot.xml").read_text() == ROBOT


def test_without_a_compiler_nothing_is_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("CC", "/nowhere/cc")
    assert run(["fmu", "--mjcf", "robot.xml", "-o", "robot.fmu"]) == 3
    assert "CC" in capfd.readouterr().err
    assert [path.name for path in folder.iterdir()] == ["robot.xml"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "version"), [("robot", "2"), ("swing", "3")])
def test_every_check_of_what_is_offered_passes(
    folder: Path, name: str, version: str, capfd: pytest.CaptureFixture[str]
):
    """A robot with friction offers Co-Simulation alone, one without Model Exchange too."""
    (folder / "swing.xml").write_text(
        ROBOT.replace('type="plane"', 'type="plane" condim="1"').replace(
            'name="ball" size', 'condim="1" name="ball" size'
        )
    )
    text = (
        (folder / "swing.xml")
        .read_text()
        .replace('type="box" size', 'type="box" contype="0" conaffinity="0" size')
    )
    (folder / "swing.xml").write_text(text)
    assert (
        run(
            [
                "fmu",
                "--mjcf",
                f"{name}.xml",
                "--contact",
                "ball:floor",
                "--fmi",
                version,
                "-o",
                f"{name}.fmu",
            ]
        )
        == 0
    )
    assert capfd.readouterr().out.splitlines() == [f"{name}.fmu", f"{name}.toml"]
    code = run(["check", f"{name}.fmu", "--json"])
    told = json.loads(capfd.readouterr().out)
    assert code == 0, [row for row in told["rows"] if row["status"] == "failed"]
    assert ("ME" in told["types"]) == (name == "swing")
    passed = {row["check"] for row in told["rows"] if row["status"] == "passed"}
    assert {
        "set state restores",
        "serialised state loads elsewhere",
        "instances do not disturb each other",
        "directional derivatives",
    } <= passed

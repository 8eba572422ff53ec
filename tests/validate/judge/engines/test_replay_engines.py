"""`replay --engine`: rows of other simulators in the table, in JSON and on the page.

The exit code stays that of our own verdict.
"""

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from wording import unsaid

from models.catalog import load_scene
from validate.cli.group import run

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    """`replay` in a folder with a plan for wall_pendulum that pushes for a while, and one for damped_collision, which has no inputs."""
    for name, push in (("wall_pendulum", 0.3), ("damped_collision", 0.0)):
        scene = load_scene(name)
        rows = [",".join(["t", *(item.name for item in scene.inputs)])]
        rows += [
            ",".join(
                [repr(i * scene.task.step), *(str(push if i < 30 else 0.0) for _ in scene.inputs)]
            )
            for i in range(101)
        ]
        (tmp_path / f"{name}.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)

    def call(name: str, *arguments: str) -> tuple[int, str, str]:
        code = run(["replay", f"{name}.csv", "--scene", name, *arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.mark.slow
@pytest.mark.process
def test_rows_of_engines_stand_in_json_and_on_the_page(command: Command, tmp_path: Path):
    pytest.importorskip("mujoco")
    alone, own, _ = command("wall_pendulum", "--json", "--html", "alone.html")
    code, out, err = command(
        "wall_pendulum", "--engine", "fmu,fmu_everyday,mujoco", "--json", "--html", "plan.html"
    )
    told = json.loads(out)
    assert code == alone
    assert told["verdict"] == json.loads(own)["verdict"]
    assert [row["engine"] for row in told["engines"]] == ["fmu", "fmu_everyday", "mujoco"]
    assert all(row["verdict"] == told["verdict"] and row["agrees"] for row in told["engines"])
    assert all(row["distance"] < 1e-3 for row in told["engines"])
    assert not unsaid(err, "mujoco: … ")
    assert "engines" not in json.loads(own)
    page, without = (
        (tmp_path / name).read_text(encoding="utf-8") for name in ("plan.html", "alone.html")
    )
    assert "Verdicts of other simulators" in page
    assert '<th scope="row">mujoco</th>' in page
    assert "Verdicts of other simulators" not in without


@pytest.mark.slow
@pytest.mark.process
def test_what_an_engine_cannot_express_is_a_row_of_the_table(command: Command):
    pytest.importorskip("mujoco")
    alone, _, _ = command("damped_collision")
    code, out, _ = command("damped_collision", "--engine", "mujoco,fmu_everyday", "--wide")
    assert code == alone
    assert not unsaid(out, "mujoco … cannot express it … no damping that grows")
    assert not unsaid(out, "The same in 1 of 1 engines")


def test_a_wrong_name_a_missing_package_and_somebodys_fmu_are_one_sentence(
    command: Command, monkeypatch: pytest.MonkeyPatch
):
    code, _, err = command("wall_pendulum", "--engine", "mujuco")
    assert code == 2
    assert not unsaid(err, "no engine 'mujuco'; did you mean mujoco")
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *rest: None if name == "mujoco" else found(name, *rest),
    )
    code, _, err = command("wall_pendulum", "--engine", "fmu,mujoco")
    assert code == 3
    assert not unsaid(err, "engine mujoco: … not installed; pip install")
    code = run(["replay", "wall_pendulum.csv", "--fmu", "somebody.fmu", "--engine", "fmu"])
    assert code == 2

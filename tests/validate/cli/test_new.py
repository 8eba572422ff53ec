"""`new`: a scene file that runs, and plans that fit a scene."""

from pathlib import Path

import pytest
from wording import unsaid

from models.catalog import load_scene
from models.fmu import build_fmu
from models.trajectory import read_csv
from validate.cli.group import run


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_new_scene_is_read_and_its_plan_is_judged(folder: Path, capsys):
    assert run(["new", "crate"]) == 0
    printed = capsys.readouterr().out
    commands = [line.strip() for line in printed.splitlines() if "python -m validate" in line]
    assert len(commands) == 3
    scene = load_scene("crate.py")
    assert scene.name == "crate"
    plan = read_csv(folder / "crate_plan.csv", scene)
    assert len(plan.t) == scene.task.steps + 1
    assert not plan.u.any()
    assert run(commands[0].split()[3:]) == 1
    assert not unsaid(capsys.readouterr().out, "violates: … 0.3 m from the goal")
    assert run(commands[1].split()[3:]) in (0, 3)


@pytest.mark.slow
def test_new_scene_has_a_plan_that_holds(capsys):
    run(["new", "crate"])
    assert run(["all", "--scene", "crate.py", "-k", "=strict", "--out", "runs"]) == 0
    assert "1 of 1 runs that end with exact contact hold" in capsys.readouterr().err


def test_new_plan_of_a_scene(folder: Path, capsys):
    assert run(["new", "--plan", "three_cart"]) == 0
    assert not unsaid(capsys.readouterr().out, "u1, u3", "q1, q2, q3", "lam_left, lam_right")
    lines = (folder / "three_cart_plan.csv").read_text().splitlines()
    assert lines[:2] == ["t,u1,u3", "0.0,0,0"]
    assert len(lines) == 502
    assert lines[-1] == "5.0,,"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["new"], "expected NAME, --plan SCENE or --map FILE.fmu"),
        (["new", "crate", "--plan", "three_cart"], "expected NAME, --plan SCENE or --map FILE.fmu"),
        (["new", "My-Crate"], "'My-Crate' is no name of a scene … lower-case"),
        (["new", "numpy"], "numpy.py would hide the Python module 'numpy'"),
        (["new", "--plan", "thre_cart"], "did you mean three_cart?"),
        (["new", "--plan", "bouncing_mass"], "bouncing_mass has no inputs"),
    ],
)
def test_new_refuses_in_a_sentence(words: list[str], sentence: str, folder: Path, capsys):
    assert run(words) == 2
    assert not unsaid(capsys.readouterr().err, sentence)
    assert not list(folder.iterdir())


@pytest.mark.parametrize("taken", ["crate.py", "crate_plan.csv"])
def test_new_overwrites_nothing(taken: str, folder: Path, capsys):
    (folder / taken).write_text("mine")
    assert run(["new", "crate"]) == 2
    assert not unsaid(capsys.readouterr().err, f"{taken} exists")
    assert [path.name for path in folder.iterdir()] == [taken]


def test_new_map_of_an_fmu_is_replayed_and_asks_for_a_goal(folder: Path, capsys):
    (folder / "carts.fmu").write_bytes(build_fmu(load_scene("two_discs")).read_bytes())
    assert run(["new", "--map", "carts.fmu"]) == 0
    printed = capsys.readouterr().out
    commands = [line.strip() for line in printed.splitlines() if "python -m validate" in line]
    assert sorted(path.name for path in folder.iterdir()) == [
        "carts.fmu",
        "carts.toml",
        "carts_plan.csv",
    ]
    assert run(commands[0].split()[3:]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert not unsaid(first, "not applicable: … the map asks for nothing: give it a [goal]")


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("absent.fmu", None, "absent.fmu: there is no such file"),
        ("broken.fmu", b"PK", "broken.fmu: it is not a zip file"),
    ],
)
def test_new_map_refuses_what_is_no_fmu(name, content, sentence, folder: Path, capsys):
    if content is not None:
        (folder / name).write_bytes(content)
    assert run(["new", "--map", name]) == 2
    assert not unsaid(capsys.readouterr().err, sentence)
    assert not list(folder.glob("*.toml"))


@pytest.mark.parametrize("taken", ["carts.toml", "carts_plan.csv"])
def test_new_map_overwrites_nothing(taken: str, folder: Path, capsys):
    (folder / "carts.fmu").write_bytes(build_fmu(load_scene("two_discs")).read_bytes())
    (folder / taken).write_text("mine")
    assert run(["new", "--map", "carts.fmu"]) == 2
    assert not unsaid(capsys.readouterr().err, f"{taken} exists")
    assert len(list(folder.iterdir())) == 2

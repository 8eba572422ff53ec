"""`energy`: exit codes, JSON, mistakes in one sentence; the same from Python."""

import json

import pytest

import touchstone as ts
from models.errors import TouchstoneError
from validate.cli.group import run

STILL = """import numpy as np


def step(q, v, u, h, parameters):
    # No force acts, and the mass matrix is that of the start.
    return q + h * v, v
"""


def test_energy_right_step_exit_0(capfd: pytest.CaptureFixture[str]):
    assert run(["energy", "wall_pendulum", "--step", "semi_implicit_euler", "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert found["vanishes"]
    assert found["order"] == pytest.approx(1.0, abs=0.2)
    assert len(found["errors"]) == len(found["steps"]) == 3


def test_energy_wrong_step_exit_1(tmp_path, capfd: pytest.CaptureFixture[str]):
    (tmp_path / "still.py").write_text(STILL)
    reference = f"{tmp_path / 'still.py'}:step"
    assert run(["energy", "wall_pendulum", "--step", reference]) == 1
    assert "does not vanish" in " ".join(capfd.readouterr().out.split())
    assert not ts.energy_test("wall_pendulum", reference).vanishes


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["wall_pendulun", "--step", "semi_implicit_euler"], "did you mean wall_pendulum?"),
        (["wall_pendulum", "--step", "euler"], "expected FILE.py:FUNCTION or one of"),
        (["wall_pendulum", "--step", "nothing.py:step"], "there is no file"),
    ],
)
def test_energy_mistake_exit_2(words, told: str, capfd: pytest.CaptureFixture[str]):
    assert run(["energy", *words]) == 2
    error = capfd.readouterr().err
    assert told in " ".join(error.split())
    assert "Traceback" not in error


def test_campaign_file_mistake_one_sentence(tmp_path):
    file = tmp_path / "field.toml"
    file.write_text('[[plans]]\nscene = "wall_pendulum"\nplans = "nothing/*.csv"\n')
    with pytest.raises(TouchstoneError, match="no file matches"):
        ts.campaign(tmp_path / "out", file=file)

"""What is possible in a scene but hardly meant is told before anything runs.

The bank gives no cause.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from wording import unsaid

from models.catalog import load_scene, scene_names
from models.scene import Input, Limit, Parameter
from models.trajectory import Trajectory, write_csv
from validate.campaign.warnings import scene_doubts, warnings_of
from validate.cli.group import run

WRONG_SIGN = """import json
from dataclasses import replace
from models.catalog import load_scene
bank = load_scene("wall_pendulum")
SCENE = replace(bank, name="wrong_sign", limits=(), answers=(), contacts=tuple(replace(c, penetration=-10 * c.penetration) for c in bank.contacts))
"""


def test_no_scene_of_the_bank_gives_cause():
    assert not warnings_of(map(load_scene, scene_names()))


@pytest.mark.slow
def test_what_changes_nothing_is_named():
    bank = load_scene("wall_pendulum")
    idle = Parameter(symbol=sp.Symbol("spare"), value=1.0, unit="m")
    brake = Input(symbol=sp.Symbol("brake", real=True), unit="N")
    said = scene_doubts(
        replace(bank, parameters=(*bank.parameters, idle), inputs=(*bank.inputs, brake))
    )
    of_parameter, of_input = said
    assert not unsaid(of_parameter, "wall_pendulum", "parameter spare", "changes nothing")
    assert not unsaid(of_input, "wall_pendulum", "input brake", "moves nothing")


def test_a_limit_that_judges_nothing_is_named():
    bank = load_scene("wall_pendulum")  # its end is free
    limit = Limit(metric="discrete_terminal_position_error", value=1.0, reason="as elsewhere")
    (said,) = scene_doubts(replace(bank, limits=(*bank.limits, limit)))
    assert not unsaid(
        said,
        "wall_pendulum",
        "limit on discrete_terminal_position_error",
        "judges nothing",
        "(norm of",
    )


def test_a_goal_deeper_than_the_contact_reaches_is_asked_about():
    bank = load_scene("three_cart")
    (depth, *_), (q1, q2, q3, *_) = bank.depths, bank.task.goal
    gap = float(
        bank.contacts[0]
        .penetration.subs(bank.parameter_values)
        .subs({bank.coordinates[0].symbol: q1, bank.coordinates[1].symbol: q2})
        .evalf()
    )
    for inside, told in ((0.9, 0), (1.1, 1)):
        deep = bank.with_task(goal=(q1 + inside * depth - gap, q2, q3 + 10.0, 0.0, 0.0, 0.0))
        found = [said for said in scene_doubts(deep) if "at the goal" in said]
        assert len(found) == told
        assert all(
            not unsaid(
                said,
                "contact left",
                f"{1.1 * depth:.3g} m deep at the goal … ends at {depth:.3g} m",
            )
            for said in found
        )
    assert not [
        said
        for said in scene_doubts(bank.with_task(goal=(q1, None, q3, 0.0, 0.0, 0.0)))
        if "at the goal" in said
    ]


@pytest.fixture
def wrong_sign(tmp_path):
    path = tmp_path / "wrong_sign.py"
    path.write_text(WRONG_SIGN, encoding="utf-8")
    return path


def standing_still(scene):
    task = scene.task
    start, steps = np.array(task.start), task.steps
    state = np.tile(start, (steps + 1, 1))
    nothing = np.zeros((steps, len(scene.inputs)))
    lam = np.zeros((steps, len(scene.contacts)))
    return Trajectory(
        t=task.step * np.arange(steps + 1),
        q=state[:, : scene.nq],
        v=state[:, scene.nq :],
        u=nothing,
        lam=lam,
    )


DRY_RUN = ("all", "--scene", "{scene}", "-k", "=strict", "--out", "{folder}/out", "--dry-run")
REPLAY = ("replay", "{folder}/plan.csv", "--scene", "{scene}")


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [DRY_RUN, (*DRY_RUN, "--json"), ("fmu", "{scene}", "-o", "{folder}/made.fmu"), REPLAY],
)
def test_a_start_deep_in_contact_is_asked_about(
    tmp_path, capsys, monkeypatch, wrong_sign, arguments
):
    monkeypatch.setattr("validate.cli.trials.TRIALS", ())
    scene = load_scene(str(wrong_sign))
    write_csv(tmp_path / "plan.csv", standing_still(scene), scene)
    assert run([word.format(scene=wrong_sign, folder=tmp_path) for word in arguments]) in (0, 1)
    said = capsys.readouterr().err
    assert said.startswith("warning: scene wrong_sign: contact wall is ")
    assert not unsaid(said, "sign of its penetration right?")
    assert said.count("\n") == 1


def test_a_doubt_goes_into_json_too(tmp_path, capsys, wrong_sign):
    """Who reads the score by machine is warned like everybody else, and what is on stdout stays JSON."""
    scene = load_scene(str(wrong_sign))
    write_csv(tmp_path / "plan.csv", standing_still(scene), scene)
    assert run(
        [word.format(scene=wrong_sign, folder=tmp_path) for word in (*REPLAY, "--json")]
    ) in (0, 1)
    out, err = capsys.readouterr()
    (warning,) = json.loads(out)["warnings"]
    assert not unsaid(warning, "sign of its penetration right?")
    assert err == ""

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
from validate.campaign.warnings import is_of_bank, scene_doubts, scene_figures, warnings_of
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
        "(distance of",
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


@pytest.mark.parametrize(("k", "coarse"), [(600.0, False), (1400.0, True)])
def test_scene_figures_contact_time_by_hand(k: float, coarse: bool):
    """Both contacts closed, the middle cart swings with w^2 = 3 k / m; h = 0.01 s."""
    scene = load_scene("three_cart").with_parameters(k=k)
    contact, stable, *_ = scene_figures(scene)
    omega = np.sqrt(3.0 * k)
    assert not unsaid(
        contact,
        f"{np.pi / omega:.3g} s",
        f"{np.pi / omega / 0.01:.1f} steps",
        f"{omega * 0.01:.2g}",
    )
    assert ("coarse" in contact) == coarse
    assert "0.01 s is stable in contact (limit 0.0" in stable


@pytest.mark.parametrize(("k", "outweighs"), [(90.0, False), (110.0, True)])
def test_scene_figures_softplus_force_against_the_input(k: float, outweighs: bool):
    """The largest input is 10 N: k ln 2 / |ln 1e-3| reaches it at k = 99.7 N/m."""
    scene = load_scene("three_cart").with_parameters(k=k)
    said = next(text for text in scene_figures(scene) if "softplus" in text)
    assert f"{k * np.log(2) / np.log(1e3):.3g} N at eps 0.001" in said
    assert ("Scene(length=..) below 0.91 m" in said) == outweighs


def test_scene_figures_without_inertia_have_no_contact_time():
    assert not any("omega h" in text for text in scene_figures(load_scene("push_box")))


def test_scene_of_the_bank_is_known_unless_changed():
    scene = load_scene("three_cart")
    assert is_of_bank(scene)
    assert not is_of_bank(scene.with_parameters(k=31.0))
    assert not is_of_bank(replace(scene, name="mine"))


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

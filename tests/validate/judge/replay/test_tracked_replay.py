"""The tracked replay against closed forms: a linear unstable pendulum whose closed loop is a product of matrices, reference and everyday alike."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from wording import unsaid

from models.catalog import load_scene
from models.errors import TrajectoryError
from models.fmu import build_fmu
from models.netcdf import read_columns
from models.scene import Scene
from models.scene.parts import goal_limits
from models.trajectory import Hold, Trajectory, uniform_grid, write_csv
from models.trajectory_netcdf import read_netcdf, write_netcdf
from validate.cli.group import run
from validate.judge.judgement import judge_trajectory
from validate.judge.replay import Replay
from validate.judge.replay.netcdf import write_replay
from validate.judge.replay.run import replay
from validate.judge.score import Question, Verdict, score

STEPS = 50
H = 0.05


@pytest.fixture(scope="module")
def scene() -> Scene:
    """theta'' = 10 theta + u, |u| <= 4, over 2.5 s; the wall is out of reach."""
    # The bank's end is free, and its limits are on the cost of that task.
    base = replace(
        load_scene("wall_pendulum"),
        limits=goal_limits(position=0.1, velocity=0.2, reason="this test"),
    )
    return base.with_parameters(w=1e4).with_task(
        step=H, steps=STEPS, start=(0.1, 0.0), goal=(0.0, 0.0)
    )


@pytest.fixture(scope="module")
def exact() -> tuple[np.ndarray, np.ndarray]:
    """A, B of one step with a held input, by the exponential of the matrix."""
    whole = expm(H * np.array([[0.0, 1.0, 0.0], [10.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    return whole[:2, :2], whole[:2, 2]


def made(states: np.ndarray, u: np.ndarray, hold: Hold = Hold.ZERO_ORDER) -> Trajectory:
    return Trajectory(
        t=uniform_grid(H, STEPS),
        q=states[:, :1],
        v=states[:, 1:],
        u=u,
        lam=np.zeros((STEPS, 1)),
        hold=hold,
    )


@pytest.fixture(scope="module")
def still() -> Trajectory:
    """Upright and at rest from the second node on, but the pendulum starts 0.1 rad away from there: all the rest is the feedback's."""
    states = np.zeros((STEPS + 1, 2))
    states[0] = 0.1, 0.0
    return made(states, np.zeros((STEPS, 1)))


@pytest.fixture(scope="module")
def caught(scene: Scene, still: Trajectory) -> Replay:
    return replay(scene, build_fmu(scene), still, track=True)


@pytest.mark.slow
def test_the_closed_loop_is_the_product_of_its_matrices(
    scene: Scene, still: Trajectory, caught: Replay, exact
):
    """x_1 = A x_0, then x_{t+1} = sat(A - B K_t) x_t: the gains of the file, the exact step, nothing else in between."""
    A, B = exact
    tracked = caught.tracked
    x, states, inputs = np.array([0.1, 0.0]), [np.array([0.1, 0.0])], []
    for step in range(STEPS):
        u = np.clip(-tracked.feedback.gains[step, 0] @ x, -4.0, 4.0) if step else 0.0
        x = A @ x + B * u
        states.append(x)
        inputs.append(u)
    replayed = np.hstack([tracked.q, tracked.v])[tracked.knots]
    assert np.abs(replayed - states).max() < 1e-10
    assert np.abs(tracked.applied[:, 0] - inputs).max() < 1e-9
    assert np.linalg.norm(replayed[-1]) < 0.1 * np.linalg.norm(replayed[0])  # and it is caught
    # The everyday replay closes the same loop: its own step is all that sets it apart.
    assert tracked.error.everyday.position < 1e-5
    assert caught.q[-1, 0] == pytest.approx(
        0.1 * np.cosh(np.sqrt(10.0) * STEPS * H), rel=1e-9
    )  # alone it falls


@pytest.mark.parametrize("hold", Hold)
def test_an_exact_plan_needs_no_feedback(scene: Scene, hold: Hold):
    """States of the continuous motion under the plan's inputs: the open loop amplifies rounding alone, the tracked one nothing."""
    u = 0.3 * np.sin(np.arange(STEPS))[:, None]
    whole = expm(
        H
        * np.array(
            [
                [0.0, 1.0, 0.0, 0.0],
                [10.0, 0.0, 1.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
                [0.0, 0.0, 0.0, 0.0],
            ]
        )
    )
    states = [np.array([0.01, -0.03])]
    for step in range(STEPS):
        slope = (u[min(step + 1, STEPS - 1), 0] - u[step, 0]) / H if hold is Hold.LINEAR else 0.0
        states.append(whole[:2] @ np.array([*states[-1], u[step, 0], slope]))
    plan = made(np.array(states), u, hold)
    scene = scene.with_task(start=(0.01, -0.03))
    tracked = replay(scene, build_fmu(scene), plan, track=True).tracked
    assert tracked.effort.peak[0] < 1e-7
    assert np.abs(tracked.q[tracked.knots] - plan.q).max() < 1e-9


def test_energy_balances_with_the_inputs_that_were_applied(
    scene: Scene, still: Trajectory, caught: Replay
):
    assert score(scene, still, caught).value("tracked_energy_residual_relative") == pytest.approx(
        0.0, abs=1e-10
    )
    assert abs(caught.tracked.input_work[-1]) > 1e-3


@pytest.mark.slow
def test_a_child_process_replays_the_same(scene: Scene, still: Trajectory, caught: Replay):
    from validate.processes.isolated import Limits

    other = replay(scene, build_fmu(scene), still, limits=Limits(seconds=100.0), track=True)
    for one, again in ((caught, other), (caught.tracked, other.tracked)):
        assert (one.q.tobytes(), one.v.tobytes(), one.effort) == (
            again.q.tobytes(),
            again.v.tobytes(),
            again.effort,
        )


@pytest.mark.slow
def test_files_hold_the_law_and_what_it_did(
    tmp_path, scene: Scene, still: Trajectory, caught: Replay
):
    tracked = caught.tracked
    gains = tracked.feedback.gains
    write_netcdf(tmp_path / "plan.nc", still, scene, gains)
    write_replay(tmp_path / "tracked.nc", tracked, scene, still)
    (planned, _), (followed, attributes) = (
        read_columns(tmp_path / name) for name in ("plan.nc", "tracked.nc")
    )
    (push,), states = (item.name for item in scene.inputs), [*scene.coordinates]
    names = [item.name for item in states] + [item.velocity_name for item in states]
    assert (
        np.column_stack([planned[f"gain_{push}_{name}"].values for name in names]).tobytes()
        == gains[:, 0].tobytes()
    )
    assert read_netcdf(tmp_path / "plan.nc", scene).q.tobytes() == still.q.tobytes()
    assert followed[f"applied_{push}"].values.tobytes() == tracked.applied[:, 0].tobytes()
    assert json.loads(str(attributes["facts"]))["effort"]["rms_share"] == tracked.effort.rms_share
    write_netcdf(tmp_path / "bare.nc", still, scene)
    assert not [name for name in read_columns(tmp_path / "bare.nc")[0] if name.startswith("gain_")]
    with pytest.raises(TrajectoryError, match="gains have shape"):
        write_netcdf(tmp_path / "plan.nc", still, scene, gains[1:])


def test_a_plan_that_no_input_moves_is_not_saved_by_feedback(
    scene: Scene, still: Trajectory, caught: Replay
):
    """The plan's own inputs are zero: all that moves it is the feedback."""
    told = score(scene, still, caught)
    assert (told.verdict, told.judged) == (Verdict.VIOLATES, "open")
    assert told.metric("feedback_share").ok is False


@pytest.fixture(scope="module")
def reaching(scene: Scene, exact) -> tuple[Scene, Trajectory, Replay]:
    """What the caught pendulum did, as a plan whose inputs are rounded to 1e-3 N m: true to its motion, but alone it falls by 2700 times that."""
    A, B = exact
    x, states, inputs = np.array([0.1, 0.0]), [np.array([0.1, 0.0])], []
    gain = np.array([25.0, 8.0])
    for _ in range(STEPS):
        u = np.round(-gain @ x, 3)
        x = A @ x + B * u
        states.append(x)
        inputs.append([u + 4e-4])
    plan = made(np.array(states), np.array(inputs))
    return scene, plan, replay(scene, build_fmu(scene), plan, track=True)


def test_the_same_limits_are_asked_of_the_replay_with_feedback(reaching):
    scene, plan, replayed = reaching
    told = score(scene, plan, replayed)
    assert told.metric("replay_error").ok is False
    assert told.verdict is Verdict.HOLDS_WITH_FEEDBACK, told.why
    assert told.judged == "feedback"
    assert dict(told.questions)[Question.MOTION] == "yes"
    for name in ("replay_error", "max_penetration"):
        alone, followed = told.metric(name), told.metric(f"tracked_{name}")
        assert (alone.limit, alone.reason, alone.default) == (
            followed.limit,
            followed.reason,
            followed.default,
        )
    assert told.metric("tracked_replay_error").ok is True
    assert told.value("feedback_effort") < 0.01
    assert not unsaid(told.why, "not for the inputs alone: … departs from the plan by")
    assert "unstable in the open loop (amplification " in told.why
    # and judge makes that second replay by itself
    assert judge_trajectory(scene, build_fmu(scene), plan).verdict is Verdict.HOLDS_WITH_FEEDBACK


SCENE_FILE = """import json
from dataclasses import replace
from pathlib import Path
from models.catalog import load_scene
from models.scene.parts import goal_limits
base = replace(load_scene("wall_pendulum"), name="far_wall", limits=goal_limits(position=0.1, velocity=0.2, reason="this test"))
SCENE = base.with_parameters(w=1e4).with_task(step=0.05, steps=50, start=(0.1, 0.0), goal=(0.0, 0.0))
"""


@pytest.mark.slow
def test_the_command_is_content_with_feedback_unless_it_must_not_be(
    tmp_path: Path, reaching, capsys: pytest.CaptureFixture[str]
):
    """Exit code 0 for `holds with feedback`, 1 with --require holds.

    The words and both ends are the same either way.
    """
    scene, plan, _ = reaching
    (tmp_path / "far_wall.py").write_text(SCENE_FILE, encoding="utf-8")
    write_csv(tmp_path / "plan.csv", plan, scene)
    arguments = ["replay", str(tmp_path / "plan.csv"), "--scene", str(tmp_path / "far_wall.py")]
    said = []
    for more, code in (([], 0), (["--require", "feedback"], 0), (["--require", "holds"], 1)):
        assert run([*arguments, *more]) == code
        said.append(capsys.readouterr().out)
    assert said[0].startswith("holds with feedback: ")
    header = next(line for line in said[0].splitlines() if line.startswith("question"))
    assert header.split()[2:6] == ["inputs", "alone", "with", "feedback"]
    row = next(
        line.split() for line in said[0].splitlines() if line.split()[1:2] == ["replay_error"]
    )
    assert float(row[2]) > 0.02 > float(row[3])
    assert not unsaid(said[0], "holds with feedback: not for the inputs alone: … departs")
    assert said[0] == said[2]
    assert run([*arguments, "--json", "--track", "--out", str(tmp_path / "told")]) == 0
    assert sorted(path.name for path in (tmp_path / "told").iterdir()) == [
        "plan.nc",
        "replay.nc",
        "score.json",
        "tracked.nc",
    ]
    assert (
        len(
            [
                name
                for name in read_columns(tmp_path / "told/plan.nc")[0]
                if name.startswith("gain_")
            ]
        )
        == 2
    )
    told = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / "told/score.json").read_text()) == told
    assert (told["verdict"], told["judged"]) == ("holds with feedback", "feedback")
    assert told["tracked"]["effort"]["plan_share"] < 0.25
    assert {"tracked_replay_error", "feedback_effort", "feedback_share"} <= {
        metric["name"] for metric in told["metrics"]
    }


def test_without_a_replay_with_feedback_it_violates(reaching):
    scene, plan, replayed = reaching
    told = score(scene, plan, replace(replayed, tracked=None))
    assert (told.verdict, told.judged, told.metric("feedback_effort")) == (
        Verdict.VIOLATES,
        "open",
        None,
    )


@pytest.mark.parametrize(
    ("field", "name", "limit"),
    [("rms_share", "feedback_effort", 0.25), ("plan_share", "feedback_share", 0.25)],
)
def test_a_plan_that_feedback_must_replace_does_not_hold(
    reaching, field: str, name: str, limit: float
):
    scene, plan, replayed = reaching
    for share, verdict in (
        (0.99 * limit, Verdict.HOLDS_WITH_FEEDBACK),
        (1.01 * limit, Verdict.VIOLATES),
    ):
        heavy = replace(replayed.tracked, effort=replace(replayed.tracked.effort, **{field: share}))
        told = score(scene, plan, replace(replayed, tracked=heavy))
        assert (told.metric(name).limit, told.verdict) == (limit, verdict)
    assert "With feedback too: " in told.why
    assert "of the feedback is" in told.why

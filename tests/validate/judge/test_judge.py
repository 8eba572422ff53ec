"""`judge(scene, plan)`: every form of a plan gives the same verdict; what it declares counts.

Mistakes are one sentence.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from wording import unsaid

from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.errors import SceneError, TouchstoneError, TrajectoryError
from models.scene import Scene
from models.scene.parts import goal_limits
from models.schemes import Scheme
from models.trajectory import Hold, Trajectory, column_names, uniform_grid, write_csv
from models.trajectory_netcdf import write_netcdf
from validate.cli.replay import exit_code
from validate.judge import judgement as module
from validate.judge.judgement import as_trajectory, judge, wire_fmu
from validate.judge.replay.wiring import HeldInputs
from validate.judge.score import Question, Verdict

STEPS = 50
H = 0.02
START = (2.0, 2.55, 3.1, 0.3, 0.0, -0.3)


def made(hold: Hold) -> tuple[Scene, Trajectory]:
    """Three carts in contact, exact to a hundred small steps in each of the plan's, and the scene whose goal is where that ends."""
    bank = load_scene("three_cart")
    t = uniform_grid(H, STEPS)
    u = np.column_stack([9.0 * np.sin(9.0 * t), -8.0 * np.cos(8.0 * t)])
    plan = Trajectory(
        t=t, q=np.zeros((STEPS + 1, 3)), v=np.zeros((STEPS + 1, 3)), u=u[:-1],
        lam=np.zeros((STEPS, 2)), hold=hold,
        u_end=u[-1], missing=frozenset({"lam"}),
    )  # fmt: skip
    held, parts = HeldInputs(plan), 100
    within = np.tile((np.arange(parts) + 0.5) * H / parts, STEPS)[:, None]
    fine = np.repeat(held.values, parts, axis=0) + np.repeat(held.slopes, parts, axis=0) * within
    run = load_kernel(bank).rollout(np.array(START), fine, H / parts)
    q, v = run.q[::parts], run.v[::parts]
    scene = replace(bank, limits=goal_limits(position=1e-2, velocity=1e-2, reason="this test"))
    goal = tuple(float(value) for value in (*q[-1], *v[-1]))
    return scene.with_task(step=H, steps=STEPS, start=START, goal=goal), replace(plan, q=q, v=v)


@pytest.fixture(scope="module")
def held() -> tuple[Scene, Trajectory]:
    return made(Hold.ZERO_ORDER)


@pytest.fixture(scope="module")
def lines() -> tuple[Scene, Trajectory]:
    return made(Hold.LINEAR)


def columns(scene: Scene, plan: Trajectory) -> dict[str, np.ndarray]:
    names = column_names(scene)
    u = plan.u if plan.u_end is None else np.vstack([plan.u, plan.u_end])
    arrays = {"t": plan.t} | dict(zip(names["u"], u.T, strict=True))
    for group, values in (("q", plan.q), ("v", plan.v)):
        arrays |= dict(zip(names[group], values.T, strict=True))
    return arrays


def framed(arrays: dict[str, np.ndarray]) -> Any:
    """As a DataFrame, whose columns are all as long."""
    padded = {
        name: np.pad(values, (0, STEPS + 1 - len(values)), constant_values=np.nan)
        for name, values in arrays.items()
    }
    return pytest.importorskip("pandas").DataFrame(padded)


def solution(plan: Trajectory | None) -> Solution:
    return Solution(method="mine", outcome=Outcome.SOLVED, trajectory=plan, cost=None)


@pytest.mark.slow
@pytest.mark.parametrize(
    "form", ["csv", "csv as text", "netcdf", "trajectory", "solution", "mapping", "dataframe"]
)
def test_every_form_of_a_plan_gives_the_same_verdict(held, tmp_path: Path, form: str):
    scene, plan = held
    if form.startswith("csv"):
        given = tmp_path / "plan.csv"
        write_csv(given, plan, scene)
        given = str(given) if form == "csv as text" else given
    elif form == "netcdf":
        given = tmp_path / "plan.nc"
        write_netcdf(given, plan, scene)
    elif form == "dataframe":
        given = framed(columns(scene, plan))
    else:
        given = {"trajectory": plan, "solution": solution(plan), "mapping": columns(scene, plan)}[
            form
        ]
    told = judge(scene, given)
    assert told.verdict is Verdict.HOLDS, told
    assert told.holds
    assert not unsaid(repr(told), "holds: every question … closest to its limit:")
    assert (told.plan.scheme, told.plan.missing) == (None, {"lam"})
    assert told.score.value("replay_error") == pytest.approx(
        judge(scene, plan).score.value("replay_error"), rel=1e-9
    )
    assert told.replay.tracked is None, "feedback is not tried where the inputs alone do"


def test_a_solution_without_a_plan_is_a_verdict():
    told = judge("three_cart", solution(None))
    assert (told.verdict, told.plan, told.replay, told.holds) == (
        Verdict.NO_PLAN,
        None,
        None,
        False,
    )


@pytest.mark.slow
def test_a_scene_is_given_by_name_too():
    """At rest, with no input: consistent in itself, but it says itself that it does not arrive, and no time step is blamed."""
    scene = load_scene("three_cart")
    t = uniform_grid(scene.task.step, scene.task.steps)
    rest = {"t": t, "u1": 0.0 * t, "u3": 0.0 * t} | {
        f"q{i + 1}": np.full_like(t, scene.task.start[i]) for i in range(3)
    }
    for scheme in (None, "semi_implicit_euler"):
        told = judge("three_cart", rest, scheme=scheme)
        assert told.verdict is Verdict.VIOLATES
        assert not unsaid(
            told.score.why, "plan itself ends 0.866 m … limit 0.06"
        )  # sqrt(3) times half a metre
        assert "step" not in told.score.why
        assert "driven" not in told.score.why
        assert told.score.metric("replay_error").ok is True


@pytest.mark.parametrize("hold", [Hold.ZERO_ORDER, Hold.LINEAR])
def test_where_the_other_hold_passes_the_sentence_names_it(held, lines, hold: Hold):
    """Inputs of a coarse plan, stated as steps where they were lines, and the other way round."""
    scene, plan = held if hold is Hold.LINEAR else lines
    told = judge(scene, replace(plan, hold=hold))
    assert told.verdict is Verdict.VIOLATES
    other = "linear" if hold is Hold.ZERO_ORDER else "zero"
    assert not unsaid(told.score.why, f"holds with another declaration: `# hold: {other}`")


def test_a_last_input_beyond_the_bounds_counts_only_where_it_is_applied(held, lines):
    for (scene, plan), ok in ((held, True), (lines, False)):
        metric = judge(scene, replace(plan, u_end=np.array([10.5, 0.0]))).score.metric(
            "bound_violation"
        )
        assert metric.ok is ok


def test_a_motion_that_neither_hold_gives_is_not_said_to_be_held_otherwise(held):
    scene, plan = held
    told = judge(scene, replace(plan, u=-plan.u))
    assert told.verdict is Verdict.VIOLATES
    assert "declaration" not in told.score.why


@pytest.mark.slow
def test_printed_with_four_decimals_it_holds(held, lines):
    for scene, plan in (held, lines):
        printed = {
            name: np.array([float(f"{value:.4f}") for value in values])
            for name, values in columns(scene, plan).items()
        }
        hold = "linear" if plan.hold is Hold.LINEAR else None
        assert judge(scene, printed, hold=hold).verdict is Verdict.HOLDS
        bare = {name: values for name, values in printed.items() if not name.startswith("v")}
        assert judge(scene, bare, hold=hold).verdict is Verdict.HOLDS
        alone = {name: values for name, values in printed.items() if name[0] in "tu"}
        told = judge(scene, alone, hold=hold)
        assert told.verdict is Verdict.HOLDS
        assert dict(told.score.questions)[Question.GOAL] == "not asked"


def test_an_exact_plan_that_claims_another_programs_step_is_refused_its_claim(held):
    """Declared: its own equations are asked, and they are not these.

    Undeclared: the same plan holds.
    """
    scene, plan = held
    told = judge(scene, columns(scene, plan), scheme="semi_implicit_euler")
    assert told.verdict is Verdict.VIOLATES
    assert told.score.metric("defect").ok is None, "it does not say its forces"
    assert told.score.metric("law_error").ok is False
    assert "relaxed" not in told.score.why
    assert "it holds with another declaration: no `# scheme:`" in told.score.why


@pytest.mark.slow
def test_grids_may_be_finer_and_coarser_than_the_tasks(held):
    scene, plan = held
    for step, steps in ((H / 4, 4 * STEPS), (5 * H, STEPS // 5)):
        assert judge(scene.with_task(step=step, steps=steps), plan).verdict is Verdict.HOLDS


def test_feedback_where_it_is_asked_for_changes_no_verdict(held):
    scene, plan = held
    told = judge(scene, plan, feedback=True)
    assert told.replay.tracked is not None
    assert (told.verdict, told.score.judged) == (Verdict.HOLDS, "open")


@pytest.mark.parametrize(
    ("change", "arguments", "words"),
    [
        ({"u1": None}, {}, "the column 'u1' is missing"),
        ({"q3": None}, {}, "the column 'q3' is missing, but 'q1' is present"),
        ({"w": np.zeros(STEPS + 1)}, {}, "the column 'w' is unknown"),
        ({}, {"hold": "cubic"}, "hold 'cubic' … zero or linear"),
        ({}, {"scheme": "rk4"}, "the scheme 'rk4' is unknown"),
        ({}, {"hold": ["zero"]}, "hold ['zero'] … zero or linear"),
        ({}, {"scheme": 3}, "the scheme 3 is unknown"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence(held, change: dict, arguments: dict, words: str):
    scene, plan = held
    given = {
        name: values
        for name, values in (columns(scene, plan) | change).items()
        if values is not None
    }
    with pytest.raises(TrajectoryError) as caught:
        judge(scene, given, **arguments)
    assert not unsaid(caught.value, words)
    assert "\n" not in str(caught.value)


def test_what_is_no_plan_is_told_so(held):
    scene, plan = held
    with pytest.raises(TrajectoryError, match=r"an? int is no plan; give"):
        judge(scene, 7)
    with pytest.raises(TrajectoryError, match="a Trajectory declares its own"):
        judge(scene, plan, scheme="semi_implicit_euler")
    with pytest.raises(TrajectoryError, match="scene three_cart has 2 inputs"):
        judge(scene, replace(plan, u=np.zeros((STEPS, 3)), u_end=None))


@pytest.mark.parametrize("scene", [None, 3, load_scene])
def test_what_is_no_scene_is_told_so(held, scene):
    with pytest.raises(SceneError, match=r"scene: an? (NoneType|int|function) is no scene; give"):
        judge(scene, held[1])


def test_a_file_that_says_its_own_scheme_is_not_asked_for_another(held, tmp_path: Path):
    scene, plan = held
    write_netcdf(tmp_path / "plan.nc", plan, scene)
    with pytest.raises(TrajectoryError, match="a NetCDF file declares its own"):
        judge(scene, tmp_path / "plan.nc", scheme="semi_implicit_euler")
    with pytest.raises(TrajectoryError, match="trajectory is a str, but must"):
        judge(scene, SimpleNamespace(trajectory="plan.csv"))


@pytest.mark.parametrize(
    ("scheme", "hold"),
    [("semi_implicit_euler", "zero"), (Scheme.SEMI_IMPLICIT_EULER, Hold.ZERO_ORDER)],
)
def test_hold_and_scheme_are_given_as_such_or_by_their_text(held, tmp_path: Path, scheme, hold):
    scene, plan = held
    path = tmp_path / "plan.csv"
    write_csv(path, plan, scene)
    for given in (columns(scene, plan), path):
        read = as_trajectory(given, scene, hold=hold, scheme=scheme)
        assert (read.scheme, read.hold) == (Scheme.SEMI_IMPLICIT_EULER, Hold.ZERO_ORDER)


def test_a_dataframe_says_no_more_and_no_less_than_its_numbers(held):
    pandas = pytest.importorskip("pandas")
    scene, plan = held
    frame = framed(columns(scene, plan))
    integers = frame.assign(u1=pandas.array([2] * STEPS + [None], dtype="Int64"))
    for same in (
        frame.astype(object),
        frame.set_index(frame["t"] + 7.0),
        frame[::-1][::-1],
        frame.astype("float64").convert_dtypes(),
        frame.astype(str),
    ):
        read = as_trajectory(same, scene)
        assert np.array_equal(read.u, plan.u)
        assert np.array_equal(read.q, plan.q)
    assert as_trajectory(integers, scene).u[:, 0].tolist() == [2.0] * STEPS
    for wrong, words in (
        (frame.drop(columns="u3"), "the column 'u3' is missing"),
        (pandas.concat([frame, frame[["u1"]]], axis=1), "the column 'u1' appears twice"),
        (
            frame.set_axis(pandas.MultiIndex.from_product([["a"], frame.columns]), axis=1),
            "a column is called ('a', 't'), but its name must be text",
        ),
        (
            frame.set_axis(range(len(frame.columns)), axis=1),
            "a column is called 0, but its name must be text",
        ),
        (
            frame.assign(t=pandas.to_timedelta(frame["t"], unit="s")),
            "the column 't' is of type timedelta64",
        ),
        (
            frame.assign(u1=pandas.array([None] * (STEPS + 1), dtype="Int64")),
            "the column 'u1' is empty; it has t,",
        ),
        (frame.assign(q1=frame["q1"] + 1j), "the column 'q1' is of type complex128"),
        (frame["t"], "a Series is no plan"),
    ):
        with pytest.raises(TrajectoryError) as caught:
            as_trajectory(wrong, scene)
        assert not unsaid(caught.value, words)


@pytest.mark.parametrize(
    ("verdict", "lenient", "strict"),
    [(Verdict.HOLDS, 0, 0), (Verdict.HOLDS_WITH_FEEDBACK, 0, 1), (Verdict.VIOLATES, 1, 1),
     (Verdict.UNDECIDED, 1, 1)],
)  # fmt: skip
def test_exit_codes(verdict: Verdict, lenient: int, strict: int):
    assert (exit_code(verdict, "feedback"), exit_code(verdict, "holds")) == (lenient, strict)


# Somebody's FMU: what is asked of whom, with a replay and a score that answer what the test says


@pytest.mark.parametrize(
    ("hold", "scheme", "inputs", "motion", "verdict", "again"),
    [
        (Hold.ZERO_ORDER, None, 1, "no", Verdict.VIOLATES, True),
        (Hold.LINEAR, None, 1, "no", Verdict.UNDECIDED, True),
        (Hold.ZERO_ORDER, Scheme.SEMI_IMPLICIT_EULER, 1, "no", Verdict.VIOLATES, False),
        (Hold.ZERO_ORDER, None, 0, "no", Verdict.VIOLATES, False),
        (Hold.ZERO_ORDER, None, 1, "undecided", Verdict.UNDECIDED, False),
        (Hold.ZERO_ORDER, None, 1, "yes", Verdict.VIOLATES, False),
        (Hold.ZERO_ORDER, None, 1, "yes", Verdict.HOLDS_WITH_FEEDBACK, True),
        (Hold.ZERO_ORDER, None, 1, "yes", Verdict.HOLDS, False),
        (Hold.ZERO_ORDER, Scheme.SEMI_IMPLICIT_EULER, 1, "yes", Verdict.HOLDS_WITH_FEEDBACK, False),
    ],
)  # fmt: skip
def test_a_motion_that_is_missed_is_tried_with_its_inputs_held_the_other_way(
    hold, scheme, inputs, motion, verdict, again, monkeypatch
):
    nodes = np.zeros((3, 1))
    plan = Trajectory(
        t=uniform_grid(0.5, 2),
        q=nodes,
        v=nodes,
        u=np.zeros((2, inputs)),
        lam=np.zeros((2, 0)),
        hold=hold,
        scheme=scheme,
    )
    replays: list[Any] = []
    scores: list[Any] = []
    monkeypatch.setattr(
        module,
        "replay_foreign",
        lambda *given, **named: replays.append((given, named)) or f"replay {len(replays)}",
    )
    answered = SimpleNamespace(questions=((Question.MOTION, motion),), verdict=verdict)
    monkeypatch.setattr(
        module, "score", lambda *given, **named: scores.append((given, named)) or answered
    )
    foreign: Any = SimpleNamespace(
        model="model", variables=SimpleNamespace(internal_step=None, parameters=())
    )
    monkeypatch.setattr(module, "read_package", lambda path: "package")
    monkeypatch.setattr("validate.judge.replay.mapping.wire", lambda *given: (foreign, plan))
    wired = wire_fmu(Path("a.fmu"), {"t": plan.t}, limits="limits")  # type: ignore[arg-type] - a stand-in, which is passed on
    found = wired.judge(True)
    assert (found.scene, found.plan, found.replay) == ("model", plan, "replay 1")
    assert replays[0] == (
        (foreign, "package", plan),
        {"limits": "limits", "own_step": False, "decides": wired._decides, "track": True},
    )
    assert scores[0] == (("model", plan, "replay 1"), {})
    assert len(replays) == len(scores) == 1 + again
    if again:
        other = replays[1][0][2]
        assert {other.hold, hold} == set(Hold)
        assert replays[1][1] == {
            "limits": "limits", "own_step": False, "decides": wired._decides,
        }  # fmt: skip
        assert scores[1] == (("model", plan, "replay 1"), {"other_hold": "replay 2"})


def test_a_plan_on_somebodys_fmu_is_wired_in_whatever_form_it_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    asked: list[Any] = []
    monkeypatch.setattr(module, "read_package", lambda path: f"package of {path}")
    foreign = SimpleNamespace(
        model="model", variables=SimpleNamespace(internal_step=None, parameters=())
    )
    monkeypatch.setattr(module, "_judged", lambda *given: given)
    monkeypatch.setattr(
        "validate.judge.replay.mapping.wire",
        lambda *given: asked.append(given) or (foreign, "trajectory"),
    )
    (tmp_path / "plan.csv").write_text("t,u\n0,1\n1,\n")
    columns = {"t": np.array([0.0, 1.0]), "u": np.array([1.0])}
    for plan in (tmp_path / "plan.csv", str(tmp_path / "plan.csv"), columns):
        wired = wire_fmu(Path("a.fmu"), plan, hold="linear")
        subject, trajectory, run, feedback = wired.judge(True)
        assert (subject, trajectory, feedback) == ("model", "trajectory", True)
        assert (run.func, run.args, run.keywords) == (
            module.replay_foreign, (foreign, "package of a.fmu"),
            {"limits": module.Limits(), "own_step": False, "decides": wired._decides},
        )  # fmt: skip
        package, table, map_file, hold, where = asked[-1]
        assert (package, table.names[0], map_file, hold, where) == (
            "package of a.fmu",
            "t",
            None,
            "linear",
            "FMU a.fmu",
        )
    (tmp_path / "map.toml").write_text("[limits]\nreplay_error = 0.5\n")
    run = wire_fmu(
        Path("a.fmu"), columns, map_path=tmp_path / "map.toml", limits=module.Limits(seconds=2.0)
    ).judge()[2]  # type: ignore[index]
    assert (run.keywords["limits"], run.keywords["own_step"]) == (module.Limits(seconds=2.0), False)
    assert (asked[-1][2].limits["replay_error"].value, asked[-1][4]) == (
        0.5,
        f"map {tmp_path / 'map.toml'}",
    )
    (tmp_path / "map.toml").write_text("[limits]\nreplay_eror = 0.5\n")
    with pytest.raises(
        TouchstoneError, match=r"limits\.replay_eror: .*no metric.*\(near it: replay_error"
    ):
        wire_fmu(Path("a.fmu"), columns, map_path=tmp_path / "map.toml")
    with pytest.raises(TrajectoryError, match="plan: a int has no names"):
        wire_fmu(Path("a.fmu"), 7)


@pytest.mark.parametrize("feedback", [True, False])
def test_a_scenes_plan_is_followed_where_its_score_wants_it(
    feedback: bool, monkeypatch: pytest.MonkeyPatch
):
    scene = load_scene("wall_pendulum")
    states = np.zeros((3, 1))
    plan = Trajectory(
        t=np.array([5.0, 5.5, 6.0]), q=states, v=states, u=np.zeros((2, 1)), lam=np.zeros((2, 1))
    )
    tracks: list[Any] = []
    monkeypatch.setattr(
        module, "replay", lambda *given, **named: tracks.append((given, named)) or "replay"
    )
    monkeypatch.setattr(
        module,
        "score",
        lambda *given, **named: SimpleNamespace(
            questions=(), verdict=Verdict.HOLDS, metrics=given[2]
        ),
    )
    monkeypatch.setattr(module, "wants_feedback", lambda metrics: metrics == "wanted")
    found = module.judge_trajectory(scene, Path("a.fmu"), plan, feedback=feedback, limits=None)
    assert (found.plan.t.tolist(), found.replay) == ([0.0, 0.5, 1.0], "replay")
    track = tracks[0][1]["track"]
    assert (track is True) is feedback
    if not feedback:
        assert (track("wanted"), track("opened")) == (found.plan, None)


@pytest.mark.parametrize("followed", [True, False])
def test_a_replay_that_is_not_followed_is_scored_once(
    followed: bool, monkeypatch: pytest.MonkeyPatch
):
    """What comes back is what was scored to ask whether to follow it.

    With a tracked replay beside it, it is another.
    """
    scene = load_scene("wall_pendulum")
    states = np.zeros((3, 1))
    plan = Trajectory(
        t=np.array([0.0, 0.5, 1.0]), q=states, v=states, u=np.zeros((2, 1)), lam=np.zeros((2, 1))
    )
    scored: list[Any] = []

    def score(*given: Any, **named: Any) -> Any:
        scored.append(given[2])
        return SimpleNamespace(questions=(), verdict=Verdict.HOLDS, metrics={}, number=len(scored))

    monkeypatch.setattr(
        module, "replay", lambda *given, track, **named: "followed" if track("opened") else "opened"
    )
    monkeypatch.setattr(module, "score", score)
    monkeypatch.setattr(module, "wants_feedback", lambda metrics: followed)
    found: Any = module.judge_trajectory(scene, Path("a.fmu"), plan, limits=None)
    assert (found.replay, scored) == (
        ("followed", ["opened", "followed"]) if followed else ("opened", ["opened"])
    )
    assert found.score.number == len(scored)


def coarse(steps: int, parts: int = 1) -> Trajectory:
    """Inputs that throw carts at each other, through our own step: so many of them, or with each in so many parts."""
    scene = load_scene("three_cart")
    h, kernel, task = scene.task.horizon / steps, load_kernel(scene), scene.task
    u = np.column_stack([3.0 * np.sign(np.sin(2.0 * h * np.arange(steps))), np.full(steps, -2.0)])
    run = kernel.rollout(np.array(task.start), np.repeat(u, parts, axis=0), h / parts)
    q, v = run.q[::parts], run.v[::parts]
    return Trajectory(t=uniform_grid(h, steps), q=q, v=v, u=u, lam=kernel.contact_force(q[:-1]))


@pytest.mark.slow
@pytest.mark.parametrize("forces", [True, False])
def test_a_plan_on_a_coarse_grid_gets_the_step_that_is_enough(forces: bool):
    scene, plan = load_scene("three_cart"), replace(coarse(50), scheme=Scheme.SEMI_IMPLICIT_EULER)
    asked = replace(
        scene,
        limits=(
            *(limit for limit in scene.limits if limit.metric == "replay_error"),
            *goal_limits(position=50.0, velocity=50.0, reason="it ends anywhere"),
        ),
    )
    told = judge(asked, plan if forces else replace(plan, missing=("lam",)))
    metric = told.score.metric("replay_error")
    assert (told.verdict, told.score.cause) == (Verdict.VIOLATES, "coarse grid")
    assert not unsaid(
        told.score.why,
        "the motion departs … discretisation error",
    )
    step = float(told.score.cause_fields["step"].removesuffix(" s"))
    finer = coarse(50, int(np.ceil(0.1 / step)))
    assert (
        np.abs(finer.q - told.replay.q[told.replay.knots]).max()
        < metric.limit
        < np.abs(plan.q - told.replay.q[told.replay.knots]).max()
    )

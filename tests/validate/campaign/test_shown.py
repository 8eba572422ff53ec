"""What a notebook shows of a plan that was solved or judged: one line, a page in a frame, a plot, a table."""

import base64
import re
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wording import unsaid

import touchstone as ts
from formulations.solution import Seconds, Solution
from models.errors import MachineError, TrajectoryError
from models.netcdf import read_columns
from models.scene import Limit
from models.trajectory import Trajectory
from validate.campaign import shown
from validate.campaign.shown import JudgedPlan, SolvedPlan
from validate.judge import judgement
from validate.judge.judgement import Judgement
from validate.judge.replay import Replay, ReplayError, ReplayOutcome
from validate.judge.replay.subject import (
    ForeignContact,
    ForeignCoordinate,
    ForeignInput,
    ForeignModel,
    ForeignTask,
)
from validate.judge.replay.wiring import Effort
from validate.judge.score import Metric, Question, Score, Verdict

SMALL = 150_000


@pytest.fixture(scope="module")
def plan() -> ts.Solution:
    return ts.solve("three_cart", "softplus_dc", eps=1e-3)


@pytest.fixture(scope="module")
def verdict(plan: ts.Solution) -> ts.Judgement:
    return ts.judge(plan.scene, plan)


def inside(frame: str) -> str:
    """The page in the frame, as a browser unpacks it."""
    found = re.fullmatch(r"<iframe srcdoc='[^']*atob\(\"([^\"]*)\"\)[^']*' [^>]*></iframe>", frame)
    assert found is not None
    return zlib.decompress(base64.b64decode(found[1])).decode()


@pytest.mark.slow
def test_the_frame_holds_verdict_player_and_figures_and_is_small(
    plan: ts.Solution, verdict: ts.Judgement
):
    frame = verdict._repr_html_()
    page = inside(frame)
    assert len(frame.encode()) <= SMALL
    for part in (
        "softplus_dc, eps 0.001 on three_cart",
        "violates",
        "<canvas",
        "Positions: plan dotted, replay solid",
        "ghost_impulse",
    ):
        assert not unsaid(page, part, part)
    assert "sandbox=" in frame
    assert not re.search(r"""(src|href)=["'](?!#)""", page), "nothing is loaded from elsewhere"
    assert "primal infeasibility" in page, "it is the whole page"
    alone = plan._repr_html_()
    assert len(alone.encode()) <= SMALL
    assert "<canvas" in inside(alone)
    assert "touchstone.judge(scene, plan)" in inside(alone), "nobody judged it"


@pytest.mark.slow
def test_a_plan_from_elsewhere_is_called_by_its_file(plan: ts.Solution, tmp_path: Path):
    """A name with markup is text on the page."""
    path = tmp_path / "<b>'mine'&.csv"
    plan.to_dataframe().to_csv(path, index=False)
    verdict = ts.judge("three_cart", path)
    page = inside(verdict._repr_html_())
    assert repr(verdict).startswith("Judgement(three_cart, <b>'mine'&.csv: violates, cost ")
    assert "<b>" not in page
    assert "&lt;b&gt;&#39;mine&#39;&amp;.csv" in page


@pytest.mark.slow
def test_plots_draw_the_plan_and_its_replay(
    plan: ts.Solution, verdict: ts.Judgement, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("matplotlib").use("Agg")
    from matplotlib import pyplot

    assert plan.trajectory is not None
    assert verdict.replay is not None
    alone, both = plan.plot(), verdict.plot()
    assert [axis.get_ylabel() for axis in alone] == [
        "position [m]",
        "velocity [m/s]",
        "force [N]",
        "input [N]",
    ]
    assert [line.get_label() for line in alone[0].lines] == ["q1", "q2", "q3"]
    assert [line.get_label() for line in both[0].lines][:2] == ["q1, plan", "q1, replay"]
    assert np.array_equal(both[0].lines[1].get_ydata(), verdict.replay.q[:, 0])
    held = alone[3].lines[0]
    assert (held.get_drawstyle(), len(held.get_ydata())) == ("steps-post", 501)
    assert held.get_ydata()[-1] == plan.trajectory.u[-1, 0]
    inputs = ts.judge(
        "three_cart",
        {"t": plan.trajectory.t, "u1": plan.trajectory.u[:, 0], "u3": plan.trajectory.u[:, 1]},
    )
    assert [line.get_label() for line in inputs.plot()[0].lines] == [
        "q1, replay",
        "q2, replay",
        "q3, replay",
    ], "it says no positions"
    ramp = replace(plan.trajectory, hold="linear", scheme=None, u_end=[7.0, 8.0])
    assert ramp.plot(plan.scene)[3].lines[1].get_ydata()[-1] == 8.0
    pyplot.close("all")


@pytest.mark.slow
@pytest.mark.parametrize(("package", "call"), [("matplotlib", "plot"), ("pandas", "to_dataframe")])
def test_without_the_extra_one_sentence_says_what_to_install(
    package, call, plan, verdict, monkeypatch
):
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    for item in (plan, verdict):
        with pytest.raises(
            MachineError, match=rf"{package}, which is not installed; pip install matplotlib pandas"
        ):
            getattr(item, call)()


@pytest.mark.slow
def test_without_a_plan_it_says_why(plan: ts.Solution):
    lost = replace(plan, trajectory=None, outcome=ts.Outcome.INFEASIBLE, message="")
    for call in (lost.plot, lost.to_dataframe):
        with pytest.raises(
            TrajectoryError,
            match=r"softplus_dc, eps 0.001 on three_cart: no plan.*No plan satisfies",
        ):
            call()
    verdict = ts.judge(plan.scene, lost)
    with pytest.raises(TrajectoryError, match="there is no plan to draw"):
        verdict.plot()
    assert "no plan" in inside(verdict._repr_html_())


def test_times_alone_cannot_be_drawn():
    scene = ts.scene("bouncing_mass")
    steps = np.linspace(0.0, 1.0, 11)
    plan = ts.Trajectory(
        t=steps,
        q=np.zeros((11, 1)),
        v=np.zeros((11, 1)),
        u=np.zeros((10, 0)),
        lam=np.zeros((10, 1)),
        missing={"q", "v", "lam"},
    )
    with pytest.raises(TrajectoryError, match="only times of scene bouncing_mass"):
        plan.plot(scene)


# What is drawn, without drawing it


SCENE = ts.scene("three_cart")


def motion(nodes: int = 3, **more: Any) -> Trajectory:
    given = {"t": 0.01 * np.arange(nodes), "q": np.arange(3.0 * nodes).reshape(nodes, 3),
             "v": np.ones((nodes, 3)), "u": 50.0 + np.arange(2.0 * (nodes - 1)).reshape(-1, 2),
             "lam": 70.0 + np.arange(2.0 * (nodes - 1)).reshape(-1, 2)}  # fmt: skip
    return Trajectory(**(given | more))


def replay_of(
    q: np.ndarray, scene: str, seconds: float, contacts: int = 2, tracked: Replay | None = None
) -> Replay:
    rows, nothing = len(q), np.zeros(len(q))
    return Replay(
        scene=scene, outcome=ReplayOutcome.OK, message="", method="reference",
        t=0.01 * np.arange(rows), q=q, v=q * 0.0, lam=np.zeros((rows, contacts)),
        gap=np.ones((rows, contacts)), friction=np.zeros((rows, 0)), knots=np.arange(rows),
        kinetic_energy=nothing, potential_energy=nothing, contact_energy=nothing,
        input_work=None, dissipated_work=None, contact_impulse=None, events=(), event_budget=1,
        error=ReplayError(estimate=None),
        seconds_reference=seconds, seconds_everyday=10.0 * seconds, fmu="sha", tracked=tracked,
    )  # fmt: skip


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Of each page: the record of its run, and the columns of its files."""
    found: list[Any] = []

    def render(run: Any, place: Path, additions: Any) -> str:
        assert additions == {}
        files = {path.name: read_columns(path)[0] for path in (place / "runs" / run.key).iterdir()}
        found.append((run, files))
        return "<p>a & b 'c'</p>"

    monkeypatch.setattr(shown, "render_run", render)
    return found


def judged_as(
    plan: Trajectory | None,
    replay: Replay | None,
    subject: Any = SCENE,
    *metrics: Metric,
    judged: str = "open",
    **more: Any,
) -> JudgedPlan:
    result = Score(metrics=metrics, verdict=Verdict.VIOLATES, why="because", judged=judged)
    return JudgedPlan(scene=subject, plan=plan, replay=replay, score=result, **more)


REACHED = Metric(
    name="replay_error",
    question=Question.MOTION,
    value=0.25,
    unit="m",
    meaning="far",
    error=0.125,
    limit=0.5,
    reason="near",
    ok=True,
)
PRICED = Metric(name="cost", question=Question.GOAL, value=12345.678, unit="1", meaning="dear")


@pytest.mark.slow
def test_a_page_is_drawn_from_the_plan_its_replay_and_that_with_feedback(drawn: list[Any]):
    effort = Effort(
        rms=(1.0, 1.0),
        peak=(1.0, 1.0),
        rms_share=0.1,
        peak_share=0.1,
        plan_share=0.1,
        saturated=0.0,
    )
    tracked = replace(replay_of(np.full((4, 3), 7.0), "three_cart", 100.0), effort=effort)
    verdict = judged_as(
        motion(),
        replay_of(np.full((3, 3), 5.0), "three_cart", 1.0, tracked=tracked),
        SCENE,
        REACHED,
        PRICED,
        name="mine",
    )
    assert verdict.page("the command", ("odd", "strange")) == "<p>a & b 'c'</p>"
    ((run, files),) = drawn
    assert (run.pipeline, run.pipeline_title, run.provenance.command, run.verdict) == (
        "mine",
        "",
        "the command",
        "violates",
    )
    assert (run.scene.name, run.must_hold, run.stages[0].kind, run.stages[0].index) == (
        "three_cart",
        True,
        "given",
        0,
    )
    assert run.message == run.stages[0].message
    assert "odd strange" in run.stages[0].message
    # 1 + 10 of the inputs alone, and 100 + 1000 with feedback.
    assert run.stages[0].seconds.replay == 1111.0
    assert run.wall_seconds == run.stages[0].seconds.wall + 1111.0
    assert run.cpu_seconds == run.stages[0].seconds.cpu + 1111.0
    plan, replayed, followed = (
        next(columns for name, columns in files.items() if word in name)
        for word in ("trajectory", "replay", "tracked")
    )
    assert (replayed["q1"].values.tolist(), followed["q1"].values.tolist()) == (
        [5.0] * 3,
        [7.0] * 4,
    )
    assert {name: plan[name].values.tolist() for name in ("t", "q1", "q3", "u1", "u3", "lam_left",
        "lam_right")} == {
        "t": [0.0, 0.01, 0.02], "q1": [0.0, 3.0, 6.0], "q3": [2.0, 5.0, 8.0], "u1": [50.0, 52.0],
        "u3": [51.0, 53.0], "lam_left": [70.0, 72.0], "lam_right": [71.0, 73.0],
    }  # fmt: skip
    assert {plan[name].dimension for name in ("t", "q1")} == {"node"}
    assert {plan[name].dimension for name in ("u1", "lam_left")} == {"step"}
    assert "gap_left" in plan
    assert inside(verdict._repr_html_()) == "<p>a & b 'c'</p>"
    assert drawn[1][0].provenance.command == "touchstone.judge('three_cart', plan)"


@pytest.mark.parametrize(
    "missing", [frozenset({"lam"}), frozenset({"q", "v"}), frozenset({"q", "v", "lam"})]
)
def test_what_a_plan_does_not_say_is_not_drawn(missing: frozenset[str], drawn: list[Any]):
    judged_as(motion(missing=missing), None).page("again")
    ((run, files),) = drawn
    ((_, columns),) = files.items()
    assert ({"lam_left", "lam_right"} <= columns.keys()) is ("lam" not in missing)
    assert ({"q1", "gap_left"} <= columns.keys()) is ("q" not in missing)
    assert ({"q1", "gap_left", "lam_left"} & columns.keys() == set()) is (
        missing == {"q", "v", "lam"}
    )
    assert (run.stages[0].seconds.replay, run.wall_seconds) == (0.0, run.stages[0].seconds.wall)


def test_without_a_plan_and_with_a_replay_of_no_row_nothing_is_drawn(drawn: list[Any]):
    judged_as(None, None).page("again")
    empty = replay_of(np.zeros((0, 3)), "three_cart", 1.0)
    judged_as(None, empty).page("again")
    assert [files for _, files in drawn] == [{}, {}]


FMU = ForeignModel(
    name="some/cart",
    coordinates=(ForeignCoordinate(name="a/b", velocity_name="w", unit="rad", velocity_unit="rad/s",
                                   description="an arm"),
                                   ForeignCoordinate(name="x", velocity_name="v", unit="m",
                                       velocity_unit="m/s"),
                 ForeignCoordinate(name="y", velocity_name="vy")),
    inputs=(ForeignInput(name="F/1", unit="N", description="push"), ForeignInput(name="G")),
    contacts=(ForeignContact(name="left/stop", force_name="pushed", gap_name="room",
                             description="a spring"),
                             ForeignContact(name="wall", force_name="f", gap_name="g")),
    task=ForeignTask(goal=(1.0, None, None, None, None, 2.0), step=0.25,
                     horizon=5.0),
    limits=(Limit(metric="replay_error", value=None, reason="odd"),
            Limit(metric="cost", value=3.0, reason="dear")),
)  # fmt: skip


def test_somebodys_fmu_is_drawn_under_names_that_files_can_have(drawn: list[Any]):
    judged_as(motion(), replay_of(np.full((3, 3), 5.0), "some/cart", 1.0), FMU).page("again")
    ((run, files),) = drawn
    scene = run.scene
    said = [
        [(item.name, item.unit,
          item.description) for item in items] for items in (scene.coordinates,
          scene.velocities[:2], scene.inputs, scene.contacts)
    ]  # fmt: skip
    assert said == [
        [("a_b", "rad", "an arm"), ("x", "m", ""), ("y", "1", "")],
        [("w", "rad/s", "velocity of a_b"), ("v", "m/s", "velocity of x")],
        [("F_1", "N", "push"), ("G", "1", "")],
        [("left_stop", "N/m", "a spring"), ("wall", "N/m", "")],
    ]  # fmt: skip
    assert (scene.name, scene.step, scene.steps, scene.goal, scene.waived) == (
        "some/cart",
        0.25,
        2,
        FMU.task.goal,
        ("replay_error: odd",),
    )
    assert scene.start == (0.0, 1.0, 2.0, 1.0, 1.0, 1.0)
    plan, replayed = (
        next(columns for name, columns in files.items() if word in name)
        for word in ("trajectory", "replay")
    )
    assert list(plan) == ["t", "a_b", "x", "y", "F_1", "G", "lam_left_stop", "lam_wall"]
    assert {"lam_left_stop", "gap_left_stop", "lam_wall"} <= replayed.keys()
    judged_as(None, None, FMU).page("again")
    assert (drawn[1][0].scene.start, drawn[1][0].scene.steps) == ((), 0)


def test_a_judgement_is_one_line_of_cost_and_replay_error():
    verdict = judged_as(None, None, SCENE, REACHED, PRICED, name="plan.csv")
    assert (
        repr(verdict)
        == "Judgement(three_cart, plan.csv: violates, cost 1.235e+04, replay error 0.25 m)"
    )
    assert str(verdict) == "violates: because"
    bare = judged_as(None, None, SCENE, replace(REACHED, value=None))
    assert repr(bare) == "Judgement(three_cart, plan: violates)"


@pytest.mark.parametrize(
    ("plan", "name"),
    [
        (Path("a/b/mine.csv"), "mine.csv"),
        ("c/yours.nc", "yours.nc"),
        ({"t": 1}, "plan"),
        (None, "plan"),
    ],
)
def test_a_judgement_is_called_as_its_plan_is(plan: Any, name: str):
    given = Judgement(
        scene=SCENE, plan=None, replay=None, score=Score(metrics=(), verdict=Verdict.HOLDS, why=".")
    )
    found = JudgedPlan.of(given, plan)
    assert (found.name, found.solution, found.scene, found.verdict) == (
        name,
        None,
        SCENE,
        Verdict.HOLDS,
    )
    solved = SolvedPlan.of(
        Solution(method="softplus_dc", outcome=ts.Outcome.SOLVED), SCENE, "softplus_dc", 1e-3
    )
    assert (JudgedPlan.of(given, solved).name, JudgedPlan.of(given, solved).solution) == (
        "softplus_dc, eps 0.001",
        solved,
    )


def test_metrics_are_a_table(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(shown, "data_frame", lambda columns: columns)
    table: Any = judged_as(None, None, SCENE, REACHED, PRICED).to_dataframe()
    assert table == {
        "question": [4, 2], "metric": ["replay_error", "cost"], "value": [0.25, 12345.678],
        "error": [0.125, 0.0], "unit": ["m", "1"], "limit": [0.5, None],
        "ok": [True, None], "meaning": ["far", "dear"], "reason": ["near", ""],
    }  # fmt: skip


def test_a_plot_is_beside_the_replay_that_the_verdict_is_of(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Trajectory, "plot", lambda self, scene, replay=None: (scene, replay))
    tracked = replay_of(np.zeros((3, 3)), "three_cart", 1.0)
    opened = replay_of(np.zeros((3, 3)), "three_cart", 1.0, tracked=tracked)
    assert judged_as(motion(), opened).plot() == (SCENE, opened)
    assert judged_as(motion(), opened, judged="feedback").plot() == (SCENE, tracked)
    assert judged_as(motion(), None, judged="feedback").plot() == (SCENE, None)
    solved = SolvedPlan.of(
        Solution(method="softplus_dc", outcome=ts.Outcome.SOLVED, trajectory=motion()), SCENE, "p"
    )
    assert solved.plot() == (SCENE, None)
    with pytest.raises(TrajectoryError, match=r"p on three_cart: no plan.* too hard"):
        replace(solved, trajectory=None, message="too hard").plot()
    with pytest.raises(TrajectoryError, match=r"x on three_cart: .*no plan to draw"):
        judged_as(None, None, name="x").plot()


@pytest.mark.slow
def test_a_solution_is_shown_with_its_method_and_that_nobody_judged_it(drawn: list[Any]):
    solved = SolvedPlan.of(
        Solution(method="softplus_dc", outcome=ts.Outcome.SOLVED, trajectory=motion(),
                 cost=12.345678, seconds=Seconds(wall=3.0, cpu=2.0)), SCENE,
        "softplus_dc", 1e-3,
    )  # fmt: skip
    assert (
        repr(solved)
        == "Solution(three_cart by softplus_dc, eps 0.001: solved, cost 12.35, 2 steps)"
    )
    assert (
        repr(replace(solved, trajectory=None, cost=None, eps=None, outcome=ts.Outcome.TIME_LIMIT))
        == "Solution(three_cart by softplus_dc: time limit, no plan)"
    )
    solved._repr_html_()
    replace(solved, eps=None)._repr_html_()
    (run, files), (other, _) = drawn
    assert (run.provenance.command, other.provenance.command) == (
        "touchstone.solve('three_cart', 'softplus_dc', eps=0.001)",
        "touchstone.solve('three_cart', 'softplus_dc')",
    )
    assert (run.pipeline, run.must_hold, run.stages[0].kind, run.stages[0].method,
            run.stages[0].eps) == (
        "softplus_dc, eps 0.001", False, "indirect", "softplus_dc", 1e-3,
    )  # fmt: skip
    assert run.pipeline_title == run.stages[0].method_title != ""
    assert (len(files), run.stages[0].seconds.wall, run.stages[0].seconds.cpu) == (
        1,
        3.0,
        2.0,
    )
    assert "nobody judged it yet" in str(run.stages[0])
    exact = JudgedPlan.of(Judgement(scene=SCENE, plan=motion(),
                                    replay=replay_of(np.zeros((3, 3)), "three_cart", 1.0),
                                    score=Score(metrics=(), verdict=Verdict.HOLDS, why=".")),
                                    replace(solved, method="strict_lcp"))  # fmt: skip
    exact.page("again")
    assert (drawn[2][0].must_hold, drawn[2][0].stages[0].seconds.replay, drawn[2][0].pipeline) == (
        True,
        11.0,
        "softplus_dc, eps 0.001",
    )


def test_the_room_hands_out_its_judge_alone():
    from validate import judge

    assert judge.judge is judgement.judge
    with pytest.raises(AttributeError, match=r"'validate\.judge' has no attribute 'jury'"):
        judge.jury  # noqa: B018

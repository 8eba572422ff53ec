"""What a notebook shows of a plan that was solved or judged: one line, a page in a frame, a plot, a table."""

from __future__ import annotations

import html
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import touchstone as ts
from formulations.solution import Solution
from models.errors import MachineError, TrajectoryError

SMALL = 150_000


@pytest.fixture(scope="module")
def plan() -> ts.Solution:
    return ts.solve("three_cart", "softplus_dc", eps=1e-3)


@pytest.fixture(scope="module")
def verdict(plan: ts.Solution) -> ts.Judgement:
    return ts.judge(plan.scene, plan)


def inside(shown: str) -> str:
    """The page in the frame, as a browser reads the attribute."""
    found = re.fullmatch(r"<iframe srcdoc='([^']*)' [^>]*></iframe>", shown)
    assert found is not None
    return html.unescape(found[1])


@pytest.mark.slow
def test_each_is_one_line_with_scene_and_pipeline(plan: ts.Solution, verdict: ts.Judgement):
    assert isinstance(plan, ts.Solution)
    assert isinstance(plan, Solution)
    assert repr(plan) == f"Solution(three_cart by softplus_dc, eps 0.001: solved, cost {plan.cost:.4g}, 500 steps)"
    error = verdict.score.value("replay_error")
    assert repr(verdict) == f"Judgement(three_cart, softplus_dc, eps 0.001: violates, cost {plan.cost:.4g}, replay error {error:.4g} m)"
    assert str(verdict) == f"violates: {verdict.score.why}"
    lost = replace(plan, trajectory=None, cost=None, outcome=ts.Outcome.TIME_LIMIT)
    assert repr(lost) == "Solution(three_cart by softplus_dc, eps 0.001: time limit, no plan)"
    assert repr(ts.judge(plan.scene, lost)) == "Judgement(three_cart, softplus_dc, eps 0.001: no plan)"


@pytest.mark.slow
def test_the_frame_holds_verdict_player_and_figures_and_is_small(plan: ts.Solution, verdict: ts.Judgement):
    shown = verdict._repr_html_()
    page = inside(shown)
    assert len(shown.encode()) <= SMALL
    for part in ("softplus_dc, eps 0.001 on three_cart", "violates", "<canvas", "Positions: plan dotted, replay solid", "ghost_impulse"):
        assert part in page, part
    assert "sandbox=" in shown
    assert not re.search(r"""(src|href)=["'](?!#)""", page), "nothing is loaded from elsewhere"
    assert "primal infeasibility" not in page, "the frame leaves out what is in the objects"
    assert "primal infeasibility" in verdict.page("again"), "which the whole page has"
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
def test_its_tables(plan: ts.Solution, verdict: ts.Judgement):
    table, metrics = plan.to_dataframe(), verdict.to_dataframe()
    assert plan.trajectory is not None
    assert np.array_equal(table[["q1", "q2", "q3"]], plan.trajectory.q)
    assert list(metrics) == ["question", "metric", "value", "error", "unit", "limit", "ok", "meaning", "reason"]
    assert list(metrics.metric) == [metric.name for metric in verdict.score.metrics]
    row = metrics.set_index("metric").loc["replay_error"]
    assert (row.value, row.ok) == (verdict.score.value("replay_error"), False)


@pytest.mark.slow
def test_plots_draw_the_plan_and_its_replay(plan: ts.Solution, verdict: ts.Judgement, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("matplotlib").use("Agg")
    from matplotlib import pyplot

    assert plan.trajectory is not None
    assert verdict.replay is not None
    alone, both = plan.plot(), verdict.plot()
    assert [axis.get_ylabel() for axis in alone] == ["position [m]", "velocity [m/s]", "force [N]", "input [N]"]
    assert [line.get_label() for line in alone[0].lines] == ["q1", "q2", "q3"]
    assert [line.get_label() for line in both[0].lines][:2] == ["q1, plan", "q1, replay"]
    assert np.array_equal(both[0].lines[1].get_ydata(), verdict.replay.q[:, 0])
    held = alone[3].lines[0]
    assert (held.get_drawstyle(), len(held.get_ydata())) == ("steps-post", 501)
    assert held.get_ydata()[-1] == plan.trajectory.u[-1, 0]
    inputs = ts.judge("three_cart", {"t": plan.trajectory.t, "u1": plan.trajectory.u[:, 0], "u3": plan.trajectory.u[:, 1]})
    assert [line.get_label() for line in inputs.plot()[0].lines] == ["q1, replay", "q2, replay", "q3, replay"], "it says no positions"
    ramp = replace(plan.trajectory, hold="linear", scheme=None, u_end=[7.0, 8.0])
    assert ramp.plot(plan.scene)[3].lines[1].get_ydata()[-1] == 8.0
    pyplot.close("all")


@pytest.mark.slow
@pytest.mark.parametrize(("package", "call"), [("matplotlib", "plot"), ("pandas", "to_dataframe")])
def test_without_the_extra_one_sentence_says_what_to_install(
    package: str, call: str, plan: ts.Solution, verdict: ts.Judgement, monkeypatch: pytest.MonkeyPatch
):
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    for shown in (plan, verdict):
        with pytest.raises(MachineError, match=rf"{package}, which is not installed; pip install matplotlib pandas"):
            getattr(shown, call)()


@pytest.mark.slow
def test_without_a_plan_it_says_why(plan: ts.Solution):
    lost = replace(plan, trajectory=None, outcome=ts.Outcome.INFEASIBLE, message="")
    for call in (lost.plot, lost.to_dataframe):
        with pytest.raises(TrajectoryError, match=r"softplus_dc, eps 0.001 on three_cart: no plan was found\. No plan satisfies"):
            call()
    verdict = ts.judge(plan.scene, lost)
    with pytest.raises(TrajectoryError, match="there is no plan to draw"):
        verdict.plot()
    assert "no plan" in inside(verdict._repr_html_())


def test_times_alone_cannot_be_drawn():
    scene = ts.scene("bouncing_mass")
    steps = np.linspace(0.0, 1.0, 11)
    plan = ts.Trajectory(
        t=steps, q=np.zeros((11, 1)), v=np.zeros((11, 1)), u=np.zeros((10, 0)), lam=np.zeros((10, 1)), missing={"q", "v", "lam"}
    )
    with pytest.raises(TrajectoryError, match="nothing but times of scene bouncing_mass"):
        plan.plot(scene)

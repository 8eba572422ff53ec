"""The rule of a campaign, case by case, on records."""

from __future__ import annotations

import html
import re
from pathlib import Path

import pytest

from reports.record import MetricRecord, ReplayRecord
from reports.render import write_report
from reports.rule import RESULTS, RULE, failures, findings


def words_of(folder: Path) -> str:
    """The text of a campaign's report."""
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", write_report(folder).read_text(encoding="utf-8"))).split())


def ended(factory, outcome: str, verdict: str, *, scene: str = "bank", direct: bool = True, paper: bool = False, pipeline: str = "strict"):
    run = factory.run(pipeline, None, "strict_lcp", outcome=outcome, verdict=verdict, must_hold=direct, message="a reason.")
    place = run.scene.model_copy(update={"name": scene})
    last = run.stages[-1].model_copy(update={"outcome": outcome, "verdict": verdict, "why": "a limit", **({} if paper else {"paper": {}})})
    return run.model_copy(update={"scene": place, "stages": (*run.stages[:-1], last)})


def test_a_sound_campaign_does_not_fail(factory):
    assert failures([ended(factory, "solved", "holds"), ended(factory, "solved", "violates", direct=False)]) == ()
    assert failures([]) == ()


@pytest.mark.parametrize("outcome", ["crashed", "failed"])
@pytest.mark.parametrize("direct", [True, False])
def test_a_crash_fails_whatever_the_method(factory, outcome: str, direct: bool):
    good = ended(factory, "solved", "holds")
    assert failures([good, ended(factory, outcome, "no plan", direct=direct)]) == (f"bank x strict: {outcome} - a reason.",)


@pytest.mark.parametrize("verdict", ["violates", "not resolved"])
def test_a_direct_method_that_says_solved_must_hold(factory, verdict: str):
    good = ended(factory, "solved", "holds")
    assert failures([good, ended(factory, "solved", verdict)]) == (f"bank x strict: {verdict} - a limit",)
    assert failures([good, ended(factory, "solved", verdict, direct=False)]) == ()


@pytest.mark.parametrize("outcome", ["iteration_limit", "time_limit", "stalled", "diverged", "infeasible", "refused"])
@pytest.mark.parametrize("verdict", ["violates", "not resolved", "no plan"])
def test_an_honest_ending_is_a_result(factory, outcome: str, verdict: str):
    assert failures([ended(factory, "solved", "holds"), ended(factory, outcome, verdict)]) == ()


def test_a_row_of_the_paper_must_hold_however_it_ended(factory):
    good = ended(factory, "solved", "holds")
    assert failures([good, ended(factory, "iteration_limit", "violates", paper=True)]) == ("bank x strict: violates - a limit",)
    assert failures([good, ended(factory, "stalled", "no plan", paper=True)]) == ("bank x strict: no plan (stalled) - a reason.",)


def test_a_scene_needs_a_cell_that_holds_once_a_direct_method_ran(factory):
    stuck = ended(factory, "iteration_limit", "violates")
    relaxed = ended(factory, "solved", "violates", direct=False, pipeline="softplus_dc")
    assert failures([stuck, relaxed]) == ("bank: no cell holds (strict iteration limit, violates)",)
    assert failures([relaxed]) == (), "nothing direct was selected"
    assert failures([ended(factory, "refused", "no plan"), relaxed]) == (), "nothing direct ran"
    assert failures([stuck, ended(factory, "solved", "holds", direct=False)]) == ()
    elsewhere = ended(factory, "solved", "holds", scene="other")
    assert failures([stuck, elsewhere]) == ("bank: no cell holds (strict iteration limit, violates)",), "another scene does not help"


def judged(run, above: tuple[str, ...], *, replay: str = "tracked"):
    """The run, whose last plan is above these limits, by this replay."""
    figures = tuple(
        MetricRecord(name=name, value=2.0 if name in above else 0.5, unit="m", meaning="m", limit=1.0, ok=name not in above)
        for name in ("defect", "physics_scaled", "discrete_terminal_error", "replay_error", "tracked_replay_error", "feedback_effort")
    )
    last = run.stages[-1].model_copy(update={"figures": figures, "replay": ReplayRecord(error_estimate=1e-9, judged=replay)})
    return run.model_copy(update={"stages": (*run.stages[:-1], last)})


def test_a_solution_that_only_the_feedback_cannot_hold_is_a_finding(factory):
    good, bad = ended(factory, "solved", "holds"), ended(factory, "solved", "violates")
    lost = judged(bad, ("tracked_replay_error", "feedback_effort"))
    assert failures([good, lost]) == ()
    assert findings([good, lost]) == ("bank x strict: a limit",)
    assert failures([lost]) == ("bank: no cell holds (strict solved, violates)",), "a scene still needs a plan that holds"


@pytest.mark.parametrize("above", ["defect", "physics_scaled", "discrete_terminal_error"])
def test_a_broken_promise_of_the_method_is_no_finding(factory, above: str):
    run = judged(ended(factory, "solved", "violates"), (above, "tracked_replay_error"))
    assert failures([ended(factory, "solved", "holds"), run]) == ("bank x strict: violates - a limit",)
    assert findings([run]) == ()


@pytest.mark.parametrize("unknown", ["defect", "physics_scaled", "discrete_terminal_error"])
def test_what_could_not_be_measured_is_no_kept_promise(factory, unknown: str):
    """The rollout of a plan that diverges is too large to be a number: it is not below its limit."""
    run = judged(ended(factory, "solved", "violates"), ("tracked_replay_error",))
    last = run.stages[-1]
    figures = tuple(
        figure.model_copy(update={"value": None, "ok": None, "resolved": False}) if figure.name == unknown else figure
        for figure in last.metrics
    )
    run = run.model_copy(update={"stages": (*run.stages[:-1], last.model_copy(update={"figures": figures}))})
    assert failures([ended(factory, "solved", "holds"), run]) == ("bank x strict: violates - a limit",)
    assert findings([run]) == ()


def test_where_errors_do_not_grow_a_solution_must_stay_near_the_motion(factory):
    good, bad = ended(factory, "solved", "holds"), ended(factory, "solved", "violates")
    stray = judged(bad, ("replay_error",), replay="open")
    assert failures([good, stray]) == ("bank x strict: violates - a limit",)
    assert findings([stray]) == ()


def test_neither_a_row_of_the_paper_nor_an_open_question_nor_an_early_end_is_a_finding(factory):
    above = ("tracked_replay_error",)
    paper = judged(ended(factory, "solved", "violates", paper=True), above)
    assert findings([paper]) == ()
    assert failures([ended(factory, "solved", "holds"), paper]) == ("bank x strict: violates - a limit",)
    assert findings([judged(ended(factory, "solved", "not resolved"), ())]) == ()
    assert findings([judged(ended(factory, "stalled", "violates"), above)]) == ()


def test_the_summary_names_what_was_found(factory, tmp_path):
    run = judged(ended(factory, "solved", "violates"), ("tracked_replay_error",))
    words = words_of(factory.store(tmp_path, [run]))
    assert "Found by the replay: bank x strict: a limit." in words


def test_the_summary_says_the_rule_and_its_verdict_in_these_words(factory, tmp_path):
    good = words_of(factory.store(tmp_path / "good", [factory.run("strict", None, "strict_lcp")]))
    assert "The campaign does not fail." in good
    assert all(sentence in good for sentence in (*RULE, *RESULTS))
    bad = words_of(factory.store(tmp_path / "bad", [ended(factory, "crashed", "no plan")]))
    assert "The campaign fails: bank x strict: crashed - a reason." in bad

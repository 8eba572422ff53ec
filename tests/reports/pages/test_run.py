"""All runs in a table, and what is told of one: why it has its verdict, its metrics stage by stage, and both of its ends; all runs as one table, and the head of a run's page: the verdict with what decided it."""

import html
import os
import re
from dataclasses import replace
from hashlib import sha256

import pytest
from wording import unsaid

from models.results.run import RunRecord, TrackedRecord
from models.results.verdict import Question
from reports.load import Stored
from reports.pages import run as one_run
from reports.pages.run import decision_of, not_applicable, view_of
from reports.pages.section import Report, run_pages
from reports.render import PAGES, write_report
from tests.reports import record_factory as factory
from tests.reports.record_factory import judged, ran


def report(*records: RunRecord, single: bool = False) -> Report:
    return Report(Stored(None, records), single=single)


def test_every_run_is_a_row_with_the_numbers_of_its_last_stage():
    metrics = (
        judged("replay_terminal_position_error", 0.1),
        judged("replay_terminal_velocity_error", 0.2),
        judged("replay_error", 0.3),
    )
    told = report(
        ran("a", *metrics, cost=490.0, cpu=3.0),
        replace(ran("b", cost=None, verdict="not applicable"), stages=(), message="x: too many."),
    )
    found = one_run.all_runs(told)
    first, second = found.values["listed"]
    assert (first.run.cost, first.run.integral_cost, first.run.solving_cpu) == (
        490.0,
        pytest.approx(4.9),
        3.0,
    )
    assert ([item.value for item in first.errors], first.why, first.link, first.anchor) == (
        [0.1, 0.2, 0.3],
        "",
        "pages/three_cart--a.html",
        "run-1",
    )
    assert (second.run.cost, second.run.integral_cost, second.run.solving_cpu, second.errors) == (
        None,
        None,
        0,
        [None] * 3,
    )
    assert (second.why, second.anchor, second.view) == ("Too many.", "run-2", None)
    assert not unsaid(found.said, "2 runs … 1 of which holds")
    assert found.entries == ()
    assert "0 of which hold:" in one_run.all_runs(report(ran("a", verdict="violates"))).said
    single = report(
        ran("a", of=factory.scene("hill")),
        ran("b", of=factory.scene("bank")),
        ran("c", of=factory.scene("hill")),
        single=True,
    )
    assert one_run.all_runs(single).entries == (("run-1", "hill"), ("run-2", "bank"))
    assert one_run.all_runs(single).values["listed"][0].view is not None
    assert one_run.all_runs(report()) is None


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ("strict: scene three_cart has no inputs; see there", "The scene has no inputs"),
        ("a word: it does not apply", "A word: it does not apply"),
        ("it does not apply", "It does not apply"),
        ("strict: scene hill has none", "Scene hill has none"),
    ],
)  # fmt: skip
def test_why_a_run_does_not_apply(message: str, said: str):
    assert not_applicable(replace(ran("a", verdict="not applicable"), message=message)) == said
    assert not_applicable(replace(ran("a", verdict="holds"), message=message)) == ""


def test_why_a_run_has_its_verdict():
    bad = judged("physics_scaled", 2.0, question=Question.FORCES, limit=1.0, ok=False)
    answers = factory.questions(q3="no")
    run = ran(
        "a",
        bad,
        cost=490.0,
        verdict="violates",
        cause="physics_scaled",
        why="it is too much.",
        advice="Do this.",
        questions=answers,
    )
    found = decision_of(run)
    assert (found.question[0].number, found.metric) == (3, bad)
    assert not unsaid(found.cause, "The planned forces are not those of contact. It is too much.")
    assert not unsaid(found.advice, "Tighten the solver's tolerance")
    good = decision_of(
        replace(
            ran(
                "a", judged("x", 0.5, question=Question.GOAL, limit=1.0, ok=True), cost=None, why=""
            ),
            message="never told",
        )
    )
    assert (good.cause, good.advice) == ("", "")
    lost = decision_of(
        replace(ran("a", verdict="no plan", why="",
            outcome="crashed"), stages=(), outcome="crashed", message="it is gone."),
    )  # fmt: skip
    assert (lost.question, lost.metric, lost.cause, lost.ends) == (
        None,
        None,
        "No plan: crashed. It is gone.",
        "",
    )


def test_judged_metrics_of_all_stages_stand_side_by_side():
    first = ran(
        "a", judged("b", 1.0, question=Question.POSSIBLE, limit=3.0),
        judged("tracked_b", 9.0, question=Question.POSSIBLE, limit=3.0), judged("feedback_effort", 2.0, limit=1.0),
        judged("shown", 4.0),
    ).stages[0]  # fmt: skip
    second = ran(
        "a",
        judged("b", 2.0, question=Question.POSSIBLE, limit=4.0),
        judged("c", 7.0, limit=1.0),
        judged("d", 8.0, question=Question.TASK, limit=1.0),
        eps=1e-3,
    ).stages[0]
    run = replace(ran("a"), stages=(first, replace(second, index=1)))
    view = view_of(report(run), run)
    assert [
        (metric.name, [item and item.value for item in found]) for metric, found in view.beside
    ] == [
        ("d", [None, 8.0]),
        ("b", [1.0, 2.0]),
        ("c", [None, 7.0]),
    ]
    assert view.beside[1][0].limit == 4.0, "the limit of the last"
    assert view_of(report(run), ran("a", judged("b", 1.0, limit=3.0))).beside == []
    assert one_run.build(report(run), run).entries == (
        ("run-stage-1", "a"),
        ("run-stage-2", "a, ε = 10⁻³"),
    )


def test_both_ends_are_told_where_there_is_feedback():
    metrics = (
        judged("replay_terminal_position_error", 0.5),
        judged("tracked_replay_terminal_position_error", 0.25),
    )
    run = ran("a", *metrics)
    assert [stage.ends for stage in view_of(report(run), run).stages] == [
        [("replay", "position 0.50 m")]
    ]
    (one,) = run.stages
    replay = replace(one.replay, tracked=TrackedRecord(error_estimate=1e-9), judged="feedback")
    followed = replace(run, stages=(replace(one, replay=replay),))
    (view,) = view_of(report(followed), followed).stages
    assert view.ends == [("inputs alone", "position 0.50 m"), ("with feedback", "position 0.25 m")]
    assert (view.stage.is_tracked, view.stage.is_followed, view.stage.is_empty, view.idle) == (
        True,
        True,
        False,
        False,
    )
    bare = {"has_plan": False, "replay": None, "iterations": 0}
    seconds = replace(one.seconds, wall=0.0)
    for changes, idle in (
        (bare, False),
        (bare | {"seconds": seconds}, True),
        (bare | {"seconds": seconds, "iterations": 1}, False),
        ({"kind": "given"}, True),
        ({"seconds": seconds, "iterations": 0}, False),
    ):
        lost = (
            ran("a", **changes)
            if "seconds" not in changes
            else replace(
                ran("a"),
                stages=(
                    replace(one, **(changes | ({"metrics": ()} if "replay" in changes else {}))),
                ),
            )
        )
        assert view_of(report(lost), lost).stages[0].idle == idle, changes


def words(text: str) -> str:
    return " ".join(
        html.unescape(
            re.sub(r"<(style|script)[^>]*>.*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL)
        ).split()
    )


def rows_of(folder) -> list[list[str]]:
    write_report(folder)
    table = re.search(
        r'<table class="numbers close runs".*?</table>',
        (folder / PAGES / "runs.html").read_text(encoding="utf-8"),
        re.DOTALL,
    )
    assert table is not None
    return [
        [words(cell) for cell in re.findall(r"<t[hd].*?</t[hd]>", row, re.DOTALL)]
        for row in re.findall(r"<tr[^>]*>.*?</tr>", table[0], re.DOTALL)
    ]


def test_a_row_has_errors_apart_with_units_and_the_integral_cost(factory, tmp_path):
    refused = factory.run(
        "refused", None, "strict_lcp", key="no-0", stages=(), outcome="refused",
        verdict="not applicable",
        message="strict_lcp: scene three_cart has no wall.",
    )  # fmt: skip
    head, row, other = rows_of(factory.store(tmp_path / "all", [factory.runs()[0], refused]))
    assert head[3:5] == ["Cost", "Integral cost"]
    # 496.63 times 0.01 s; 4.1e-3 off, 0.8 of it in position and 0.6 in velocity.
    assert row == [
        "three_cart",
        "strict",
        "✓ holds",
        "496.63",
        "4.9663",
        "0.0033 m",
        "0.0025 m/s",
        "0.0090 m",
        "0.71",
        "",
    ]
    assert other[:3] == ["three_cart", "refused", "⊘ not applicable"]
    assert other[-1] == "The scene has no wall."


def test_the_page_of_a_run_begins_with_its_verdict(factory, tmp_path):
    run = factory.run(
        "strict",
        None,
        "strict_lcp",
        verdict="violates",
        outcome="stalled",
        message="No step lowers the loss.",
    )
    (stage,) = run.stages
    metrics = tuple(
        replace(item, value=0.12, ok=False)
        if item.name == "replay_terminal_position_error"
        else item
        for item in stage.metrics
    )
    said = {
        "metrics": metrics, "verdict": "violates", "outcome": "stalled",
        "questions": factory.questions(q4="no"),
        "why": "the motion ends 0.12 m from the goal.", "cause": "motion",
    }  # fmt: skip
    run = replace(run, stages=(replace(stage, **said),))
    decision = decision_of(run)
    assert (decision.question[0].number, decision.metric.name, decision.metric.value) == (
        4,
        "replay_terminal_position_error",
        0.12,
    )
    folder = factory.store(tmp_path / "all", [run])
    write_report(folder)
    text = words((folder / PAGES / run_pages([run])[run.key]).read_text(encoding="utf-8"))
    order = [
        "strict on three_cart ✗ violates",
        "Question 4. Do its inputs give its motion, and the goal? ✗ no",
        "Decided by replay_terminal_position_error : 0.12 m ± 3.0×10⁻⁹, limit 0.06 m.",
        "Cause The inputs do not give the planned motion. The motion ends 0.12 m from the goal.",
        "Advice Look at the error over time",
        "Cost 496.63, a sum over 500 steps; integral cost (times h = 0.01 s) 4.9663",
        "Keys: space plays and pauses",
        "Positions: plan dotted", "Made by touchstone 0.1.0, commit aaaaaaaaaaaa",
        "Run it again python -m validate all -k",
    ]  # fmt: skip
    places = [text.find(part) for part in order]
    assert -1 not in places, order[places.index(-1)]
    assert places == sorted(places)
    assert text.count("ends 0.12 m from the goal") == 1, "what decided is told once"


def test_run_pages_names_are_readable_and_unique(factory):
    def ran(pipeline: str, key: str, **changes: object) -> RunRecord:
        run = factory.run(pipeline, None, "strict_lcp")
        return replace(run, **{"key": key, **changes})

    runs = [
        ran("softplus_dc+strict", "a"),
        ran("a b/c", "b"),
        ran("../☃", "c"),
        ran("twice", "d"),
        ran("Twice", "e"),
        ran("refused", "f", verdict="not applicable"),
    ]
    names = run_pages(runs)
    assert [names.get(key) for key in "abc"] == [
        "three_cart--softplus_dc-strict.html",
        "three_cart--a-b-c.html",
        "three_cart--unnamed.html",
    ]
    assert names["d"] == f"three_cart--twice-{sha256(b'd').hexdigest()[:8]}.html"
    assert names["e"] == f"three_cart--Twice-{sha256(b'e').hexdigest()[:8]}.html"
    assert "f" not in names


def test_a_run_without_a_page_has_a_row_that_links_lead_to(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    refused = factory.run("mpcc", None, "strict_lcp", key="r", stages=(), verdict="not applicable")
    assert report(run, refused).link(refused) == "pages/runs.html#run-2"
    folder = factory.store(tmp_path / "all", [run, refused])
    write_report(folder)
    text = (folder / PAGES / "runs.html").read_text(encoding="utf-8")
    assert '<tr id="run-2"><td>three_cart</td><th scope="row">mpcc</th>' in text
    assert len(list((folder / PAGES).glob("*--*.html"))) == 1


def test_a_page_of_an_earlier_run_of_its_name_is_written_again(factory, tmp_path):
    """Both records are older than the page, as after a change and its reversal."""
    folder = tmp_path / "all"
    run = factory.run("strict", None, "strict_lcp")
    texts = []
    for key in ("one", "two"):
        factory.store(folder, [replace(run, key=key)])
        for path in (folder / "runs" / key, folder / "runs" / key / "record.json"):
            os.utime(path, (1, 1))
        write_report(folder)
        texts.append((folder / PAGES / "three_cart--strict.html").read_text(encoding="utf-8"))
    assert ["<code>one</code>" in texts[0], "<code>two</code>" in texts[1]] == [True, True]


def test_a_metric_that_could_not_be_measured_decides_with_its_reason(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp", verdict="undecided")
    (stage,) = run.stages
    lost = replace(
        stage.metrics[-2], value=None, ok=None, default=False, reason="the replay left every bound"
    )
    run = replace(run, stages=(replace(stage, metrics=(lost,), verdict="undecided"),))
    folder = factory.store(tmp_path / "all", [run])
    write_report(folder)
    assert not unsaid(
        words((folder / PAGES / run_pages([run])[run.key]).read_text(encoding="utf-8")),
        "Decided by replay_error : … 0.02 m.",
    )

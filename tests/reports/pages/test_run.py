"""All runs in a table, and what is told of one: why it has its verdict, its metrics stage by stage, and both of its ends."""

import pytest
from wording import unsaid

from reports.pages import run as one_run
from reports.pages import runs
from reports.pages.run import decision_of, not_applicable, view_of
from reports.pages.section import Report
from reports.records.load import Stored
from reports.records.record import RunRecord, TrackedRecord
from tests.reports import record_factory as factory
from tests.reports.record_factory import judged, ran


def report(*records: RunRecord, single: bool = False) -> Report:
    return Report(Stored("x", None, records, (), (), 0), single=single)


def test_every_run_is_a_row_with_the_numbers_of_its_last_stage():
    metrics = (judged("replay_terminal_position_error", 0.1), judged("replay_terminal_velocity_error", 0.2), judged("replay_error", 0.3))
    told = report(
        ran("a", *metrics, cost=490.0, cpu=3.0),
        ran("b", cost=None, verdict="not applicable").model_copy(update={"stages": (), "message": "x: too many."}),
    )
    found = runs.build(told)
    first, second = found.values["listed"]
    assert (first.run.cost, first.run.integral_cost, first.run.solving_cpu) == (490.0, pytest.approx(4.9), 3.0)
    assert ([item.value for item in first.errors], first.why, first.link, first.anchor) == (
        [0.1, 0.2, 0.3],
        "",
        "pages/a-key.html",
        "run-1",
    )
    assert (second.run.cost, second.run.integral_cost, second.run.solving_cpu, second.errors) == (None, None, 0, [None] * 3)
    assert (second.why, second.anchor, second.view) == ("Too many.", "run-2", None)
    assert not unsaid(found.said, "2 runs … 1 of which holds")
    assert found.entries == ()
    assert "0 of which hold:" in runs.build(report(ran("a", verdict="violates"))).said
    single = report(ran("a", of=factory.scene("hill")), ran("b", of=factory.scene("bank")), ran("c", of=factory.scene("hill")), single=True)
    assert runs.build(single).entries == (("run-1", "hill"), ("run-2", "bank"))
    assert runs.build(single).values["listed"][0].view is not None
    assert runs.build(report()) is None


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ("strict: scene three_cart has no inputs; see there", "The scene has no inputs"), ("a word: it does not apply", "A word: it does not apply"),
        ("it does not apply", "It does not apply"), ("strict: scene hill has none", "Scene hill has none"),
    ],
)  # fmt: skip
def test_why_a_run_does_not_apply(message: str, said: str):
    assert not_applicable(ran("a", verdict="not applicable").model_copy(update={"message": message})) == said
    assert not_applicable(ran("a", verdict="holds").model_copy(update={"message": message})) == ""


def test_why_a_run_has_its_verdict():
    bad = judged("physics_scaled", 2.0, question=3, limit=1.0, ok=False)
    answers = factory.questions(q3="no")
    run = ran("a", bad, cost=490.0, verdict="violates", cause="physics_scaled", why="it is too much.", advice="Do this.", questions=answers)
    found = decision_of(run)
    assert (found.question.number, found.metric) == (3, bad)
    assert not unsaid(found.cause, "Relaxed contact: … not those of contact. It is too much.")
    assert not unsaid(found.advice, "Tighten eps, … (strict, mpcc)")
    good = decision_of(
        ran("a", judged("x", 0.5, question=2, limit=1.0, ok=True), cost=None, why="").model_copy(update={"message": "never told"})
    )
    assert (good.cause, good.advice) == ("", "")
    lost = decision_of(
        ran("a", verdict="no plan", why="", outcome="crashed").model_copy(
            update={"stages": (), "outcome": "crashed", "message": "it is gone."}
        )
    )
    assert (lost.question, lost.metric, lost.cause, lost.ends) == (None, None, "No plan: crashed. It is gone.", "")


def test_judged_metrics_of_all_stages_stand_side_by_side():
    first = ran(
        "a",
        judged("b", 1.0, question=5, limit=3.0),
        judged("tracked_b", 9.0, question=5, limit=3.0),
        judged("feedback_effort", 2.0, limit=1.0),
        judged("shown", 4.0),
    ).stages[0]
    second = ran(
        "a", judged("b", 2.0, question=5, limit=4.0), judged("c", 7.0, limit=1.0), judged("d", 8.0, question=1, limit=1.0), eps=1e-3
    ).stages[0]
    run = ran("a").model_copy(update={"stages": (first, second.model_copy(update={"index": 1}))})
    view = view_of(report(run), run)
    assert [(row.metric.name, [item and item.value for item in row.found]) for row in view.beside] == [
        ("d", [None, 8.0]),
        ("b", [1.0, 2.0]),
        ("c", [None, 7.0]),
    ]
    assert view.beside[1].metric.limit == 4.0, "the limit of the last"
    assert view_of(report(run), ran("a", judged("b", 1.0, limit=3.0))).beside == []
    assert one_run.build(report(run), run).entries == (("run-stage-1", "a"), ("run-stage-2", "a, ε = 10⁻³"))


def test_both_ends_are_told_where_there_is_feedback():
    metrics = (judged("replay_terminal_position_error", 0.5), judged("tracked_replay_terminal_position_error", 0.25))
    run = ran("a", *metrics)
    assert [stage.ends for stage in view_of(report(run), run).stages] == [[("replay", "position 0.50 m")]]
    (one,) = run.stages
    replay = one.replay.model_copy(update={"tracked": TrackedRecord(error_estimate=1e-9), "judged": "feedback"})
    followed = run.model_copy(update={"stages": (one.model_copy(update={"replay": replay}),)})
    (view,) = view_of(report(followed), followed).stages
    assert view.ends == [("inputs alone", "position 0.50 m"), ("with feedback", "position 0.25 m")]
    assert (view.stage.is_tracked, view.stage.is_followed, view.stage.is_empty, view.idle) == (True, True, False, False)
    bare = {"has_plan": False, "replay": None, "iterations": 0}
    seconds = one.seconds.model_copy(update={"stage": 0.0})
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
            else ran("a").model_copy(
                update={"stages": (one.model_copy(update=changes | ({"metrics": ()} if "replay" in changes else {})),)}
            )
        )
        assert view_of(report(lost), lost).stages[0].idle == idle, changes

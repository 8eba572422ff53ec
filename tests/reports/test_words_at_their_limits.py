"""Numbers in words at each limit and just beside it, causes and rules by each of their conditions, rows by every part of a chain."""

import math
from dataclasses import replace

import pytest

from models.results.run import QuantityRecord, RunRecord
from models.results.verdict import Question
from reports import findings, judged, rows, rule, wording
from reports.judged import _CAUSES, again, cause_of, deciding
from tests.reports import record_factory as factory
from tests.reports.record_factory import judged as metric
from tests.reports.record_factory import ran

THIN = "\u202f"


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (wording.number(0.0), "0"), (wording.number(math.inf), "–"),
        (wording.number(0.001), "0.001"), (wording.number(0.000999), "9.99×10⁻⁴"),
        (wording.number(999_999.0), f"999{THIN}999"), (wording.number(1e6), "10⁶"),
        (wording.number(-1e6), "−10⁶"), (wording.number(2e6), "2×10⁶"),
        (wording.number(1.25e6, 2), "1.2×10⁶"),
        (wording.number(12.3456), "12.35"), (wording.number(12.3456, 3), "12.3"),
        (wording.number(1234.5, 2), "1234"), (wording.number(0.012345, 3), "0.0123"),
        (wording.number(100.0, 3), "100"), (wording.number(10.0, 4), "10"),
        (wording.number(12345.0), f"12{THIN}345"), (wording.number(-12345.5, 6), f"−12{THIN}345.5"),
        (wording.number(1e-7), "10⁻⁷"), (wording.number(-1.5e-7), "−1.5×10⁻⁷"),
        (wording.number(9999.0), "9999"), (wording.number(1e20, 1), "10²⁰"),
        (wording.number(3e20, 1), "3×10²⁰"),
        (wording.cost(1e9), "10⁹"), (wording.cost(999_999_999.0), f"999{THIN}999{THIN}999.00"),
        (wording.cost(-1e9), "−10⁹"), (wording.cost(-0.001), "0.00"), (wording.cost(None), "–"),
        (wording.cost(math.nan), "–"), (wording.cost(1234.5), "1234.50"),
        (wording.cost(-12345.678), f"−12{THIN}345.68"),
        (wording.error(9.9e-16), "<10⁻¹⁵"), (wording.error(1e-15), "1.0×10⁻¹⁵"),
        (wording.error(-1e-16), "<10⁻¹⁵"), (wording.error(1e-4), "0.00010"),
        (wording.error(9.9e-5), "9.9×10⁻⁵"),
        (wording.error(-9.9e-5), "−9.9×10⁻⁵"), (wording.error(123456.0), f"120{THIN}000"),
        (wording.error(1.2e6), "1.2×10⁶"), (wording.error(1.0), "1.0"), (wording.error(12.3), "12"),
        (wording.error(None), "–"), (wording.error(math.inf), "–"),
        (wording.error(-0.126), "−0.13"),
        (wording.product(None), "–"), (wording.product(1.0), "1.00"),
        (wording.product(-1.0), "−1.00"), (wording.product(0.99), "0.99"),
        (wording.product(0.999), "1.0"),
        (wording.small(1.0), "1"), (wording.small(0.1), "10⁻¹"), (wording.small(10.0), "10"),
        (wording.small(0.0), "0"), (wording.small(None), "–"), (wording.small(2e-3), "0.002"),
        (wording.small(1e-3 * (1 + 2e-9)), "0.001"), (wording.small(-0.1), "−0.1"),
        (wording.seconds(0.0994), "0.099"), (wording.seconds(0.0995), "0.10"),
        (wording.seconds(99.4), "99.40"), (wording.seconds(99.5), "100"),
        (wording.seconds(98.5), "98.50"),
        (wording.seconds(12345.6), f"12{THIN}346"), (wording.seconds(None), "–"),
        (wording.seconds(0.0), "0"),
        (wording.percent(None), "–"), (wording.percent(math.inf), "–"),
        (wording.percent(4.9e-5), f"0.00{THIN}%"), (wording.percent(5.1e-5), f"+0.01{THIN}%"),
        (wording.percent(-5.1e-5), f"−0.01{THIN}%"),
        (wording.percent(0.0994), f"+9.94{THIN}%"), (wording.percent(0.0995), f"+10{THIN}%"),
        (wording.percent(-0.0994), f"−9.94{THIN}%"), (wording.percent(-0.25), f"−25{THIN}%"),
        (wording.times(9.49), "9.5 times"), (wording.times(9.5), "10 times"),
        (wording.times(1.25), "1.2 times"), (wording.times(34.4), "34 times"),
        (wording.ratio(1.0004), "1"), (wording.ratio(1.0005), "1.00"),
        (wording.ratio(9.994), "9.99"), (wording.ratio(9.995), "10"), (wording.ratio(999.4), "999"),
        (wording.ratio(999.5), ">999"),
        (wording.exact(1 / 3), "0.3333333333"), (wording.plain(None), "none"),
        (wording.plain(True), "yes"), (wording.plain(False), "no"),
        (wording.plain(12345), f"12{THIN}345"),
        (wording.plain(0.1234567), "0.123457"), (wording.plain((1, 2.5, "a")), "1, 2.5, a"),
        (wording.plain([]), "none"), (wording.plain("a\x07b"), "ab"),
        (wording.plain(-12345), f"−12{THIN}345"),
        (wording.unit("1"), ""), (wording.unit(""), ""), (wording.unit("kg m^-2 s^3"), "kg m⁻² s³"),
        (wording.measured(0.04, "m, rad"), "0.040 (m, rad)"),
        (wording.measured(0.04, "m"), "0.040 m"),
        (wording.measured(0.04, "1"), "0.040"), (wording.with_unit("14", "1"), "14"),
        (wording.with_unit("14", "m, rad"), "14 (m, rad)"), (wording.capital("abc def"), "Abc def"),
        (wording.capital(""), ""), (wording.spaced("time_limit_now"), "time limit now"),
        (wording.count(1, "run"), "1 run"), (wording.count(0, "run"), "0 runs"),
        (wording.count(2, "optimum", "optima"), "2 optima"),
        (wording.count(1, "optimum", "optima"), "1 optimum"),
        (wording.listing([]), ""), (wording.listing(["a"]), "a"),
        (wording.listing(["a", "b"]), "a and b"), (wording.listing(["a", "b", "c"]), "a, b and c"),
        (wording.power(-12), "10⁻¹²"),
        (wording.tail("abc\ndef\nghi", 6), "…\nghi"), (wording.tail("abcdef ", 6), "abcdef"),
        (wording.tail("abc\ndef", 7), "abc\ndef"), (wording.tail("a\rb\r\nc"), "a\nb\nc"),
        (wording.tail("x" * 8000), "x" * 8000),
        (wording.tail("y\n" + "x" * 7999), "…\n" + "x" * 7999),
        (wording.clean("a\x1b[31mb\x1b[0m\u202ec\td"), "abc\td"),
        (wording.prose("1e+05 and 1.5e+06"), f"100{THIN}000 and 1.5×10⁶"),
        (wording.prose("12e-3"), "12×10⁻³"),
        (wording.prose("-1e-5 +2e-1 1e5"), f"−10⁻⁵ +0.2 100{THIN}000"),
        (wording.prose("1.25e+01 1.25e+03 3e+02"), "12.5 1.25×10³ 300"),
        (wording.prose("-0.00e+00"), "0"),
        (wording.prose("1e-04"), "0.0001"), (wording.verdict("holds").symbol, "✓"),
        (wording.verdict("odd").symbol, "?"), (wording.verdict("odd").word, "odd"),
        (wording.answer("not asked").symbol, "–"), (wording.answer("odd").style, "undecided"),
    ],
)  # fmt: skip
def test_numbers_and_words_at_their_limits(said: str, words: str):
    assert said == words


@pytest.mark.parametrize("cause", _CAUSES)
def test_each_cause_has_its_words(cause: str):
    run = ran("a", verdict="violates", cause=cause, why="off.")
    found = cause_of(replace(run, stages=(replace(run.last, kind="indirect"),)))
    assert (found.sentence, found.advice) == _CAUSES[cause]


def test_which_metric_decides():
    early, late = (
        metric("a", 2.0, limit=1.0, ok=False, question=Question.GOAL),
        metric("b", 3.0, limit=1.0, ok=False, question=Question.POSSIBLE),
    )
    of_judge, tracked = (
        metric("c", 9.0, limit=1.0, ok=False),
        metric("tracked_a", 9.0, limit=1.0, ok=False, question=Question.TASK),
    )
    within, shown = (
        metric("d", 0.5, limit=1.0, ok=True, question=Question.TASK),
        metric("e", 9.0, question=Question.TASK, ok=False),
    )

    def decided(verdict: str, *metrics, followed: bool = False) -> str | None:
        (stage,) = ran("a", *metrics, verdict=verdict).stages
        stage = replace(
            stage, replay=replace(stage.replay, judged="feedback" if followed else "open")
        )
        found = deciding(stage)
        return None if found is None else found.name

    assert decided("violates", of_judge, tracked, late, early, within, shown) == "a"
    assert decided("violates", of_judge, tracked, within) == "tracked_a"
    assert decided("violates", of_judge, within) == "c"
    open_, judge_open = (
        metric("f", 1.0, limit=1.0, ok=None, question=Question.MOTION),
        metric("g", 1.0, limit=1.0, ok=None),
    )
    assert decided("undecided", within, open_, judge_open) == "g", "first whether the judge is well"
    assert decided("undecided", within, open_) == "f"
    assert (
        decided(
            "undecided",
            within,
            metric("tracked_f", 1.0, limit=1.0, ok=None, question=Question.MOTION),
        )
        is None
    )
    near, nearer = (
        metric("h", -0.9, limit=1.0, ok=True, question=Question.MOTION),
        metric("i", 1.9, limit=2.0, ok=True, question=Question.FORCES),
    )
    zero, unknown = (
        metric("j", 5.0, limit=0.0, ok=True, question=Question.FORCES),
        metric("k", None, limit=0.1, question=Question.FORCES),
    )
    judge, own = (
        metric("l", 0.99, limit=1.0, ok=True),
        metric("tracked_h", 0.1, limit=1.0, ok=True, question=Question.MOTION),
    )
    assert decided("holds", near, nearer, zero, unknown, judge, own) == "i"
    assert decided("holds", within, near) == "h", "by its size"
    assert (
        decided(
            "holds with feedback",
            near,
            nearer,
            own,
            metric("feedback_effort", 0.2, limit=1.0, ok=True, question=Question.MOTION),
            followed=True,
        )
        == "feedback_effort"
    )
    assert decided("holds", shown) is decided("no plan", early) is None


@pytest.mark.parametrize(
    ("verdict", "outcome", "said"),
    [
        ("holds", "solved", None), ("holds with feedback", "solved", None),
        ("not applicable", "refused", None), ("consistent", "solved", None),
        ("no plan", "time_limit", ("No plan: time limit", "Do this.")),
        ("violates", "solved", ("Violates: the reason", "Do this.")),
    ],
)  # fmt: skip
def test_the_cause_of_a_run(verdict: str, outcome: str, said: tuple[str, str] | None):
    run = replace(
        ran("a", verdict=verdict, outcome=outcome, why="the reason. And more.", advice="Do this."),
        outcome=outcome,
    )
    found = cause_of(run)
    assert (found and (found.sentence, found.advice)) == said
    other = cause_of(replace(run, outcome="crashed"))
    if verdict == "no plan":
        assert (other.sentence, other.advice[:12]) == ("No plan: crashed", "Read the end")
    mute = cause_of(ran("a", verdict="violates", why=""))
    assert mute.sentence == "Violates: the record does not say why"


def test_a_cause_of_the_goal_and_one_that_is_open():
    far = cause_of(
        ran("a", verdict="violates", cause="terminal_error", outcome="stalled", advice="Do this.")
    )
    assert (far.sentence, far.advice) == (
        "The plan itself does not reach the goal (stalled)",
        "Do this.",
    )
    other = cause_of(ran("a", verdict="violates", cause="start_error"))
    assert other.sentence == "The plan does not start where the task starts"
    open_ = cause_of(ran("a", verdict="undecided", cause="replay_error"))
    assert (open_.sentence, open_.advice) == (
        "Undecided: the replay's own error leaves replay error open",
        "Replay with tighter tolerances.",
    )


def answers(verdict: str = "violates", **said: str) -> dict:
    return {"questions": factory.questions(**said), "verdict": verdict, "why": "it is off."}


@pytest.mark.parametrize(
    ("changes", "order", "is_finding"),
    [
        (answers(q4="no"), 0.5, True), (answers(q5="no"), 0.5, True),
        (answers(q4="no"), 0.49, False), (answers(q4="no"), None, False), (answers(), 1.0, False),
        (answers(q4="no", q1="no"), 1.0, False), (answers(q4="no", q2="no"), 1.0, False),
        (answers(q4="no", q3="no"), 1.0, False), (answers(q4="no", q6="no"), 1.0, False),
        (answers(q4="no", q3="not asked"), 1.0, True),
        (answers(q4="no", q6="undecided"), 1.0, False), (answers(q4="undecided"), 1.0, False),
        ({**answers(q4="no"), "questions": ()}, 1.0, False),
        ({**answers(q4="no"), "paper": {"cost": 1.0}}, 1.0, False),
        (answers("holds with feedback"), 0.5, True), (answers("holds with feedback"), 0.49, False),
        (answers("holds with feedback"), None, False),
        (answers("holds with feedback", q6="no"), 1.0, False),
    ],
)  # fmt: skip
def test_a_plan_that_fails_by_its_time_step_alone_is_a_finding(
    changes: dict, order: float | None, is_finding: bool
):
    run = ran("a", *(() if order is None else (metric("grid_order", order),)), **changes)
    assert rule.findings([run]) == (("three_cart x a: it is off.",) if is_finding else ())
    verdict = changes["verdict"]
    none = ("three_cart: no run holds (a solved, violates)",) if verdict == "violates" else ()
    assert rule.failures([run])[:1] == (
        none if is_finding else (f"three_cart x a: {verdict} - it is off.",)
    )
    unstable = replace(run, scene=replace(run.scene, unstable="It falls over."))
    assert not (verdict == "holds with feedback" and rule.findings([unstable])), (
        "there it is as it must be"
    )
    for other in ({"must_hold": False}, {"outcome": "stalled"}, {"stages": ()}):
        assert rule.findings([replace(run, **other)]) == ()


def test_which_runs_fail_a_campaign():
    good, bad = ran("good"), ran("bad", verdict="violates", why="off.")
    hill = factory.scene("hill")
    lost = replace(
        ran("lost", verdict="no plan", outcome="infeasible", advice="Do this.", of=hill),
        outcome="infeasible",
        message="",
    )
    assert rule.failed_keys([good, bad, lost]) == {"bad-key", "lost-key"}
    assert rule.failures([good, bad, lost]) == (
        "three_cart x bad: violates - off.",
        "hill: no run holds (lost infeasible, no plan)",
    )
    assert rule.failed_keys([replace(lost, must_hold=False)]) == frozenset()
    assert rule.failed_keys([replace(lost, outcome="refused")]) == frozenset()
    none = replace(ran("none", verdict="no plan", advice="Do this."), message="")
    assert rule.failures([none])[0] == "three_cart x none: no plan (solved) - Do this."
    assert (
        rule.failures([replace(none, message="A word.")])[0]
        == "three_cart x none: no plan (solved) - A word."
    )
    beside = replace(
        ran("beside", verdict="violates", outcome="stalled", paper={"cost": 1.0}, why="off."),
        outcome="stalled",
    )
    assert rule.failures([good, beside]) == ("three_cart x beside: violates - off.",)
    assert rule.failures([good, replace(ran("soft", verdict="violates"), must_hold=False)]) == ()
    for outcome in ("crashed", "failed"):
        broke = replace(bad, outcome=outcome, message="why", must_hold=False)
        assert rule.failures([good, broke]) == (f"three_cart x bad: {outcome} - why",)
        assert rule.fails(broke)


def stage_of(method: str, eps: float | None = None, index: int = 0, **changes: object):
    return replace(ran(method, eps=eps, **changes).stages[0], index=index)


def path(name: str, *stages, **changes: object) -> RunRecord:
    return replace(ran(name), **{"stages": tuple(stages), **changes})


def test_a_row_is_a_stage_with_what_it_starts_from():
    soft, tight, exact = (
        stage_of("soft", 1e-1, paper={"time": 2.0}),
        stage_of("soft", 1e-3, 1, paper={"time": 3.0}),
        stage_of("exact", None, 2, paper={"time": 4.0, "cost": 80.0}, cost=100.0),
    )
    other = stage_of("other", None, 2, paper={"cost": 0.0})
    found = rows.rows_of(
        (
            path("soft+exact", soft, tight, exact),
            path("alone", stage_of("lone")),
            path("soft+other", soft, tight, other),
        ),
        lambda run: f"to {run.pipeline}",
    )
    assert [row.label for row in found] == [
        "soft ε = 10⁻¹",
        "soft ε = 10⁻³",
        "exact after soft",
        "other after soft",
        "lone",
    ]
    assert [row.methods for row in found][2] == ("soft", "exact")
    assert [row.link for row in found] == ["to soft+exact"] * 3 + ["to soft+other", "to alone"]
    assert [row.paper_total for row in found] == [2.0, 5.0, 9.0, None, None]
    assert [row.cost_difference for row in found][2:4] == [pytest.approx(0.25), None]
    assert [len(row.chain) for row in found] == [1, 2, 3, 3, 1]
    assert [row.twin for row in found] == [False] * 5


def test_rows_of_one_name_are_told_apart_by_their_pipelines():
    one, two = (
        path("first", stage_of("soft", options={"a": 1})),
        path("second", stage_of("soft", options={"a": 2})),
    )
    assert [row.label for row in rows.rows_of((one, two), lambda run: "")] == [
        "soft (first)",
        "soft (second)",
    ]
    same = path("soft", stage_of("soft", options={"a": 3}))
    assert [row.label for row in rows.rows_of((one, same), lambda run: "")] == [
        "soft (first)",
        "soft",
    ]
    assert [
        row.label
        for row in rows.rows_of(
            (one, path("third", stage_of("soft", options={"a": 1}))), lambda run: ""
        )
    ] == ["soft"]
    far = replace(two, scene=factory.scene("hill"))
    assert [row.label for row in rows.rows_of((one, far), lambda run: "")] == ["soft", "soft"]
    paper = path("paper", stage_of("soft", options={"a": 4}, paper={"cost": 1.0}))
    assert [row.twin for row in rows.rows_of((one, paper), lambda run: "")] == [True, False]


def test_known_costs_and_named_rows():
    def answered(*answers: QuantityRecord):
        return replace(factory.scene(), answers=answers)

    one, cost, none = (
        QuantityRecord(name="period", unit="s", value=2.0),
        QuantityRecord(name="least cost", unit="1", value=3.0),
        QuantityRecord(name="cost", unit="1"),
    )
    assert rows.known_cost(answered(one, none, cost)) == ("least cost", 3.0)
    assert rows.known_cost(answered(one, none)) is None
    (row,) = rows.rows_of(
        (ran("a", metric("replay_terminal_position_error", 0.5), verdict="holds with feedback"),),
        lambda run: "",
    )
    assert (row.named, row.holds, row.ends) == (
        "a, which holds with feedback",
        True,
        "position 0.50 m",
    )
    (row,) = rows.rows_of((ran("a", verdict="violates"),), lambda run: "")
    assert (row.named, row.holds) == ("a", False)


def test_where_motions_end_in_words():
    (stage,) = ran(
        "a", metric("terminal_error", 0.5, "m, m/s"),
        metric("replay_terminal_velocity_error", 0.25, "m/s"), metric("replay_terminal_error", 9.0),
    ).stages  # fmt: skip
    assert [judged.distance_of(stage, prefix) for prefix in ("", "replay_", "discrete_")] == [
        "error 0.50 (m, m/s)",
        "velocity 0.25 m/s",
        "",
    ]
    free = replace(factory.scene(), goal=(None, 1.0))
    (bare,) = ran("a").stages
    assert judged.end_of(bare, free) == ""
    assert judged.end_of(bare, replace(free, goal=(None, None))) == "free end"


def test_metrics_that_belong_to_no_question_are_shown_last():
    metrics = (
        metric("a", 1.0, question=Question.FORCES, limit=2.0, ok=True), metric("b", 1.0),
        metric("c", 1.0, limit=2.0, ok=True),
        metric("d", None, question=Question.FORCES, reason="not asked."), metric("e", 1.0, question=Question.GOAL),
    )  # fmt: skip
    (stage,) = ran("a", *metrics, questions=factory.questions()).stages
    found = judged.questions_of(stage)
    assert [(view.number, [item.name for item in view.metrics]) for view in found] == [
        (1, []), (2, ["e"]), (3, ["a"]), (4, []), (5, []), (6, []), (None, ["c"]), (None, ["b"]),
    ]  # fmt: skip
    assert [item.waived for view in found for item in view.metrics] == ["", "", "", ""]
    (bare,) = ran("a", *metrics, questions=()).stages
    assert [
        (view.text, [item.name for item in view.metrics]) for view in judged.questions_of(bare)
    ] == [("Shown, not judged", ["a", "b", "c", "d", "e"])]
    reason = judged.MetricView("x", metric("x", 1.0, question=Question.FORCES, reason="why"), None)
    assert (reason.waived, reason.is_judged) == ("why", False)
    assert judged.MetricView(
        "x", None, metric("x", 1.0, question=Question.FORCES, limit=1.0, reason="why")
    ).is_judged
    assert (
        judged.MetricView("x", metric("x", 1.0, reason="why"), None).waived
        == judged.MetricView(
            "x", metric("x", None, question=Question.FORCES, reason="why"), None
        ).waived
        == ""
    )


@pytest.mark.parametrize(
    ("command", "repeated"),
    [
        (
            "python -m validate all --scene a.py --scene=b -j 4 --fresh --out runs/x --time-limit 60 mine.toml -k name --engine dask",
            "python -m validate all --scene a.py --scene=b --time-limit 60 mine.toml",
        ),
        (
            "python -m validate run mine.toml --jobs 3 --retry all --plugin p",
            "python -m validate run mine.toml --plugin p",
        ),
        ("python -m validate report x", None),
        ("python -m other all x", None),
        ("python script.py", None),
        ("python -m validate all 'open", None),
        ("python -m validate", None),
    ],
)
def test_the_command_that_repeats_one_run(command: str, repeated: str | None):
    run = replace(ran('a "b"'), provenance=factory.provenance(command=command))
    mine = '-k \'="three_cart x a ""b"""\' --fresh --out runs/again'
    assert again(run) == (command if repeated is None else f"{repeated} {mine}")


def test_costs_and_seconds_of_findings():
    run = path(
        "a", stage_of("soft", cpu=2.0, cost=9.0), stage_of("exact", None, 1, cpu=3.0, cost=7.0)
    )
    assert (run.solving_cpu, run.cost, replace(run, stages=()).cost) == (
        5.0,
        7.0,
        None,
    )
    assert run.integral_cost == pytest.approx(0.07)
    assert (
        findings.cost_ratio(ran("a", cost=None), {"three_cart": 5.0})
        is findings.cost_ratio(ran("a", cost=4.0), {})
        is None
    )
    assert findings.cost_ratio(ran("a", cost=4.0), {"three_cart": 5.0}) == 0.8
    assert findings.Standing("a", 2, 3, None, None).rank == (-2, math.inf, math.inf)
    assert findings.Standing("a", 2, 3, 1.5, 4.0).rank == (-2, 1.5, 4.0)
    (alone,) = findings.standings([ran("a", cost=None)])
    assert (alone.ratio, alone.cpu, alone.holds, alone.able) == (None, 1.0, 1, 1)
    (bad,) = findings.standings([ran("a", verdict="violates")])
    assert (bad.ratio, bad.cpu, bad.holds, bad.able) == (None, None, 0, 1)


def test_a_run_is_judged_by_its_last_stage():
    """A first stage of which everything else is true."""
    bad, good = (
        stage_of("a", verdict="violates", why="first.", **{"paper": {"cost": 1.0}}),
        stage_of(
            "b", None, 1, why="last.", advice="Do that.", questions=factory.questions(q4="no")
        ),
    )
    run = path("two", bad, good, verdict="violates")
    assert rule.failures([run])[0] == "three_cart x two: violates - last."
    order = replace(good, metrics=(metric("grid_order", 1.0),))
    assert rule.findings([path("two", bad, order, verdict="violates")]) == (
        "three_cart x two: last.",
    )
    assert rule.findings([path("two", order, good, verdict="violates")]) == ()
    none = path("two", bad, good, verdict="no plan", message="")
    assert rule.failures([none])[0] == "three_cart x two: no plan (solved) - Do that."
    stopped = path("two", bad, good, verdict="violates", outcome="stalled")
    assert rule.failures([stopped]) == ("three_cart: no run holds (two stalled, violates)",)
    assert path("two", stage_of("a", cost=1.0), stage_of("b", None, 1, cost=2.0)).cost == 2.0
    worse = cause_of(
        path(
            "two", stage_of("a", verdict="violates", advice="No."),
            stage_of("b", None, 1, verdict="violates", why="Last. Of all.", advice="Yes."),
            verdict="violates",
        ),
    )  # fmt: skip
    assert (worse.sentence, worse.advice) == ("Violates: Last", "Yes.")


def test_signs_by_a_second_copy_of_their_table():
    def told(signs: dict[str, wording.Sign]) -> list[str]:
        assert list(signs) == [sign.word for sign in signs.values()]
        assert len({sign.meaning for sign in signs.values()}) == len(signs)
        assert all(" " in sign.meaning for sign in signs.values())
        return [f"{sign.word} {sign.symbol} {sign.style}" for sign in signs.values()]

    assert told(wording.VERDICTS) == [
        "holds ✓ holds", "holds with feedback ↻ feedback", "violates ✗ violates",
        "undecided ? undecided", "no plan ○ noplan", "not applicable ⊘ noplan",
        "consistent ≈ consistent",
    ]  # fmt: skip
    assert told(wording.ANSWERS) == [
        "yes ✓ holds",
        "no ✗ violates",
        "undecided ? undecided",
        "not asked – noplan",
    ]
    assert (wording.VERDICTS["no plan"].meaning, wording.ANSWERS["no"].meaning) == (
        "the method found none; its outcome says why",
        "a metric of the question is surely beyond its limit",
    )  # fmt: skip

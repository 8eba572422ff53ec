"""All runs as one table, and the head of a run's page: the verdict with what decided it."""

import html
import re

from wording import unsaid

from reports.pages.run import decision_of, view_of
from reports.pages.section import Report, run_page
from reports.records.load import load
from reports.render import PAGES, write_report


def words(text: str) -> str:
    return " ".join(html.unescape(re.sub(r"<(style|script)[^>]*>.*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL)).split())


def rows_of(folder) -> list[list[str]]:
    write_report(folder)
    table = re.search(
        r'<table class="numbers close runs".*?</table>', (folder / PAGES / "runs.html").read_text(encoding="utf-8"), re.DOTALL
    )
    assert table is not None
    return [
        [words(cell) for cell in re.findall(r"<t[hd].*?</t[hd]>", row, re.DOTALL)]
        for row in re.findall(r"<tr>.*?</tr>", table[0], re.DOTALL)
    ]


def test_a_row_has_errors_apart_with_units_and_the_integral_cost(factory, tmp_path):
    refused = factory.run(
        "refused", None, "strict_lcp", key="no-0", stages=(), outcome="refused", verdict="not applicable",
        message="strict_lcp: scene three_cart has no wall.",
    )  # fmt: skip
    head, row, other = rows_of(factory.store(tmp_path / "all", [factory.runs()[0], refused]))
    assert head[3:5] == ["Cost", "Integral cost"]
    # 496.63 times 0.01 s; 4.1e-3 off, 0.8 of it in position and 0.6 in velocity.
    assert row == ["three_cart", "strict", "✓ holds", "496.63", "4.9663", "0.0033 m", "0.0025 m/s", "0.0090 m", "0.71", ""]
    assert other[:3] == ["three_cart", "refused", "⊘ not applicable"]
    assert other[-1] == "The scene has no wall."


def test_the_page_of_a_run_begins_with_its_verdict(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp", verdict="violates", outcome="stalled", message="No step lowers the loss.")
    (stage,) = run.stages
    metrics = tuple(
        item.model_copy(update={"value": 0.12, "ok": False}) if item.name == "replay_terminal_position_error" else item
        for item in stage.metrics
    )
    said = {
        "metrics": metrics, "verdict": "violates", "outcome": "stalled", "questions": factory.questions(q4="no"),
        "why": "the motion ends 0.12 m from the goal.", "cause": "motion",
    }  # fmt: skip
    run = run.model_copy(update={"stages": (stage.model_copy(update=said),)})
    decision = decision_of(run)
    assert (decision.question.number, decision.metric.name, decision.metric.value) == (4, "replay_terminal_position_error", 0.12)
    folder = factory.store(tmp_path / "all", [run])
    write_report(folder)
    text = words((folder / PAGES / run_page(run)).read_text(encoding="utf-8"))
    order = [
        "strict on three_cart ✗ violates", "Question 4. Do its inputs give its motion, and the goal? ✗ no",
        "Decided by replay_terminal_position_error : 0.12 m ± 3.0×10⁻⁹, limit 0.06 m.",
        "Cause The inputs do not give the planned motion. The motion ends 0.12 m from the goal.", "Advice Look at the error over time",
        "Cost 496.63, a sum over 500 steps; integral cost (times h = 0.01 s) 4.9663", "Keys: space plays and pauses",
        "Positions: plan dotted", "Made by touchstone 0.1.0, commit aaaaaaaaaaaa", "Run it again python -m validate all -k",
    ]  # fmt: skip
    places = [text.find(part) for part in order]
    assert -1 not in places, order[places.index(-1)]
    assert places == sorted(places)
    assert text.count("ends 0.12 m from the goal") == 1, "what decided is told once"


def test_stages_before_the_last_stand_side_by_side(factory, tmp_path):
    run = factory.run("softplus_dc+strict", "softplus_dc", "strict_lcp")
    folder = factory.store(tmp_path / "all", [run])
    view = view_of(Report(load(folder), folder), run)
    assert [len(row.found) for row in view.beside] == [4] * len(view.beside)
    row = next(row for row in view.beside if row.metric.name == "replay_terminal_position_error")
    assert [metric.value for metric in row.found] == [0.8 * off for off in (0.4512, 0.2666, 0.1201, 4.0e-3)]
    assert [bool(item.questions) for item in view.stages] == [False, False, False, True]
    titles = [[plot.title.split(",")[0] for plot in item.plots.motion] for item in view.stages]
    assert "Gap" in titles[-1]
    assert "Gap" not in titles[0]
    assert "Positions: plan dotted" in titles[0]
    alone = factory.run("strict", None, "strict_lcp")
    assert view_of(Report(load(factory.store(tmp_path / "one", [alone])), tmp_path / "one"), alone).beside == []
    assert (
        decision_of(run.model_copy(update={"stages": (), "verdict": "no plan", "outcome": "crashed", "message": "it died."})).cause
        == "No plan: crashed. It died."
    )


def test_long_keys_are_cut_in_links_and_others_are_not(factory):
    run = factory.run("strict", None, "strict_lcp")
    assert run_page(run) == "strict-0123456789abcdef.html"
    assert run_page(run.model_copy(update={"key": "0123456789abcdef" * 4})) == "0123456789abcdef.html"


def test_a_metric_that_could_not_be_measured_decides_with_its_reason(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp", verdict="undecided")
    (stage,) = run.stages
    lost = stage.metrics[-2].model_copy(update={"value": None, "ok": None, "reason": "the replay left every bound"})
    run = run.model_copy(update={"stages": (stage.model_copy(update={"metrics": (lost,), "verdict": "undecided"}),)})
    folder = factory.store(tmp_path / "all", [run])
    write_report(folder)
    assert not unsaid(words((folder / PAGES / run_page(run)).read_text(encoding="utf-8")), "Decided by replay_error : … 0.02 m.")

"""CPU time against replay error and cost: what is compared, where the front runs, and what the sentences conclude."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from reports.pages import pareto
from reports.pages.section import Report
from reports.records.load import Stored
from reports.records.record import MetricRecord, RunRecord
from reports.render import PAGES, write_report
from tests.reports import record_factory as factory


def figure(name: str, value: float | None, limit: float | None = None) -> MetricRecord:
    ok = None if limit is None or value is None else value <= limit
    return MetricRecord(
        name=name, value=value, unit="m", meaning=name, limit=limit, reason="" if value is not None else "it was not replayed.", ok=ok
    )


def cell(name: str, cpu: float, error: float | None, cost: float, missed: float, verdict: str = "holds", **changes: object) -> RunRecord:
    """A run of one stage with these figures; `method` tells the rows apart."""
    first = factory.stage(0, "strict_lcp", None, None, 0.0)
    stage = first.model_copy(
        update={
            "method": name,
            "cost": cost,
            "verdict": verdict,
            "paper": {},
            "seconds": first.seconds.model_copy(update={"stage_cpu": cpu}),
            "metrics": (figure("replay_error", error, 0.02), figure("replay_terminal_error", missed, 0.06)),
            **changes,
        }
    )
    return factory.run(name, None, "strict_lcp", stages=(stage,), key=f"{name}-0123456789abcdef")


def page(*cells: RunRecord) -> SimpleNamespace:
    """What the section of the one scene shows."""
    report = Report(Stored("x", None, cells, (), (), 0))
    (scene,) = report.scenes
    section = pareto.build(report, scene)
    assert section is not None
    return SimpleNamespace(**section.values)


def test_the_sentences_conclude_from_the_numbers() -> None:
    found = page(
        cell("quick", 1.0, 0.010, 500.0, 0.01),
        cell("better", 4.0, 0.005, 495.0, 0.01),
        cell("best", 10.0, 0.001, 490.0, 0.01),
        cell("slow", 20.0, 0.002, 499.0, 0.01),
    )
    error, cost = (view.sentence for view in found.views)
    assert "1.00 s (quick), replay error 0.010 m" in error
    assert "4.0 times as long, 4.00 s (better): replay error 0.0050 m, 2.0 times nearer" in error
    assert "The best takes 10 times as long as the first, 10.00 s (best): replay error 0.0010 m, 10 times nearer" in error
    assert "cost 495.00, 1 % cheaper" in cost
    assert "slow" not in error + cost
    assert "quick (1.00 s, 0.010), better (4.00 s, 0.0050) and best (10.00 s, 0.0010)" in found.views[0].plot.words


def test_a_cost_is_compared_only_where_the_replay_ends_as_near_as_the_scene_asks() -> None:
    found = page(
        cell("honest", 2.0, 0.01, 490.0, 0.01),
        cell("elsewhere", 1.0, 0.3, 200.0, 0.4, "violates"),
        cell("relaxed", 0.5, 0.015, 300.0, 0.05, "violates"),
    )
    cost = found.views[1]
    assert "2 stages" in cost.plot.words
    assert "on the front, the fastest first: honest (2.00 s, 490.00)." in cost.plot.words  # what breaks a limit is drawn, but sets no front
    assert "the scene allows: 1 plan." in cost.sentence
    assert "ends off the goal by error 0.40 m, " in str(found.views[0].plot.markup())
    assert "200.00" not in str(cost.plot.markup())


def test_errors_that_the_replay_cannot_tell_apart_are_no_gain() -> None:
    found = page(cell("one", 1.0, 1e-10, 490.0, 0.01), cell("other", 2.0, 1e-12, 490.0, 0.01))  # its own error is 3e-9
    assert "No other plan that holds is better" in found.views[0].sentence


def test_a_gain_too_small_for_a_sentence_is_told_as_one() -> None:
    one, hardly = cell("one", 1.0, 0.0100, 490.0, 0.01), cell("hardly", 2.0, 0.0098, 489.9, 0.01)
    error, cost = (view.sentence for view in page(one, hardly).views)
    assert "No other plan that holds is better by more than 5 %, whatever" in error
    assert "No other plan that holds is better by more than 0.1 %, whatever" in cost
    error = page(one, hardly, cell("far", 3.0, 0.001, 500.0, 0.01)).views[0].sentence
    assert "The next one that is better by more than 5 % takes 3.0 times as long, 3.00 s (far): " in error


def test_failures_and_refusals_are_listed() -> None:
    failed = cell("lost", 3.0, None, 490.0, 0.01, "no plan", outcome="stalled", message="no step was left. More words.", metrics=())
    refused = cell("refuses", 0.0, None, 490.0, 0.01, "no plan", outcome="refused", metrics=())
    found = page(cell("good", 1.0, 0.01, 490.0, 0.01), failed, refused)
    assert [(row.label, why) for row, why in found.failed] == [("lost", "stalled, no plan: no step was left")]
    assert found.refused == ["refuses"]


def test_where_nothing_holds_it_says_so() -> None:
    found = page(cell("bad", 1.0, 0.3, 490.0, 0.01, "violates"))
    assert found.views[0].sentence == "None of 1 plan holds, so there is none to recommend."


def test_a_scene_without_inputs_has_nothing_to_choose_from() -> None:
    run = cell("motion", 1.0, 0.01, 0.0, 0.0)
    free = page(run.model_copy(update={"scene": run.scene.model_copy(update={"inputs": ()})}))
    assert (free.views, free.failed) == ([], [])
    assert free.nothing.startswith("This scene has no inputs")
    planned = page(run)
    assert (len(planned.views), planned.nothing) == (2, "")


@pytest.mark.parametrize("words", ["pipeline quick, stage 1", "CPU time against cost at equal terminal error"])
def test_the_page_shows_them(tmp_path: Path, words: str) -> None:
    run = cell("quick", 1.0, 0.010, 500.0, 0.01)
    folder = tmp_path / "runs" / run.key
    folder.mkdir(parents=True)
    (folder / "record.json").write_text(json.dumps(run.model_dump(mode="json")))
    write_report(tmp_path)
    assert words in (tmp_path / PAGES / "scene-three_cart.html").read_text(encoding="utf-8")

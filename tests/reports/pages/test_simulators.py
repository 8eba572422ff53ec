"""What other simulators say of a campaign's plans: its sentences by hand, its page whole, and a file of it that is damaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from reports.pages import simulators
from reports.pages.section import Report
from reports.records.engines_record import SIMULATORS, EngineRecord, SimulatorsRecord
from reports.records.load import Stored, load
from reports.records.record import RunRecord
from reports.render import Templates, render
from tests.reports import record_factory as factory


def run(scene: str, price: float, pipeline: str = "mpcc", verdict: str = "holds") -> RunRecord:
    template = factory.runs()[0]
    last = template.stages[-1].model_copy(update={"cost": price, "verdict": verdict})
    named = {
        "key": f"{scene}-{pipeline}",
        "pipeline": pipeline,
        "scene": factory.scene(scene),
        "stages": (last,),
        "verdict": verdict,
    }
    return template.model_copy(update=named)


def row(
    engine: str, verdict: str, agrees: bool | None, kind: str = "", sentence: str = "0.1 from ours"
) -> EngineRecord:
    return EngineRecord(engine=engine, verdict=verdict, agrees=agrees, kind=kind, sentence=sentence)


RUNS = (run("one", 2.0), run("two", 3.0), run("three", 4.0))
RECORD = SimulatorsRecord(
    engines={
        "near": "Nearby 1.0; stiff springs",
        "far": "Far 2.0; cones",
        "gone": "asked of what is no more",
    },
    plans={
        "one-mpcc": (
            row("near", "holds", True),
            row("far", "violates", False, "contact law", "<b>violates</b> & more"),
        ),
        "two-mpcc": (
            row("near", "holds", True),
            row("far", "cannot express it", None, "", "no such damping"),
        ),
        "three-mpcc": (row("near", "undecided", False, "step error"),),
        "of another run": (row("gone", "holds", True),),
    },
)


def built(record: SimulatorsRecord | None, runs: tuple[RunRecord, ...] = RUNS) -> Any:
    return simulators.build(Report(Stored(None, runs, (), (), 0, simulators=record), at="pages/"))


def test_sentences_count_who_agrees_and_why_not():
    found = built(RECORD)
    assert found.values["said"] == [
        "near gives our verdict on 2 of 3 plans that it can step; otherwise by step error (1).",
        "far gives our verdict on 0 of 1 plan that it can step; otherwise by contact law (1); no answer on two (cannot express it).",
    ]
    assert found.said == found.values["said"][0]
    assert list(found.values["engines"]) == ["near", "far"], (
        "of runs that are no more nothing is told"
    )
    assert [(item.scene.name, other.engine) for item, _, other in found.values["otherwise"]] == [
        ("one", "far"),
        ("two", "far"),
        ("three", "near"),
    ]


def test_the_page_shows_each_verdict_what_was_not_asked_and_what_was_measured():
    found = built(RECORD)
    text = Templates().render(found.template, section=found, **found.values)
    assert "<strong>violates</strong>: contact law" in text
    assert "&lt;b&gt;violates&lt;/b&gt; &amp; more" in text
    assert text.count("not asked") == 1
    assert '<td><a href="pages/one-mpcc.html">mpcc</a></td>' in text
    assert "<dt>far</dt><dd>Far 2.0; cones.</dd>" in text


@pytest.mark.parametrize(
    "record",
    [None, SimulatorsRecord(), SimulatorsRecord(plans={"of another run": ()})],
    ids=["none", "empty", "other"],
)
def test_without_rows_of_these_runs_there_is_no_page(record: SimulatorsRecord | None):
    assert built(record) is None


def test_the_cheapest_that_holds_comes_first():
    runs = (
        run("one", 3.0),
        run("one", 1.0, "soft", "violates"),
        run("one", 2.0, "tracked", "holds with feedback"),
        run("two", 0.5),
    )
    stored = Stored(None, runs)
    assert [(item.pipeline, price) for item, price in stored.cheapest("one")] == [
        ("tracked", 2.0),
        ("mpcc", 3.0),
    ]


def test_rows_of_an_engine_that_is_asked_again_take_the_place_of_the_old():
    found = RECORD.with_rows("one-mpcc", (row("far", "holds", True), row("new", "holds", True)))
    assert [(item.engine, item.verdict) for item in found.plans["one-mpcc"]] == [
        ("near", "holds"),
        ("far", "holds"),
        ("new", "holds"),
    ]
    assert found.plans["two-mpcc"] == RECORD.plans["two-mpcc"]


@pytest.mark.slow
def test_a_damaged_file_is_told_and_the_rest_is_shown(tmp_path: Path):
    factory.store(tmp_path, list(factory.runs()))
    whole = render(tmp_path)
    (tmp_path / SIMULATORS).write_text('{"plans": ')
    stored = load(tmp_path)
    assert stored.simulators is None
    assert [item.path for item in stored.unreadable] == [SIMULATORS]
    text = render(tmp_path)
    assert SIMULATORS in text
    assert SIMULATORS not in whole
    (tmp_path / SIMULATORS).write_text(RECORD.model_dump_json())
    assert load(tmp_path).simulators == RECORD

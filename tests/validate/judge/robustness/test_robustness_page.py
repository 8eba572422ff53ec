"""What plans survive: conclusions by hand, and the page as a whole."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from models.results.robustness import Share, Survey
from models.results.run import CertificateRecord, RunRecord
from reports.load import Stored
from reports.pages import robustness
from reports.pages.section import Report
from reports.render import Templates
from tests.reports import record_factory as factory
from tests.reports.drawn import drawn


def share(arrived: int, samples: int = 100) -> Share:
    # Half-width of 10 points around each share, so that 20 points tell two apart.
    of = arrived / samples
    return Share(
        arrived=arrived,
        samples=samples,
        share=of,
        interval=(max(0.0, of - 0.1), min(1.0, of + 0.1)),
    )


def plan(
    pipeline: str,
    price: float,
    arrived: int,
    followed: int | None,
    *,
    warm: bool = False,
    exact: bool = True,
    weakest: str = "k",
    scene: str = "three_cart",
) -> RunRecord:
    certificate = CertificateRecord(
        holds=True, feasible=True, primal=0.0, complementarity=0.0, dual=None, strong=True,
        pairs=0, biactive=0, sentence=""
    )  # fmt: skip
    survey = Survey(
        alone=share(arrived), feedback=None if followed is None else share(followed), checked=10,
        differ=1, weakest=weakest, sizes=0.5, amount=-0.1,
        unit="N/m", by="replay_terminal_position_error",
    )  # fmt: skip
    changes: dict[str, Any] = {
        "cost": price,
        "verdict": "holds",
        "survey": survey,
        "certificate": certificate if exact else None,
    }
    template = factory.runs()[0]
    last = replace(
        template.stages[-1], **{**changes, "index": 1 if warm else 0, "method": pipeline}
    )
    stages = (
        (replace(template.stages[0], survey=None, verdict="violates"), last) if warm else (last,)
    )
    return replace(
        template,
        key=pipeline + scene,
        pipeline=pipeline,
        stages=stages,
        scene=factory.scene(scene),
        verdict="holds",
    )


def built(*runs: RunRecord) -> Any:
    return robustness.build(Report(Stored(None, runs), at="pages/"))


def test_conclusions_count_pairs_that_differ_by_more_than_chance():
    found = built(
        plan("cheap", 100.0, 20, 30), plan("middle", 110.0, 35, 80, warm=True),
        plan("dear", 120.0, 70, 40, exact=False),
        plan("elsewhere", 1.0, 90, None, scene="other"),
    )  # fmt: skip
    cheaper, warm, feedback, weakest = found.values["said"]
    assert cheaper == (
        "Do cheaper plans break sooner? That cannot be told yet: of 3 pairs of plans of one scene with different costs, the dearer one arrives in more worlds in 2, "
        "in fewer in 0; in the other 1 the difference may be chance."
    )
    assert (
        "That cannot be told yet: of 1 pair on one scene the one with a warm start arrives in more worlds in 0, in fewer in 0; the median difference is +15.0 points"
        in warm
    )
    assert (
        "Of 3 plans it surely raises the share in 1 and lowers it in 1; the median goes from 35 % of the worlds to 40 %"
        in feedback
    )
    assert "k (three_cart) in 3 and k (other) in 1 of 4 plans" in weakest
    assert found.said == cheaper


@pytest.mark.parametrize(
    ("cheap", "dear", "verdict"),
    [(80, 20, "No, dearer ones do"), (50, 55, "That cannot be told yet"), (20, 80, "Mostly")],
)
def test_the_answer_is_that_of_the_numbers(cheap: int, dear: int, verdict: str):
    runs = [
        plan(name, price, arrived, None, scene=f"scene_{number}")
        for number in range(5)
        for name, price, arrived in (("one", 100.0, cheap), ("two", 200.0, dear))
    ]
    assert f"sooner? {verdict}:" in built(*runs).values["said"][0]
    assert f"sooner? {'That cannot be told yet'}:" in built(*runs[:8]).values["said"][0]


def test_plans_that_cost_and_fare_the_same_count_once_and_stand_in_the_table():
    found = built(
        plan("one", 100.0, 20, None), plan("two", 100.0, 20, None), plan("three", 200.0, 60, None)
    )
    assert "of 1 pair" in found.values["said"][0]
    ((_, _, plot, plans),) = found.values["scenes"]
    assert [item.price for item in plans] == [100.0, 100.0, 200.0]
    assert sorted(mark.at for mark in drawn(plot).marks) == [
        (100.0, 0.2),
        (100.0, 0.2),
        (200.0, 0.6),
    ]


def test_the_page_has_every_plan_and_what_was_not_tried():
    refused = plan("free", 5.0, 0, None)
    stage = replace(refused.stages[-1], survey=Survey(message="scene x: it asks for no end."))
    text = Templates().render(
        "robustness.html#campaign",
        **(found := built(plan("cheap", 100.0, 20, 30), replace(refused, stages=(stage,)))).values,
        section=found,
    )
    assert [
        part
        for part in (
            "20.0 % (10.0 to 30.0 %) of 100 worlds",
            "30.0 %",
            "k by",
            "of its size",
            "1 of 10 otherwise",
            "it asks for no end",
        )
        if part not in text
    ] == []
    assert built(factory.runs()[0]) is None

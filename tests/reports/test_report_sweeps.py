"""Certificates, starts and fronts in the report: runs in parts told as one, the spread of optima, rows beside the front."""

from __future__ import annotations

import pytest

from reports.pages import tolerance
from reports.pages.run import spread
from reports.pages.section import Report
from reports.records.collected import collected, optima
from reports.records.load import load
from reports.records.record import CertificateRecord, FrontPointRecord, RunRecord, StageRecord, StartRecord
from reports.render import write_single

CERTIFICATE = CertificateRecord(
    holds=True, feasible=True, primal=1e-13, worst="constraint_goal_position[q1]", complementarity=0.0, dual=7e-13, letter="S",
    meaning="S: multipliers of all biactive pairs are non-negative", pairs=1000, biactive=2, least=0.275, unique=True, b_stationary=True,
    sentence="all is well",
)  # fmt: skip


def start(number: int, cost: float | None, outcome: str = "solved") -> StartRecord:
    return StartRecord(
        number=number, start=f"random {number}", outcome=outcome, cost=cost, windows=(("left", 131, 178), ("right", 276, 306)), seconds=1.0
    )


def part(factory, number: int, costs: list[float | None], **changes) -> RunRecord:
    whole = factory.run("strict", None, "strict_lcp", key=f"part-{number}", part=number, parts=2)
    solved = [cost for cost in costs if cost is not None]
    starts = tuple(start(2 * (number - 1) + place, cost) for place, cost in enumerate(costs))
    last = whole.stages[-1].model_copy(
        update={"cost": min(solved) if solved else None, "starts": starts, "method": "mpcc", "paper": {}, "certificate": CERTIFICATE}
    )
    return whole.model_copy(update={"pipeline": "mpcc_multistart", "stages": (last,), **changes})


def front_run(factory) -> RunRecord:
    points = tuple(
        FrontPointRecord(
            tolerance=within, outcome="solved", cost=cost, terminal_error=within, windows=(("left", 133, 179),), certificate=CERTIFICATE
        )
        for within, cost in ((0.0, 490.55), (1e-3, 390.4), (0.05, 282.2), (0.2, 166.7))
    )
    whole = factory.run("strict", None, "strict_lcp", key="front-0")
    last = whole.stages[-1].model_copy(update={"front": points, "method": "mpcc_front", "paper": {}})
    return whole.model_copy(update={"pipeline": "mpcc_front", "stages": (last,)})


def test_parts_become_one_run_with_the_cheapest_plan_and_all_starts(factory) -> None:
    other = factory.run("strict", None, "strict_lcp")
    told = collected([part(factory, 1, [495.6, 491.0]), other, part(factory, 2, [490.55, 490.55])])
    assert [run.pipeline for run in told] == ["mpcc_multistart", "strict"]
    whole = told[0]
    assert whole.key == "part-2"
    last = whole.stages[-1]
    assert last.cost == 490.55
    assert [item.number for item in last.starts] == [0, 1, 2, 3]
    assert last.seconds.stage == pytest.approx(2 * other.stages[-1].seconds.stage)
    assert whole.cpu_seconds == 2 * other.cpu_seconds
    assert "4 of 4 starts were solved, 3 distinct optima, from 490.55 to 495.6; 2 reached the cheapest" in whole.message
    assert told[1] is other


def test_a_part_that_is_missing_crashed_or_found_nothing_is_told(factory) -> None:
    (alone,) = collected([part(factory, 2, [490.55, None])])
    assert "Only 1 of the 2 parts" in alone.message
    assert "1 of 2 starts were solved" in alone.message
    (crashed,) = collected([part(factory, 1, [490.55, 490.55]), part(factory, 2, [491.0, 491.0], outcome="crashed", message="it died.")])
    assert crashed.outcome == "crashed"
    assert "it died." in crashed.message
    (nothing,) = collected([part(factory, 1, [None, None]), part(factory, 2, [None, None])])
    assert "None of 4 starts" in nothing.message


def test_a_plan_that_holds_goes_before_a_cheaper_one_that_does_not(factory) -> None:
    (whole,) = collected([part(factory, 1, [480.0], verdict="violates"), part(factory, 2, [490.55])])
    assert whole.verdict == "holds"
    assert whole.stages[-1].cost == 490.55
    (whole,) = collected([part(factory, 1, [480.0], verdict="holds with feedback"), part(factory, 2, [490.55])])
    assert whole.verdict == "holds", "by its inputs alone, though dearer"
    (whole,) = collected([part(factory, 1, [480.0], verdict="violates"), part(factory, 2, [490.55], verdict="holds with feedback")])
    assert whole.verdict == "holds with feedback"


def test_optima_that_differ_by_rounding_are_one() -> None:
    found = optima([start(0, 490.5495305), start(1, 490.5495305 * (1 + 1e-12)), start(2, 490.5496), start(3, None)])
    assert [(round(cost, 4), len(same)) for cost, same in found] == [(490.5495, 2), (490.5496, 1)]


def test_the_spread_says_how_many_and_how_far(factory) -> None:
    stage = part(factory, 1, [490.55, 490.55, 495.6, None]).stages[-1]
    told = spread(stage)
    assert told is not None
    assert told.plot is not None
    assert told.plot.markup().count("<title>") == 3
    for words in ("3 of 4 starts were solved (75", "490.55 at least", "490.55 in the median", "495.60 at most", "2 distinct optima"):
        assert words in told.words
    assert [len(optimum.starts) for optimum in told.optima] == [2, 1]
    assert told.optima[0].reached_from == "random 0 (0); random 1 (1)"
    assert [item.number for item in told.failed] == [3]
    assert spread(factory.run("strict", None, "strict_lcp").stages[-1]) is None
    none = spread(stage.model_copy(update={"starts": (start(0, None),)}))
    assert none is not None
    assert none.plot is None


def test_starts_of_nearly_one_cost_stand_on_one_another(factory) -> None:
    """From 100 to 200 a place is 2.5 wide."""
    stacked, apart = (spread(part(factory, 1, [100.0, near, 102.6, 200.0]).stages[-1]) for near in (101.0, 106.0))
    assert stacked is not None
    assert apart is not None
    assert stacked.plot is not None
    assert apart.plot is not None
    assert stacked.plot.height - apart.plot.height == 9


def test_the_least_known_cost_lies_between_neighbours(factory) -> None:
    points = front_run(factory).stages[-1].front
    assert tolerance.least_within(points, 0.0) == (390.4, 490.55)
    assert tolerance.least_within(points, 0.1) == (166.7, 282.2)
    assert tolerance.least_within(points, 0.5) == (None, 166.7)
    assert tolerance.least_within(points[1:], 1e-6) == (390.4, None)


@pytest.mark.slow
def test_rows_stand_beside_the_front(factory, tmp_path) -> None:
    report = Report(load(factory.store(tmp_path / "all", [*factory.runs(), front_run(factory)])))
    section = tolerance.build(report, report.scenes[0])
    assert section is not None
    (view,) = section.values["views"]
    assert len(view.beside) == len([row for row in report.rows if row.stage.cost is not None]) - 1
    assert view.plot.markup(False).count('class="pt front"') == 4
    for item in view.beside:
        loose, tight = tolerance.least_within(view.points, item.missed)
        assert item.above.endswith("%") is (tight is not None and item.price > tight * (1 + 1e-6)) or item.above in (
            "on it",
            "between its points",
            "looser than all its points",
        )
        if item.above.startswith("below"):
            assert loose is not None
            assert item.price < loose
    without = Report(load(factory.store(tmp_path / "none", factory.runs())))
    assert tolerance.build(without, without.scenes[0]) is None


def test_windows_are_read_contact_by_contact() -> None:
    assert tolerance.windows_text((("left", 1, 2), ("right", 5, 6), ("left", 8, 9))) == "left 1–2, 8–9; right 5–6"
    assert tolerance.windows_text(()) == ""


def test_the_page_shows_certificate_starts_and_front(factory, tmp_path) -> None:
    records = [part(factory, 1, [495.6, 491.0]), part(factory, 2, [490.55, None]), front_run(factory)]
    text = write_single(factory.store(tmp_path / "all", records)).read_text(encoding="utf-8")
    for words in (
        "judged by code that shares nothing with the solver", "class S", "the only ones there are", "2 pairs have", "multipliers of at least 0.275",
        "Distinct optima", "Cost of every start", "Least cost within a terminal tolerance", "left 133–179", "constraint_goal_position[q1]",
    ):  # fmt: skip
        assert words in text, words
    assert text.count("<h3 id=") >= 2


def test_records_of_before_still_load(factory) -> None:
    """Certificate, starts, front and parts are new and optional."""
    old = factory.run("strict", None, "strict_lcp").model_dump()
    for name in ("part", "parts"):
        del old[name]
    for stage in old["stages"]:
        for name in ("certificate", "starts", "front"):
            del stage[name]
    record = RunRecord.model_validate(old)
    assert record.parts == 1
    assert isinstance(record.stages[0], StageRecord)
    assert record.stages[0].certificate is None

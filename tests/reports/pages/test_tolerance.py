"""Least cost within each terminal tolerance: where the front runs, and what is said of each row beside it."""

import pytest
from wording import unsaid

from reports.pages import pareto
from reports.pages.section import Report
from reports.records.load import Stored
from reports.records.record import FrontPointRecord, RunRecord
from tests.reports.drawn import Mark, drawn
from tests.reports.record_factory import judged, ran

POINTS = (
    FrontPointRecord(tolerance=0.1, outcome="solved", cost=100.0, terminal_error=0.09,
                     windows=(("left", 1, 2), ("right", 5, 6), ("left", 3, 4))),
    FrontPointRecord(tolerance=0.0, outcome="solved", cost=400.0, terminal_error=1e-9),
    FrontPointRecord(tolerance=0.01, outcome="solved", cost=200.0, terminal_error=0.008),
    FrontPointRecord(tolerance=0.05, outcome="infeasible"),
)  # fmt: skip


def row(name: str, missed: float | None, cost: float | None, kind: str = "direct") -> RunRecord:
    return ran(
        name,
        *(() if missed is None else (judged("discrete_terminal_error", missed, "m, m/s"),)),
        cost=cost,
        kind=kind,
    )


def view(*rows: RunRecord, points: tuple[FrontPointRecord, ...] = POINTS):
    report = Report(Stored(None, (ran("front", cost=400.0, front=points), *rows)))
    section = pareto.within_tolerance(report, report.scenes[0])
    assert section.anchor == "tolerance-1"
    (found,) = section.values["views"]
    return found


@pytest.mark.parametrize(
    ("missed", "cost", "least", "above"),
    [
        (0.5, 50.0, "100.00", "looser than all its points"), (0.5, 100.0, "100.00", "on it"),
        (0.5, 110.0, "100.00", "+10\u202f%"),
        (0.02, 150.0, "100.00 to 200.00", "between its points"),
        (0.02, 200.0, "100.00 to 200.00", "on it"), (0.02, 250.0, "100.00 to 200.00", "+25\u202f%"),
        (0.02, 99.0, "100.00 to 200.00", "below the front: a better front exists"),
        (0.02, 100.0, "100.00 to 200.00", "between its points"),
        (0.01, 200.0, "100.00 to 200.00", "on it"),
        (0.0099, 250.0, "200.00 to 400.00", "between its points"),
        (0.0025, 300.0, "200.00 to 400.00", "between its points"),
        (0.0024, 300.0, "400.00", "−25\u202f%, for missing the goal by more"),
        (0.0, 400.0, "400.00", "on it"), (0.0024, 500.0, "400.00", "+25\u202f%"),
        (0.02, 200.0 * (1 + 2e-6), "100.00 to 200.00", "0.00\u202f%"),
        (0.02, 200.0 * (1 - 2e-6), "100.00 to 200.00", "between its points"),
        (0.02, 200.0 * (1 - 0.5e-6), "100.00 to 200.00", "on it"),
        (0.02, 200.0 * (1 + 0.5e-6), "100.00 to 200.00", "on it"),
        (0.02, 100.0 * (1 - 0.5e-6), "100.00 to 200.00", "between its points"),
        (0.02, 100.0 * (1 - 2e-6), "100.00 to 200.00", "below the front: a better front exists"),
        (0.01 * (1 - 0.5e-6), 200.0, "100.00 to 200.00", "on it"),
        (0.01 * (1 - 2e-6), 200.0, "200.00 to 400.00", "between its points"),
    ],
)  # fmt: skip
def test_what_a_row_costs_beside_plans_that_end_as_near(
    missed: float, cost: float, least: str, above: str
):
    (item,) = view(row("one", missed, cost)).beside
    assert (item.missed, item.price, item.least, item.above) == (missed, cost, least, above)


def test_nearer_than_all_points():
    points = POINTS[2:3]
    (item,) = view(row("one", 0.005, 100.0), points=points).beside
    assert (item.least, item.above) == (
        "no point is as near",
        "below the front: a better front exists",
    )
    (item,) = view(row("one", 0.005, 900.0), points=points).beside
    assert (item.least, item.above) == ("no point is as near", "between its points")
    assert pareto.least_within(POINTS[2:3], 0.005) == (200.0, None)
    assert pareto.least_within(tuple(sorted(POINTS, key=lambda point: point.tolerance)), 0.02) == (
        100.0,
        200.0,
    )


def test_the_front_and_rows_are_drawn_at_their_errors():
    found = view(
        row("exact", 1e-9, 400.0),
        row("soft", 0.02, 150.0, "indirect"),
        row("unpriced", 0.1, None),
        row("lost", None, 5.0),
    )
    assert [item.row.label for item in found.beside] == ["exact", "soft"]
    assert [point.tolerance for point in found.points] == [0.0, 0.01, 0.05, 0.1]
    assert found.link == "pages/front-key.html"
    plot = found.plot
    assert drawn(plot).lines == {"front": ("front", [(2.5e-3, 400.0), (0.01, 200.0), (0.1, 100.0)])}
    link = "pages/front-key.html"
    assert drawn(plot).marks == [
        Mark("front", "diamond", "Within 0: cost 400.00, terminal error 1.0×10⁻⁹", link,
             (2.5e-3, 400.0)),
        Mark("front", "diamond", "Within 0.010: cost 200.00, terminal error 0.0080", link,
             (0.01, 200.0)),
        Mark("front", "diamond",
             "Within 0.10: cost 100.00, terminal error 0.090, left 1–2, 3–4; right 5–6", link,
             (0.1, 100.0)),
        Mark("direct", "square", "exact: cost 400.00, terminal error 1.0×10⁻⁹, least known 400.00",
             "pages/exact-key.html", (2.5e-3, 400.0)),
        Mark("indirect", "circle",
             "soft: cost 150.00, terminal error 0.020, least known 100.00 to 200.00",
             "pages/soft-key.html", (0.02, 150.0)),
    ]  # fmt: skip
    assert [words for style, words in drawn(plot).tags if style == "strong"] == ["exact"]
    assert not unsaid(
        plot.words,
        "3 points … cost 400.00 within 0 to 100.00 within 0.10; 2 stages. … less than 0.0025",
    )
    assert (plot.x.log, plot.y.log, plot.y.quantity, plot.width, plot.height) == (
        True,
        False,
        "cost",
        720,
        420,
    )
    assert (plot.y.low, plot.y.high) == (pytest.approx(76.0), pytest.approx(424.0))
    assert plot.x.high == pytest.approx(0.1 * 10**0.12)
    assert [(key.style, key.marker) for key in plot.keys] == [
        ("front", ""),
        ("front", "diamond"),
        ("indirect", "circle"),
        ("direct", "square"),
    ]


@pytest.mark.parametrize(("price", "log"), [(2000.0, False), (2001.0, True), (-5.0, False)])
def test_costs_that_span_more_than_twenty_are_logarithmic(price: float, log: bool):
    assert view(row("one", 0.5, price)).plot.y.log is log


def test_a_front_of_the_exact_goal_alone_has_an_edge():
    found = view(row("one", 1e-9, 400.0), points=POINTS[1:2])
    assert drawn(found.plot).marks[0].at == (2.5e-4, 400.0)
    report = Report(Stored(None, (ran("none", cost=400.0, front=POINTS[3:]),)))
    assert pareto.within_tolerance(report, report.scenes[0]) is None

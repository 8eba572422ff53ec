"""Fig. 2 of the paper: measured points of the worst-case violation beside the closed form."""

import pytest

from models.results.run import ViolationPoint
from reports.load import Stored
from reports.pages import violation
from reports.pages.section import Report, Section
from tests.reports import record_factory as factory
from tests.reports.drawn import Mark, drawn
from tests.reports.record_factory import ran


def build(points: tuple[ViolationPoint, ...]) -> Section | None:
    """The section on the page of the paper's scene, in a campaign that measured these points."""
    run = ran("one")
    campaign = factory.campaign([run], violation=points)
    return violation.build(Report(Stored(campaign, (run,), (), (), 0, ())), run.scene)


def points() -> tuple[ViolationPoint, ...]:
    told = [
        ("softplus", 1.0, 9.0, 0.0), ("softplus", 0.1, 4.0, 2.0), ("softplus", 0.01, 1.0, 1.25),
        ("relaxed_lcp", 0.01, 0.011, 0.01),
        ("other", 0.5, 0.25, 0.5), ("softplus", 0.0, 1.0, 1.0),
    ]  # fmt: skip
    return tuple(
        ViolationPoint(law=law, eps=eps, measured=measured, closed_form=form)
        for law, eps, measured, form in told
    )


def test_the_worst_violation_is_drawn_against_eps():
    found = build(points())
    plot = found.values["plot"]
    assert drawn(plot).lines == {
        "softplus, closed form": ("c0 soft", [(0.01, 1.25), (0.1, 2.0), (1.0, 1e-200)]),
        "relaxed LCP, closed form": ("c1 soft", [(0.01, 0.01)]),
        "other, closed form": ("c2 soft", [(0.5, 0.5)]),
    }  # fmt: skip
    assert drawn(plot).marks == [
        Mark("c0", "circle", "softplus, ε = 10⁻²: D = 1 N²", "", (0.01, 1.0)),
        Mark("c0", "circle", "softplus, ε = 10⁻¹: D = 4 N²", "", (0.1, 4.0)),
        Mark("c0", "circle", "softplus, ε = 1: D = 9 N²", "", (1.0, 9.0)),
        Mark("c1", "square", "relaxed LCP, ε = 10⁻²: D = 0.011 N²", "", (0.01, 0.011)),
        Mark("c2", "diamond", "other, ε = 0.5: D = 0.25 N²", "", (0.5, 0.25)),
    ]  # fmt: skip
    assert found.values["worst"] == [
        ("softplus", 3, 9.0),
        ("relaxed LCP", 1, pytest.approx(0.1)),
        ("other", 1, pytest.approx(0.5)),
    ]
    assert [(name, formula, len(mine)) for name, formula, mine in found.values["laws"]] == [
        ("softplus", "D = (k L ln 2 / ln ε)²", 3), ("relaxed LCP", "D = ε", 1),
        ("other", "closed form", 1),
    ]  # fmt: skip
    assert plot.words.startswith(
        "softplus: D falls from 9.0 N² at ε = 1 to 1.0 N² at ε = 10⁻². relaxed LCP: D falls from 0.011 N² at ε = 10⁻² to 0.011"
    )
    assert found.values["force"] == pytest.approx(2.0**0.5 * 2.302585093 / 0.6931471806), (
        "at eps = 0.1, the first that is not 1"
    )
    assert [(key.style, key.marker) for key in plot.keys][:2] == [("c0 soft", ""), ("c0", "circle")]
    assert (plot.x.log, plot.y.log, plot.width, plot.height, plot.x.quantity, plot.y.quantity,
            plot.y.unit) == (
        True, True, 720, 360, "ε", "worst violation D", "N²",
    )  # fmt: skip
    assert ("c0", "softplus: D = (k L ln 2 / ln ε)²") in drawn(plot).tags
    assert build(()) is None
    assert build(points()[-1:]) is None
    assert build(points()[3:4]).values["force"] is None


def test_no_other_scene_and_no_campaign_without_its_record_has_the_figure():
    hill = ran("one", of=factory.scene("hill"))
    campaign = factory.campaign([hill], violation=points())
    assert violation.build(Report(Stored(campaign, (hill,), (), (), 0, ())), hill.scene) is None
    carts = ran("one")
    assert violation.build(Report(Stored(None, (carts,), (), (), 0, ())), carts.scene) is None

"""Fig. 2: what is measured through the compiled contact law is the closed form the paper did not find."""

import math

import pytest

from models.catalog import load_scene
from validate.tasks.paper import RELAXED_EPS, TOLERANCE, measure, relaxed_violation


@pytest.fixture(scope="module")
def points():
    return measure(load_scene("three_cart"))


def test_softplus_follows_the_closed_form(points):
    softplus = {point.eps: point for point in points if point.law == "softplus"}
    assert sorted(softplus) == pytest.approx([10.0**-power for power in range(12, 0, -1)])
    for eps, point in softplus.items():
        assert point.measured == pytest.approx((30.0 * math.log(2.0) / math.log(eps)) ** 2, rel=TOLERANCE)
        assert point.closed_form == pytest.approx((30.0 * math.log(2.0) / math.log(eps)) ** 2, rel=1e-14)


def test_softplus_scales_with_the_stiffness_of_the_scene():
    stiffer = measure(load_scene("three_cart").with_parameters(k=60.0))
    assert stiffer[2].measured == pytest.approx(4.0 * 9.061905828945655, rel=TOLERANCE)


def test_the_relaxed_lcp_permits_eps(points):
    relaxed = [point for point in points if point.law == "relaxed_lcp"]
    assert [point.eps for point in relaxed] == list(RELAXED_EPS)
    for point in relaxed:
        assert point.measured == pytest.approx(point.eps, rel=TOLERANCE)
    assert relaxed_violation(1e6, 1e-3) == pytest.approx(1e-3, rel=TOLERANCE)

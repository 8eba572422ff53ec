"""Fig. 2: the compiled contact law reaches the closed form that the paper did not find."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from validate.tasks import paper
from validate.tasks.paper import (
    RELAXED_EPS,
    SOFTPLUS_EPS,
    TOLERANCE,
    measure,
    paper_row,
    relaxed_violation,
    softplus_violation,
    table_rows,
)


@pytest.fixture(scope="module")
def points():
    return measure(load_scene("three_cart"))


def test_softplus_follows_the_closed_form(points):
    softplus = {point.eps: point for point in points if point.law == "softplus"}
    assert sorted(softplus) == pytest.approx([10.0**-power for power in range(12, 0, -1)])
    for eps, point in softplus.items():
        assert point.measured == pytest.approx(
            (30.0 * math.log(2.0) / math.log(eps)) ** 2, rel=TOLERANCE
        )
        assert point.closed_form == pytest.approx(
            (30.0 * math.log(2.0) / math.log(eps)) ** 2, rel=1e-14
        )


def test_softplus_scales_with_the_stiffness_of_the_scene():
    stiffer = measure(load_scene("three_cart").with_parameters(k=60.0))
    assert stiffer[2].measured == pytest.approx(4.0 * 9.061905828945655, rel=TOLERANCE)


def test_the_relaxed_lcp_permits_eps(points):
    relaxed = [point for point in points if point.law == "relaxed_lcp"]
    assert [point.eps for point in relaxed] == list(RELAXED_EPS)
    for point in relaxed:
        assert point.measured == pytest.approx(point.eps, rel=TOLERANCE)
    assert relaxed_violation(1e6, 1e-3) == pytest.approx(1e-3, rel=TOLERANCE)


def test_a_scene_without_contacts_has_no_violation():
    assert measure(SimpleNamespace(nc=0)) == ()  # type: ignore[arg-type]


def test_each_point_stands_beside_its_own_closed_form(monkeypatch: pytest.MonkeyPatch):
    """With searches that answer what they are asked: the first contact's stiffness, and eps."""
    monkeypatch.setattr(paper, "softplus_violation", lambda kernel, path, eps: 7.0 + eps)
    monkeypatch.setattr(paper, "relaxed_violation", lambda stiffness, eps: stiffness + eps)
    found = measure(load_scene("three_cart"))
    assert [(point.law, point.eps, point.measured) for point in found[:2]] == [
        ("softplus", 0.1, 7.1),
        ("softplus", 0.01, 7.01),
    ]
    relaxed = found[len(SOFTPLUS_EPS) :]
    assert [(point.law, point.eps, point.measured, point.closed_form) for point in relaxed] == [
        ("relaxed_lcp", 10.0**-power, 30.0 + 10.0**-power, 10.0**-power) for power in range(1, 9)
    ]


@pytest.mark.parametrize("peak", [-0.9, -0.3, 0.0, 0.45, 0.97])
def test_the_peak_is_found_wherever_it_lies(peak: float):
    assert paper._golden_section(lambda x: 3.0 - (x - peak) ** 2, -1.0, 1.0) == pytest.approx(
        3.0, abs=1e-15
    )
    asked: list[float] = []
    assert paper._golden_section(
        lambda x: asked.append(x) or -abs(x - peak), -1.0, 1.0
    ) == pytest.approx(0.0, abs=1e-11)
    assert len(asked) == 62, "each cut asks once"


def test_a_path_leads_through_the_first_contact_by_the_given_depth():
    """Of a scene whose first contact has a slope of another length than 1, and from a start that is not in touch."""
    for name in ("three_cart", "hopper", "two_discs"):
        scene = load_scene(name)
        kernel = load_kernel(scene)
        path = paper._through_contact(scene, kernel)
        near = 1e-4 * np.array([-1.0, 0.0, 2.0])
        at = kernel.penetration(path(near))[:, 0]
        assert np.diff(at) == pytest.approx(np.diff(near), rel=1e-2)


def test_softplus_is_searched_on_either_side_of_the_touch():
    """A force of its own making, whose violation is largest a width away from the touch: it is found, and not where the law has it."""
    scene = load_scene("three_cart")
    width = 40.0 / paper.sharpness(1e-3, scene.length)
    for place in (-0.5 * width, 0.25 * width):
        kernel: Any = SimpleNamespace(
            scene=scene, stiffness=lambda: np.array([2.0, 9.0]),
            penetration=lambda q: np.column_stack([q[:, 0], 7.0 + 0 * q[:, 0]]),
            # lam (lam - 2 phi) = 4 exp(-(phi - place)^2)
            contact_force=lambda q, law, eps,
            place=place: np.column_stack([q[:,
                                            0] + np.sqrt(q[:,
                                                0] ** 2 + 4.0 * np.exp(-((q[:, 0] - place) ** 2))),
                                                5.0 + 0 * q[:, 0]]),
        )  # fmt: skip
        assert softplus_violation(
            kernel, lambda depth: np.asarray(depth)[:, None], 1e-3
        ) == pytest.approx(4.0, abs=1e-12)


def test_rows_of_the_papers_table_belong_to_its_pipelines_and_scene_alone():
    """Table I, once more: cost of each row that a pipeline of the paper goes through."""
    costs = {
        name: [row.numbers["cost"] for row in table_rows(name)]
        for name in ("relu_gd", "relaxed+strict", "softplus_dc+relu_gd", "softplus_dc+strict")
    }
    softplus = [197.86, 261.23, 339.53]
    assert costs == {
        "relu_gd": [542.56], "relaxed+strict": [484.21, 561.0, 469.94, 46415.2],
        "softplus_dc+relu_gd": [*softplus, 360.31],
        "softplus_dc+strict": [*softplus, 16619.35],
    }  # fmt: skip
    assert paper_row("three_cart", "softplus_dc+strict", 3)["cost"] == 16619.35
    assert dict(paper_row("three_cart", "softplus_dc+strict", 0)) == {
        "cost": 197.86,
        "stability": 0.0,
        "physics": 2445.98,
        "time": 11.64,
    }
    for scene, pipeline, stage in (
        ("hopper", "softplus_dc+strict", 0),
        ("three_cart", "mpcc", 0),
        ("three_cart", "no_such", 0),
        ("three_cart", "softplus_dc+strict", 4),
    ):
        assert dict(paper_row(scene, pipeline, stage)) == {}

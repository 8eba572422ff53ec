"""Certificates in the report."""

from dataclasses import replace
from html import unescape

import pytest
from wording import unsaid

from models.results.run import CertificateRecord
from reports.render import write_single

CERTIFICATE = CertificateRecord(
    holds=True, feasible=True, primal=1e-13, worst="constraint_goal_position[q1]",
    complementarity=0.0, dual=7e-13, strong=True, pairs=1000, biactive=2, b_stationary=True,
    sentence="all is well",
)  # fmt: skip


OBSTACLE = "the first side of 'contact[3]' has the multiplier -2"


def _page(factory, tmp_path, certificate: CertificateRecord) -> str:
    run = factory.run("strict", None, "strict_lcp")
    last = replace(run.stages[-1], certificate=certificate)
    records = [replace(run, stages=(last,))]
    return write_single(factory.store(tmp_path / "all", records)).read_text(encoding="utf-8")


def test_page_strong_plan_shows_residuals_and_pairs(factory, tmp_path) -> None:
    text = _page(factory, tmp_path, CERTIFICATE)
    assert not unsaid(
        text, "multipliers computed again from the model", ">S-stationary<",
        "2 pairs have both sides zero, no multiplier of these is negative",
        "constraint_goal_position[q1]",
    )  # fmt: skip


@pytest.mark.parametrize(("b_stationary", "words"), [
    (True, "; B-stationary: no direction goes down"),
    (False, "; not B-stationary: a direction goes down"), (None, "-2<"),
])  # fmt: skip
def test_page_plan_that_is_not_strong_names_the_obstacle(
    factory, tmp_path, b_stationary, words
) -> None:
    weak = {"strong": False, "obstacle": OBSTACLE, "b_stationary": b_stationary}
    text = unescape(_page(factory, tmp_path, replace(CERTIFICATE, **weak)))
    assert not unsaid(text, ">not S-stationary<", OBSTACLE, words)

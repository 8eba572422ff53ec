"""Certificates in the report."""

from wording import unsaid

from reports.records.record import CertificateRecord
from reports.render import write_single

CERTIFICATE = CertificateRecord(
    holds=True, feasible=True, primal=1e-13, worst="constraint_goal_position[q1]",
    complementarity=0.0, dual=7e-13, letter="S",
    meaning="S: multipliers of all biactive pairs are non-negative", pairs=1000, biactive=2,
    least=0.275, unique=True, b_stationary=True,
    sentence="all is well",
)  # fmt: skip


def test_the_page_shows_the_certificate(factory, tmp_path) -> None:
    run = factory.run("strict", None, "strict_lcp")
    last = run.stages[-1].model_copy(update={"certificate": CERTIFICATE})
    records = [run.model_copy(update={"stages": (last,)})]
    text = write_single(factory.store(tmp_path / "all", records)).read_text(encoding="utf-8")
    assert not unsaid(
        text, "judged by code that shares nothing with the solver", "class S",
        "the only ones there are", "2 pairs have",
        "multipliers of at least 0.275",
        "constraint_goal_position[q1]",
    )  # fmt: skip

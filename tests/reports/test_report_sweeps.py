"""Certificates, starts and fronts in the report: runs in parts told as one, the spread of optima, rows beside the front."""

from wording import unsaid

from reports.records.record import CertificateRecord, FrontPointRecord, RunRecord, StartRecord
from reports.render import write_single

CERTIFICATE = CertificateRecord(
    holds=True, feasible=True, primal=1e-13, worst="constraint_goal_position[q1]",
    complementarity=0.0, dual=7e-13, letter="S",
    meaning="S: multipliers of all biactive pairs are non-negative", pairs=1000, biactive=2,
    least=0.275, unique=True, b_stationary=True,
    sentence="all is well",
)  # fmt: skip


def start(number: int, cost: float | None, outcome: str = "solved") -> StartRecord:
    return StartRecord(
        number=number,
        start=f"random {number}",
        outcome=outcome,
        cost=cost,
        windows=(("left", 131, 178), ("right", 276, 306)),
        seconds=1.0,
    )


def part(factory, number: int, costs: list[float | None], **changes) -> RunRecord:
    whole = factory.run("strict", None, "strict_lcp", key=f"part-{number}", part=number, parts=2)
    solved = [cost for cost in costs if cost is not None]
    starts = tuple(start(2 * (number - 1) + place, cost) for place, cost in enumerate(costs))
    last = whole.stages[-1].model_copy(
        update={
            "cost": min(solved) if solved else None,
            "starts": starts,
            "method": "mpcc",
            "paper": {},
            "certificate": CERTIFICATE,
        }
    )
    return whole.model_copy(update={"pipeline": "mpcc_multistart", "stages": (last,), **changes})


def front_run(factory) -> RunRecord:
    points = tuple(
        FrontPointRecord(
            tolerance=within,
            outcome="solved",
            cost=cost,
            terminal_error=within,
            windows=(("left", 133, 179),),
            certificate=CERTIFICATE,
        )
        for within, cost in ((0.0, 490.55), (1e-3, 390.4), (0.05, 282.2), (0.2, 166.7))
    )
    whole = factory.run("strict", None, "strict_lcp", key="front-0")
    last = whole.stages[-1].model_copy(
        update={"front": points, "method": "mpcc_front", "paper": {}}
    )
    return whole.model_copy(update={"pipeline": "mpcc_front", "stages": (last,)})


def test_the_page_shows_certificate_starts_and_front(factory, tmp_path) -> None:
    records = [
        part(factory, 1, [495.6, 491.0]),
        part(factory, 2, [490.55, None]),
        front_run(factory),
    ]
    text = write_single(factory.store(tmp_path / "all", records)).read_text(encoding="utf-8")
    assert not unsaid(
        text, "judged by code that shares nothing with the solver", "class S",
        "the only ones there are", "2 pairs have",
        "multipliers of at least 0.275", "Distinct optima", "Cost of every start",
        "Least cost within a terminal tolerance", "left 133–179",
        "constraint_goal_position[q1]",
    )  # fmt: skip
    assert text.count("<h3 id=") >= 2

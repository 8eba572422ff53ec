"""Runs in parts shown as one: which plan, which words, and sums of all that was spent."""

import pytest
from wording import unsaid

from reports.records.load import collected, grouped, optima
from reports.records.record import RunRecord, SecondsRecord, StartRecord
from tests.reports import record_factory as factory


def start(number: int, cost: float | None) -> StartRecord:
    return StartRecord(number=number, start="random", outcome="solved" if cost is not None else "stalled", cost=cost)


def part(place: int, *costs: float | None, parts: int = 2, scene: str = "hill", **changes: object) -> RunRecord:
    """Of a run in two parts: the starts at these costs; seconds of the part's own place."""
    starts = tuple(start(10 * place - number, cost) for number, cost in enumerate(costs))
    cheapest = min((cost for cost in costs if cost is not None), default=None)
    run = factory.ran("many", of=factory.scene(scene), cost=cheapest, starts=starts, iterations=7 * place)
    seconds = SecondsRecord(**{name: float(place * (number + 1)) for number, name in enumerate(SecondsRecord.model_fields)})
    stages = tuple(stage.model_copy(update={"seconds": seconds, "message": "own"}) for stage in run.stages)
    said = {
        "key": f"{scene}-{place}", "part": place, "parts": parts, "wall_seconds": 3.0 * place, "cpu_seconds": 2.0 * place,
        "profile": {"replay": 1.0 * place}, "message": f"part {place}.",
    }  # fmt: skip
    return run.model_copy(update={"stages": stages} | said | changes)


@pytest.mark.parametrize(
    ("costs", "words"),
    [
        (((5.0, 4.0), (3.0, 4.0)), "4 of 4 starts … 3 distinct optima, from 3 to 5; 1 reached … part 2."),
        (((4.0, None), (4.0, 4.0)), "3 of 4 starts … all … at the same optimum; 3 reached … part 1."),
        (((4.0,), (4.0 * (1 + 2e-7),)), "2 of 2 starts … 2 distinct optima, from 4 to 4; 1 reached … part 1."),
        (((None, None), (None,)), "None of 3 starts was solved. part 1."), (((), ()), "part 1."),
    ],
)  # fmt: skip
def test_what_all_starts_came_to(costs: tuple, words: str):
    (whole,) = collected([part(1, *costs[0]), part(2, *costs[1])])
    assert whole.message == whole.stages[-1].message
    assert not unsaid(whole.message, words)


def test_seconds_steps_and_phases_are_those_of_all_parts():
    (whole,) = collected([part(1, 5.0, 4.0), part(2, 3.0, 6.0, profile={"imports": 4.0, "replay": 8.0})])
    (stage,) = whole.stages
    assert (whole.wall_seconds, whole.cpu_seconds, whole.profile, stage.iterations) == (9.0, 6.0, {"replay": 9.0, "imports": 4.0}, 21)
    assert list(stage.seconds.model_dump().values()) == [3.0 * number for number in range(1, 10)]
    assert [item.number for item in stage.starts] == [9, 10, 19, 20]
    assert stage.cost == 3.0


def test_a_part_that_is_missing_or_crashed_is_told():
    (alone,) = collected([part(2, 3.0, parts=4)])
    assert not unsaid(alone.message, "1 of 1 starts … the same optimum; 1 reached … Only 1 of the 4 parts … part 2.")
    (crashed,) = collected([part(1, 3.0), part(2, outcome="crashed", message="it died.")])
    assert (crashed.outcome, crashed.stages[-1].cost) == ("crashed", 3.0)
    assert crashed.message.endswith("reached the cheapest. it died.")
    (bare,) = collected([part(1, stages=()), part(2, stages=())])
    assert (bare.stages, bare.message, bare.outcome) == ((), "part 1.", "solved")
    (priced,) = collected([part(1, stages=()), part(2, 3.0)])
    assert priced.stages[-1].cost == 3.0


@pytest.mark.parametrize(
    ("verdicts", "best"),
    [
        (("violates", "holds"), 2), (("holds", "violates"), 1), (("holds with feedback", "holds"), 2), (("violates", "holds with feedback"), 2), (("consistent", "holds"), 2),
        (("violates", "undecided"), 2), (("holds", "holds"), 2),
    ],
)  # fmt: skip
def test_a_plan_that_holds_goes_before_a_cheaper_one(verdicts: tuple[str, str], best: int):
    """The second is cheaper."""
    (whole,) = collected([part(1, 5.0, verdict=verdicts[0]), part(2, 4.0, verdict=verdicts[1])])
    assert whole.part == best
    (other,) = collected([part(1, 4.0, verdict=verdicts[0]), part(2, 5.0, verdict=verdicts[1])])
    assert other.part == (1 if verdicts in (("consistent", "holds"), ("violates", "undecided"), ("holds", "holds")) else best)


def test_only_parts_of_one_run_on_one_scene_belong_together():
    whole = factory.ran("many", of=factory.scene("hill"))
    runs = [part(1, 5.0), whole, part(1, 5.0, scene="bank"), part(2, 4.0), part(2, 4.0, scene="bank")]
    assert [[run.key for run in group] for group in grouped(runs)] == [["hill-1", "hill-2"], ["many-key"], ["bank-1", "bank-2"]]
    assert collected([whole]) == (whole,)
    assert [(price, [item.number for item in same]) for price, same in optima([start(1, 2.0), start(2, None), start(3, 1.0), start(4, 1.0 + 0.9e-7), start(5, 1.0 + 2.5e-7)])] == [
        (1.0, [3, 4]), (1.0 + 2.5e-7, [5]), (2.0, [1]),
    ]  # fmt: skip
    assert [len(same) for _, same in optima([start(1, -1.0), start(2, -1.0 + 0.9e-7), start(3, 0.0), start(4, 0.0)])] == [2, 2]

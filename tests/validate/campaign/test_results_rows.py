"""results.csv: a row in which every value is another, read back column by column.

Rows without a replay, without a run, without a value.
"""

import csv
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from models.results.check import CheckRecord
from models.results.robustness import Share, Survey
from models.results.run import ReplayRecord, RunRecord, Seconds, StageRecord, ViolationPoint
from models.results.verdict import Metric
from tests.reports import record_factory as factory
from validate.campaign.results import (
    CHECKS,
    COLUMNS,
    RESULTS,
    VIOLATION,
    rows,
    tables,
    write_tables,
)
from validate.judge.score import metric_names

_FIRST = (
    "terminal_error", "physics", "physics_scaled", "defect", "discrete_terminal_error",
    "replay_terminal_error", "replay_terminal_position_error",
    "replay_terminal_velocity_error", "replay_error", "max_penetration", "ghost_impulse",
    "missed_impulse",
    "tracked_replay_terminal_error", "tracked_replay_error", "feedback_effort", "feedback_share",
)  # fmt: skip
METRICS = (*_FIRST, *(name for name in metric_names() if name not in (*_FIRST, "cost")))


def metric(name: str, value: float | None) -> Metric:
    return Metric(
        name=name,
        value=value,
        unit="m",
        meaning="what it means",
        limit=1000.0 + (value or 0.0),
        error=2000.0,
        reason="a test",
        ok=None,
    )


def stage(**changes: Any) -> StageRecord:
    values: dict[str, Any] = {
        "index": 6, "method": "relaxed_lcp", "method_title": "another title", "kind": "direct",
        "eps": 1e-4, "outcome": "stalled", "advice": "advice",
        "message": "a message", "cost": 490.1234567890123, "iterations": 77, "solver": "Ipopt",
        "seconds": Seconds(
            build=0.5, translate=0.0625, evaluate=1.125, linear_algebra=2.25,
            wall=4.5, cpu=5.5, total=6.75, replay=7.875
        ),
        "metrics": tuple(metric(name, 0.1 + number) for number, name in enumerate(METRICS)),
        "verdict": "holds with feedback", "why": "because",
        "replay": ReplayRecord(
            error_estimate=0.01, tolerance_difference=0.02, step_difference=0.03,
            everyday_difference=0.04, events=9, seconds_reference=8.0,
            seconds_everyday=9.0, judged="feedback", growth_rate=11.5,
        ),
        "survey": Survey(
            alone=Share(arrived=3, samples=256, share=3 / 256, interval=(0.0, 0.1)),
            checked=20, differ=1, weakest="gain of u1", sizes=0.375, amount=0.0075,
            feedback=Share(arrived=5, samples=64, share=5 / 64, interval=(0.0, 0.2)),
            unit="1", by="replay_cost",
        ),
    }  # fmt: skip
    return StageRecord(**(values | changes))


def run_of(template: RunRecord, *stages: StageRecord) -> RunRecord:
    return replace(template, pipeline="relaxed+strict", stages=stages)


@pytest.fixture(scope="module")
def template() -> RunRecord:
    return factory.runs()[0]


def read(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_every_value_stands_in_its_own_column(template: RunRecord):
    """In the order of the design."""
    (found,) = read(tables([run_of(template, stage())], (), ())[RESULTS])
    figures = {name: repr(0.1 + number) for number, name in enumerate(METRICS)}
    tracked = (
        "tracked_replay_terminal_error",
        "tracked_replay_error",
        "feedback_effort",
        "feedback_share",
    )
    expected = {
        "scene": "three_cart", "pipeline": "relaxed+strict", "stage": "7", "method": "relaxed_lcp",
        "eps": "0.0001", "outcome": "stalled",
        "cost": "490.1234567890123",
        **{name: figures[name] for name in _FIRST if name not in tracked},
        "verdict": "holds with feedback", "iterations": "77",
        "build_s": "0.5625", "solve_s": "3.375", "stage_s": "4.5", "stage_cpu_s": "5.5",
        "total_s": "6.75", "replay_s": "7.875", "judged": "feedback",
        **{name: figures[name] for name in tracked}, "growth_rate": "11.5",
        **{name: figures[name] for name in METRICS if name not in _FIRST}, "worlds": "256",
        "share_arriving": "0.01171875", "share_arriving_with_feedback": "0.078125",
        "weakest": "gain of u1", "weakest_sizes": "0.375",
    }  # fmt: skip
    assert list(found.items()) == list(expected.items())
    assert tuple(found) == COLUMNS
    assert len(set(found.values())) == len(COLUMNS), "or an exchange would not show"


def test_what_is_not_known_is_empty(template: RunRecord):
    refused = stage(
        index=0, outcome="refused", cost=None, eps=None, iterations=0, seconds=Seconds(),
        metrics=(metric("defect", None),), verdict="not applicable",
        replay=None, survey=None,
    )  # fmt: skip
    first, second = read(tables([run_of(template, refused, stage(index=1))], (), ())[RESULTS])
    known = {
        "scene": "three_cart", "pipeline": "relaxed+strict", "stage": "1", "method": "relaxed_lcp",
        "outcome": "refused",
        "verdict": "not applicable",
    }  # fmt: skip
    assert {name: value for name, value in first.items() if value} == known
    assert second["stage"] == "2"
    assert rows([run_of(template, refused)])[0]["iterations"] is None
    brief = stage(seconds=Seconds(wall=0.25), iterations=0)
    assert rows([run_of(template, brief)])[0]["iterations"] == 0


def test_a_check_is_told_by_what_it_found_or_by_why_it_did_not():
    one = CheckRecord(
        key="k", kind="fmu", name="three_cart, FMI 2.0", scene="three_cart", outcome="passed",
        passed=True, found="41 passed", message="unsaid",
        wall_seconds=1.5, cpu_seconds=2.5, expected="a sound FMU passes",
        provenance=factory.provenance(),
    )  # fmt: skip
    other = replace(
        one, name="other", outcome="crashed", passed=False, found="", message="signal 11"
    )
    found = read(tables((), [one, other], ())[CHECKS])
    assert found[0] == {
        "kind": "fmu", "name": "three_cart, FMI 2.0", "scene": "three_cart", "outcome": "passed",
        "passed": "True", "message": "41 passed",
        "wall_s": "1.5", "cpu_s": "2.5",
    }  # fmt: skip
    assert (found[1]["message"], found[1]["passed"]) == ("signal 11", "False")
    assert tables((), (), ())[CHECKS] == ""


def test_a_table_that_says_nothing_is_removed(template: RunRecord, tmp_path: Path):
    (tmp_path / CHECKS).write_text("kind,name\n")
    write_tables(tmp_path, [run_of(template, stage())], (), ())
    assert sorted(path.name for path in tmp_path.iterdir()) == [RESULTS, VIOLATION]


def test_a_violation_stands_beside_its_closed_form():
    points = [
        ViolationPoint(law="softplus", eps=0.01, measured=measured, closed_form=4.0)
        for measured in (5.0, 3.0)
    ]
    assert tables((), (), points)[VIOLATION].splitlines() == [
        "law,eps,measured,closed_form,relative_difference", "softplus,0.01,5.0,4.0,0.25",
        "softplus,0.01,3.0,4.0,0.25",
    ]  # fmt: skip

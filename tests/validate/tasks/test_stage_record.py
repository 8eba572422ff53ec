"""The record of a stage says of each metric what the judge says, number by number; what is not known is not 0."""

from __future__ import annotations

import math

import pytest

from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from reports.records.record import MetricRecord
from validate.judge.score import Question, Score, Verdict
from validate.judge.score.verdict import Metric
from validate.tasks.leg import Planned
from validate.tasks.records import Judged, stage_record


def metric(**changes) -> Metric:
    said = {
        "name": "replay_error", "question": Question.MOTION, "value": 1.5, "unit": "m", "meaning": "far", "error": 0.25, "limit": 2.5,
        "reason": "r", "ok": True, "default": False,
    }  # fmt: skip
    return Metric(**(said | changes))


def recorded(judged: Metric) -> MetricRecord:
    method = load_method("strict_lcp")
    planned = Planned(index=0, name="strict_lcp", method=method, eps=None, options=method.read_options({}))
    record = stage_record(
        load_scene("three_cart"), planned, Solution(method="strict_lcp", outcome=Outcome.SOLVED, trajectory=None, cost=None), 0,
        wall=1.0, cpu=1.0, before=0.0, judged=Judged(score=Score(metrics=(judged,), verdict=Verdict.HOLDS, why="so")),
    )  # fmt: skip
    (found,) = record.metrics
    return found


def test_every_field_of_a_metric_stands_in_its_own():
    assert recorded(metric()) == MetricRecord(
        name="replay_error", value=1.5, unit="m", meaning="far", question=Question.MOTION.number, error=0.25, limit=2.5, reason="r", ok=True,
        default=False,
    )  # fmt: skip


@pytest.mark.parametrize(("error", "said"), [(0.0, 0.0), (-0.0, 0.0), (1e-9, 1e-9), (math.inf, None), (math.nan, None)])
def test_an_error_that_is_not_known_is_not_recorded_as_none(error: float, said: float | None):
    assert recorded(metric(error=error)).error == said


@pytest.mark.parametrize("value", [None, math.inf, math.nan])
def test_what_was_not_measured_has_no_value(value: float | None):
    assert recorded(metric(value=value, limit=math.inf, ok=None)).value is None

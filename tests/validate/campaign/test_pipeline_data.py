"""The pipelines of Table I are data: names, schedules, counts, and the paper's numbers beside them."""

import json

import pytest

from formulations.pipelines import (
    PIPELINES,
    QUICK,
    find_pipeline,
    load_method,
    pipeline_names,
    stage_plan,
)
from models.errors import UnknownNameError
from reports.paper import TABLE_1
from validate.tasks.leg import planned_stages
from validate.tasks.paper import paper_row, table_rows
from validate.tasks.task import RunTask, task_from_json, task_to_json

TABLE_ONE = (
    *("strict", "relu_gd", "relaxed+strict", "relaxed+relu_gd"),
    *("softplus_dc+strict", "softplus_dc+relu_gd", "softplus_gd+strict", "softplus_gd+relu_gd"),
)


def test_every_pipeline_of_table_one_is_there():
    assert pipeline_names()[: len(TABLE_ONE)] == TABLE_ONE
    assert len(set(pipeline_names())) == len(pipeline_names())


def test_schedules_and_counts_are_the_papers():
    stages = stage_plan(find_pipeline("softplus_gd+relu_gd"))
    assert [(leg.method, eps, options) for leg, eps, options in stages] == [
        ("softplus_gd", 1e-3, {"iterations": 15}), ("softplus_gd", 1e-5, {"iterations": 14}),
        ("softplus_gd", 1e-7, {"iterations": 11}),
        ("relu_gd", None, {"iterations": 10}),
    ]  # fmt: skip
    assert [eps for _, eps, _ in stage_plan(find_pipeline("relaxed+strict"))] == [
        1e-2,
        1e-3,
        1e-4,
        None,
    ]
    assert stage_plan(find_pipeline("relu_gd"))[0][2] == {"iterations": 200}
    assert stage_plan(find_pipeline("softplus_dc+relu_gd"))[-1][2] == {"iterations": 6}


def test_gd_converged_leaves_the_stopping_to_the_method():
    assert all(options == {} for _, _, options in stage_plan(find_pipeline("gd_converged")))


def test_quick_is_a_strict_subset():
    assert set(QUICK) < set(pipeline_names())


@pytest.mark.parametrize("pipeline", PIPELINES, ids=lambda pipeline: pipeline.name)
def test_methods_know_their_stages(pipeline):
    """Every method exists, takes its eps and knows its options."""
    methods = {leg.method: load_method(leg.method) for leg in pipeline.legs}
    planned = planned_stages(pipeline, methods)
    assert [stage.index for stage in planned] == list(range(len(planned)))


@pytest.mark.parametrize("pipeline", PIPELINES, ids=lambda pipeline: pipeline.name)
def test_json_keeps_a_pipeline(pipeline):
    """As what a child is given."""
    task = RunTask(
        key="k", scene="three_cart", scene_name="s", pipeline=pipeline, plugin="p", time_limit=1.0
    )
    again = task_from_json(json.loads(json.dumps(task_to_json(task))))
    assert isinstance(again, RunTask)
    assert stage_plan(again.pipeline) == stage_plan(pipeline)


def test_a_typo_is_answered():
    with pytest.raises(UnknownNameError, match=r"did you mean softplus_dc\+strict\?"):
        find_pipeline("softplus_dc+strickt")


@pytest.mark.parametrize("pipeline", PIPELINES, ids=lambda pipeline: pipeline.name)
def test_paper_rows_stand_one_a_stage(pipeline):
    rows = table_rows(pipeline.name)
    assert len(rows) in {0, len(stage_plan(pipeline))}
    assert bool(rows) == (pipeline.name in TABLE_ONE)
    assert paper_row("another_scene", pipeline.name, 0) == {}


def test_every_row_of_the_paper_stands_at_a_stage():
    carried = {row for pipeline in PIPELINES for row in table_rows(pipeline.name)}
    assert carried == set(TABLE_1)
    assert paper_row("three_cart", "softplus_gd+strict", 3)["cost"] == 3748.30

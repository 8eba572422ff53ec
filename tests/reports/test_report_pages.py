"""What the sections compute: rows, fronts, sweeps, the command that runs a cell again, and the paper's numbers."""

import shlex
from dataclasses import replace

import pytest

from reports.judged import again
from reports.load import load
from reports.pages.section import Report
from reports.paper import TABLE_1
from reports.rows import lacking
from validate.campaign.selection import matches


def report_of(factory, folder, runs) -> Report:
    return Report(load(factory.store(folder, runs)), folder)


@pytest.fixture
def converged(factory):
    """The same methods and eps as softplus_gd+relu_gd, other options, no row of the paper."""
    run = factory.run("softplus_gd+relu_gd", "softplus_gd", "relu_gd", key="converged-0")
    stages = tuple(
        replace(stage, paper={}, options={"iterations": "until converged"}) for stage in run.stages
    )
    return replace(run, pipeline="gd_converged", stages=stages)


def test_rows_follow_the_papers_order_and_share_stages(factory, tmp_path):
    report = report_of(factory, tmp_path / "all", factory.runs())
    assert [(row.methods, row.stage.eps) for row in report.rows] == [
        (row.methods, row.eps) for row in TABLE_1
    ]
    assert lacking(report.rows) == []
    warm = report.rows[10]
    assert warm.paper_total == pytest.approx(11.64 + 9.78 + 12.40 + 100.07)


@pytest.mark.slow
def test_the_command_runs_this_cell_again_and_no_other(factory, tmp_path, converged):
    report = report_of(factory, tmp_path / "all", [*factory.runs(), converged])
    for run in report.stored.runs:
        words = shlex.split(again(run))
        expression = words[words.index("-k") + 1]
        names = {
            other.pipeline: [
                "three_cart",
                other.pipeline,
                *(stage.method for stage in other.stages),
            ]
            for other in report.stored.runs
        }
        chosen = [
            pipeline
            for pipeline, own in names.items()
            if matches(expression, own, f"three_cart x {pipeline}")
        ]
        assert chosen == [run.pipeline]
        for name in ("in (one) leap", 'the "great" leap', '"', "it's"):
            odd = replace(run, pipeline=name)
            assert matches(shlex.split(again(odd))[-4], [], f"three_cart x {name}")

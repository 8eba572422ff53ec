"""`compare`: what got worse stands first and makes the exit code 1; noise of times does not."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from reports.records.load import load
from reports.records.record import RunRecord
from validate.store.compare import ChangeKind, Comparison, compare

_FACTORY = importlib.util.spec_from_file_location("record_factory_of_compare", Path(__file__).parents[2] / "reports" / "record_factory.py")
assert _FACTORY is not None
assert _FACTORY.loader is not None
factory = importlib.util.module_from_spec(_FACTORY)
_FACTORY.loader.exec_module(factory)


@pytest.fixture(scope="module")
def runs() -> list[RunRecord]:
    return factory.runs()


def changed_last(run: RunRecord, **changes) -> RunRecord:
    """The run with other values in its last stage."""
    last = run.stages[-1].model_copy(update=changes)
    return run.model_copy(update={"stages": (*run.stages[:-1], last)})


def compared(tmp_path: Path, before: list[RunRecord], after: list[RunRecord]) -> Comparison:
    return compare(load(factory.store(tmp_path / "before", before)), load(factory.store(tmp_path / "after", after)))


def direct(runs: list[RunRecord]) -> RunRecord:
    """A run whose last plan is direct, holds, was solved and has a cost."""
    return next(run for run in runs if run.stages[-1].kind == "direct" and run.verdict == "holds" and run.stages[-1].outcome == "solved")


@pytest.mark.slow
def test_a_campaign_does_not_differ_from_itself(tmp_path, runs):
    found = compared(tmp_path, runs, runs)
    assert found.changes == ()
    assert found.pairs == sum(len(run.stages) for run in runs)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"verdict": "violates"}, "verdict"),
        ({"verdict": "no plan", "outcome": "crashed"}, "verdict"),
        ({"outcome": "stalled"}, "outcome"),
    ],
)
def test_a_plan_that_got_worse_is_a_regression_and_the_way_back_an_improvement(tmp_path, runs, changes, what):
    run = direct(runs)
    worse = changed_last(run, **changes)
    there = compared(tmp_path / "there", [run], [worse])
    assert what in {change.what for change in there.regressions}
    assert there.changes[0].kind is ChangeKind.REGRESSION, "worst first"
    back = compared(tmp_path / "back", [worse], [run])
    assert back.regressions == ()
    assert {change.kind for change in back.changes} == {ChangeKind.IMPROVEMENT}


@pytest.mark.parametrize(("factor", "kind"), [(1 + 1e-3, ChangeKind.REGRESSION), (1 - 1e-3, ChangeKind.IMPROVEMENT), (1 + 1e-9, None)])
def test_costs_are_compared_beyond_rounding(tmp_path, runs, factor, kind):
    run = direct(runs)
    cost = run.stages[-1].cost or 1.0
    found = compared(tmp_path, [changed_last(run, cost=cost)], [changed_last(run, cost=cost * factor)])
    assert [change.kind for change in found.changes] == ([] if kind is None else [kind])


def test_a_cheaper_plan_that_no_longer_holds_is_no_progress(tmp_path, runs):
    run = direct(runs)
    cost = run.stages[-1].cost or 1.0
    found = compared(tmp_path, [changed_last(run, cost=cost)], [changed_last(run, cost=cost / 2, verdict="violates")])
    assert {change.what for change in found.changes} == {"verdict"}


def test_a_metric_that_left_its_limit_is_a_regression(tmp_path, runs):
    run = direct(runs)
    stage = run.stages[-1]
    place, metric = next((place, metric) for place, metric in enumerate(stage.metrics) if metric.ok)
    metrics = (*stage.metrics[:place], metric.model_copy(update={"ok": False}), *stage.metrics[place + 1 :])
    (change,) = compared(tmp_path, [run], [changed_last(run, metrics=metrics)]).changes
    assert (change.kind, change.what) == (ChangeKind.REGRESSION, metric.name)


def test_rows_that_are_gone_and_new_ones(tmp_path, runs):
    lost, kept = runs[0], runs[1]
    found = compared(tmp_path, [lost, kept], [kept])
    assert [change.kind for change in found.changes] == [ChangeKind.GONE] * len(lost.stages)
    assert len(found.regressions) == len(lost.stages)
    assert compared(tmp_path / "new", [kept], [lost, kept]).regressions == ()


def test_the_worst_change_stands_first(tmp_path, runs):
    """Of a change of each kind, whatever the names of their runs."""
    run = direct(runs)
    cost, cpu = run.stages[-1].cost or 1.0, run.stages[-1].seconds

    def scened(run: RunRecord, name: str, **changes) -> RunRecord:
        return changed_last(
            run.model_copy(update={"scene": run.scene.model_copy(update={"name": name}), "key": f"{name}-{run.key}"}), **changes
        )

    def taking(seconds: float) -> dict:
        return {"seconds": cpu.model_copy(update={"stage_cpu": seconds})}

    before = [
        scened(run, "u"),
        scened(run, "z"),
        scened(run, "y", **taking(10.0)),
        scened(run, "x", **taking(20.0)),
        scened(run, "w", cost=cost),
    ]
    after = [
        scened(run, "t"),
        scened(run, "z", verdict="violates"),
        scened(run, "y", **taking(20.0)),
        scened(run, "x", **taking(10.0)),
        scened(run, "w", cost=cost / 2),
    ]
    kinds = [change.kind for change in compared(tmp_path, before, after).changes]
    assert list(dict.fromkeys(kinds)) == [
        ChangeKind.REGRESSION,
        ChangeKind.GONE,
        ChangeKind.SLOWER,
        ChangeKind.NEW,
        ChangeKind.FASTER,
        ChangeKind.IMPROVEMENT,
    ]


def test_time_is_told_but_is_no_regression(tmp_path, runs):
    run = direct(runs)

    def taking(seconds: float) -> RunRecord:
        return changed_last(run, seconds=run.stages[-1].seconds.model_copy(update={"stage_cpu": seconds}))

    (change,) = compared(tmp_path / "slow", [taking(10.0)], [taking(20.0)]).changes
    assert change.kind is ChangeKind.SLOWER
    assert compared(tmp_path / "noise", [taking(0.1)], [taking(0.9)]).changes == ()
    assert compared(tmp_path / "alike", [taking(10.0)], [taking(14.0)]).changes == ()


def command(*words: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "validate", "compare", *map(str, words)],
        capture_output=True,
        text=True,
        env={**os.environ, "NO_COLOR": "1"},
        check=False,
    )


@pytest.mark.slow
def test_the_command_says_it_and_exits_with_one(tmp_path, runs):
    run = direct(runs)
    before, after = factory.store(tmp_path / "before", [run]), factory.store(tmp_path / "after", [changed_last(run, verdict="violates")])
    done = command(before, after)
    assert done.returncode == 1
    assert "holds" in done.stdout
    assert "violates" in done.stdout
    assert done.stdout.splitlines()[-1].endswith("in both campaigns; differences: 1 worse")
    assert command(before, before).returncode == 0
    told = json.loads(command(before, after, "--json").stdout)
    assert told["exit_code"] == 1
    assert told["changes"][0]["kind"] == "worse"


@pytest.mark.slow
def test_what_is_no_campaign_is_one_sentence(tmp_path):
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "nowhere"):
        done = command(folder, folder)
        assert done.returncode == 2
        assert len(done.stderr.strip().splitlines()) == 1
        assert str(folder) in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("text", ['{"x"', "{}", None])
def test_without_its_list_of_cells_nobody_knows_what_a_campaign_is(tmp_path, runs, text):
    """All records of the folder would be taken for it, those of campaigns before too, and what got worse be missed."""
    before, after = (factory.store(tmp_path / name, [direct(runs)]) for name in ("before", "after"))
    if text is None:
        (after / "campaign.json").unlink()
    else:
        (after / "campaign.json").write_text(text)
    done = command(before, after)
    assert (done.returncode, done.stdout) == (2, "")
    assert str(after / "campaign.json") in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_record_that_cannot_be_read_is_told(tmp_path, runs):
    run = direct(runs)
    before, after = (factory.store(tmp_path / name, [run]) for name in ("before", "after"))
    (after / "runs" / run.key / "record.json").write_text('{"x"')
    done = command(before, after)
    assert (done.returncode, done.stderr.startswith("warning: ")) == (2, True), "nothing else is stored there"
    assert str(Path("runs") / run.key / "record.json") in done.stderr

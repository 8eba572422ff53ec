"""Golden campaigns: the frozen rows are complete, and a comparison reports what got worse."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import golden
from formulations.pipelines import FREE_MOTION, PIPELINES
from reports.load import load


def row(**cells: str) -> golden.Row:
    """Return a solved exact stage of three_cart by mpcc, with these cells changed."""
    known = {"scene": "three_cart", "pipeline": "mpcc", "stage": "mpcc", "outcome": "solved"}
    figures = {"verdict": "holds", "iterations": "100", "cost": "490.55", "replay_error": "0.0069"}
    return dict.fromkeys(golden.COLUMNS, "") | known | figures | cells


def words(before: golden.Row, after: golden.Row) -> list[str]:
    return [word for word, _ in golden.compared([before], [after])]


def test_committed_campaigns_are_complete():
    rows = golden.frozen()
    assert len({golden.key_of(item) for item in rows}) == len(rows)
    runs = {(item["scene"], item["pipeline"]) for item in rows if item["stage"] != "check"}
    scenes = {scene for scene, _ in runs}
    nothing_to_plan = {scene for scene, pipeline in runs if pipeline == FREE_MOTION}
    assert runs >= {
        (scene, pipeline.name)
        for scene in scenes
        for pipeline in PIPELINES
        if pipeline.only in ("", scene)
        and (pipeline.name != FREE_MOTION or scene in nothing_to_plan)
    }
    assert len(scenes) >= 16
    costs = [
        float(item["cost"].split(golden.SEPARATOR)[0])
        for item in rows
        if (item["scene"], item["pipeline"]) == ("three_cart", "softplus_gd+relu_gd")
    ]
    assert costs == pytest.approx([149.17, 166.45, 215.14, 309.42], abs=0.02)


@pytest.mark.parametrize(
    ("before", "after", "word"),
    [
        ({}, {}, "kept"),
        ({}, {"cost": "495.4"}, "kept"),
        ({}, {"cost": "495.5"}, "worse"),
        ({}, {"cost": "400"}, "moved"),
        ({"cost": "671|749"}, {"cost": "755"}, "kept"),
        ({"cost": "671|749"}, {"cost": "757"}, "worse"),
        ({"verdict": "violates"}, {"verdict": "violates", "cost": "600"}, "moved"),
        ({"stage": "softplus_dc 1e-07"}, {"stage": "softplus_dc 1e-07", "cost": "600"}, "moved"),
        ({"outcome": "stalled"}, {"outcome": "stalled", "cost": "600"}, "moved"),
        ({}, {"verdict": "holds with feedback"}, "worse"),
        ({"verdict": "holds|violates"}, {"verdict": "undecided"}, "moved"),
        ({"verdict": "undecided"}, {"verdict": "violates"}, "worse"),
        ({"verdict": "violates"}, {"verdict": "holds"}, "moved"),
        ({"verdict": "passed"}, {"verdict": "failed"}, "worse"),
        ({}, {"verdict": "not applicable"}, "worse"),
        ({}, {"iterations": "300"}, "moved"),
        ({"iterations": "90|310"}, {"iterations": "300"}, "kept"),
        ({}, {"replay_error": ""}, "moved"),
        ({"answer_error": "0.0076124315"}, {"answer_error": "0.007612432"}, "kept"),
        ({"answer_error": "0.0076124315"}, {"answer_error": "0.00761245"}, "worse"),
        ({"answer_error": "0.0076124315"}, {}, "worse"),
    ],
)
def test_compared_row_word(before: dict[str, str], after: dict[str, str], word: str):
    found = words(row(**before), row(**after))
    assert found[0] == word


def test_compared_table_one_keeps_its_printed_digits():
    stage = {"pipeline": "softplus_dc+strict", "stage": "softplus_dc 1e-07", "verdict": "violates"}
    assert words(row(**stage, cost="339.524"), row(**stage, cost="339.535")) == ["kept"]
    assert words(row(**stage, cost="339.524"), row(**stage, cost="339.545")) == ["worse"]
    assert words(row(**stage, cost="300"), row(**stage, cost="301")) == ["kept"]


def test_compared_last_stage_of_another_method_is_judged_for_the_run():
    before, after = row(pipeline="best_exact"), row(pipeline="best_exact", stage="strict_lcp")
    assert words(before, after) == ["left", "new"]
    assert words(before, after | {"cost": "500"})[0] == "worse"
    assert words(before, after | {"verdict": "violates"})[0] == "worse"


def test_compared_missing_and_left_runs():
    gone = [word for word, _ in golden.compared([row()], [])]
    assert gone == ["missing", "left"]
    gone = [word for word, _ in golden.compared([row(pipeline="no_such_pipeline")], [])]
    assert gone == ["left"]


def test_merged_cells_hold_every_value_once():
    (found,) = golden.merged([[row()], [row(cost="490.6")], [row(cost="490.5500001")]])
    assert found["cost"] == "490.55|490.6"
    assert found["verdict"] == "holds"
    (again,) = golden.merged([[found], [row(cost="491")]])
    assert again["cost"] == "490.55|490.6|491"


@pytest.mark.slow
def test_equal_campaigns_differ_in_no_bit(tmp_path: Path, cli, monkeypatch: pytest.MonkeyPatch):
    for name in ("one", "two"):
        options = ("--scene", "bouncing_mass", "-k", "=free_motion", "--out", str(tmp_path / name))
        done = cli("all", *options, program="validate")
        assert done.returncode == 0, done.stderr
    assert golden._bits(tmp_path / "one") == golden._bits(tmp_path / "two")
    (run,) = load(tmp_path / "one").runs
    changed = replace(run.stages[0], iterations=7)
    assert golden.bits(changed) != golden.bits(run.stages[0])
    monkeypatch.setattr(golden, "GOLDEN", tmp_path / "golden.csv")
    first = list(golden.rows(tmp_path / "one"))
    golden.write(golden.merged([first]))
    assert golden.frozen() == first
    assert {word for word, _ in golden.compared(golden.frozen(), first)} == {"kept"}

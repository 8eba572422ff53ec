"""The golden campaign: what is frozen is whole, and what is compared is told as what it is."""

from pathlib import Path

import pytest

from benchmarks import golden
from formulations.pipelines import FREE_MOTION
from reports.records.load import load


def row(**words: str) -> golden.Row:
    return (
        dict.fromkeys(golden.COLUMNS, "")
        | {"verdict": "holds", "cost": "490.55", "bits": "a"}
        | words
    )


def test_the_committed_campaign_is_whole():
    rows, code = golden.frozen()
    assert code == "0"
    assert len({tuple(item[name] for name in golden.KEY) for item in rows}) == len(rows)
    runs = {(item["scene"], item["pipeline"]) for item in rows if item["stage"] != "0"}
    scenes, pipelines = ({run[place] for run in runs} for place in (0, 1))
    nothing_to_plan = {scene for scene, pipeline in runs if pipeline == FREE_MOTION}
    # What came later is new until a campaign is frozen with it: a scene or a method is added
    # without a campaign of all.
    assert runs == {
        (scene, pipeline)
        for scene in scenes
        for pipeline in pipelines
        if pipeline != FREE_MOTION or scene in nothing_to_plan
    }
    assert len(scenes) >= 16
    assert len(pipelines) >= 19
    assert all(len(item["bits"]) == 16 for item in rows if item["stage"] != "0" or item["fmu"])
    table_one = {
        item["method"] + item["eps"]: item["cost"]
        for item in rows
        if (item["scene"], item["pipeline"]) == ("three_cart", "softplus_gd+relu_gd")
    }
    costs = [float(cost) for cost in table_one.values()]
    assert costs == pytest.approx([149.17, 166.45, 215.14, 309.42], abs=0.02)


@pytest.mark.parametrize(
    ("after", "is_worse", "names"),
    [
        ({}, False, set()), ({"cost": "490.5500001"}, False, set()),
        ({"cost": "490.552"}, True, {"cost"}), ({"cost": "490.548"}, False, {"cost"}),
        ({"verdict": "holds with feedback"}, True, {"verdict"}),
        ({"verdict": "consistent"}, False, {"verdict"}), ({"verdict": "failed"}, True, {"verdict"}),
        ({"fmu": "0123"}, False, {"fmu"}), ({"cost": ""}, False, {"cost"}),
    ],
)  # fmt: skip
def test_what_moved_is_told_and_what_is_worse_is_told_as_that(
    after: dict[str, str], is_worse: bool, names: set[str]
):
    before, now = row(), row(**after)
    assert set(golden.differences(before, now)) == names
    assert golden.worse(before, now) is is_worse


def test_a_better_verdict_is_none_the_worse_for_its_cost():
    assert not golden.worse(row(verdict="violates", cost="1.0"), row(verdict="holds", cost="2.0"))
    assert not golden.worse(
        row(verdict="violates", cost="1.0"), row(verdict="violates", cost="2.0")
    ), "a plan that does not hold costs what it likes"


@pytest.mark.slow
def test_seconds_and_places_change_no_bits(tmp_path: Path, cli, monkeypatch: pytest.MonkeyPatch):
    """Two campaigns of one cell: other times, folders and commands, the same rows.

    What is frozen is read as what it was.
    """
    for name in ("one", "two"):
        done = cli(
            "all",
            "--scene",
            "bouncing_mass",
            "-k",
            "=free_motion",
            "--out",
            str(tmp_path / name),
            program="validate",
        )
        assert done.returncode == 0, done.stderr
    first, second = (list(golden.rows(tmp_path / name)) for name in ("one", "two"))
    assert first == second
    assert len(first) > 0
    (run,) = load(tmp_path / "one").runs
    changed = run.stages[0].model_copy(update={"iterations": 7})
    assert golden.bits(changed) != golden.bits(run.stages[0])
    monkeypatch.setattr(golden, "GOLDEN", tmp_path / "golden.csv")
    assert golden.freeze.callback is not None
    golden.freeze.callback(tmp_path / "one", 0)
    assert golden.frozen() == (first, "0")

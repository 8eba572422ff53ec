"""What a folder says of the campaign that it holds: which of its runs failed, and whether its records are of this version."""

import json
from pathlib import Path

import pytest

from reports.records.record import SCHEMA_VERSION
from tests.reports import record_factory as factory
from validate.plan.runs import only_last_failed
from validate.store.store import Store
from validate.store.stored import CAMPAIGN, CampaignError, campaign_text, earlier_schema, identity, with_others


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (json.dumps({"schema_version": SCHEMA_VERSION - 1}), f"schema {SCHEMA_VERSION - 1},"),
        (json.dumps({"schema_version": SCHEMA_VERSION + 1}), f"schema {SCHEMA_VERSION + 1},"),
        (json.dumps({"schema_version": "9" * 50}), f"schema {'9' * 20},"),
        (json.dumps({"schema_version": SCHEMA_VERSION}), ""),
        (json.dumps({}), ""),
        ("[", ""),
        (None, ""),
    ],
)
def test_records_of_another_version_are_named_and_run_again(text: str | None, named: str, tmp_path: Path):
    if text is not None:
        (tmp_path / CAMPAIGN).write_text(text, encoding="utf-8")
    sentence = earlier_schema(tmp_path)
    assert named in sentence
    assert bool(sentence) is bool(named)
    if named:
        assert str(tmp_path) in sentence
        assert f"schema {SCHEMA_VERSION}:" in sentence
        assert "run again" in sentence


@pytest.mark.parametrize("failures", [0, 1, 3, 4, 6])
def test_what_failed_and_is_not_selected_is_named_three_at_most(failures: int, tmp_path: Path):
    runs = []
    for number in range(6):
        verdict = "violates" if number < failures else "holds"
        run = factory.run("strict", None, "strict_lcp", key=f"strict-{number}", verdict=verdict)
        stages = tuple(stage.model_copy(update={"verdict": verdict}) for stage in run.stages)
        runs.append(run.model_copy(update={"pipeline": f"p{number}", "stages": stages}))
    store = Store(factory.store(tmp_path / "all", runs))
    for number, run in enumerate(runs):
        cell = {"scene_name": "three_cart", "scene": "three_cart", "pipeline": {"name": f"p{number}", "part": None, "legs": []}}
        (store.runs / run.key / "task.json").write_text(json.dumps({"task": cell}), encoding="utf-8")
    with pytest.raises(CampaignError, match="nothing that is selected failed") as error:
        only_last_failed((), store)
    said = str(error.value)
    named = [number for number in range(6) if f"p{number}" in said]
    assert named == list(range(min(failures, 3)))
    assert (f"and {failures - 3} more" in said) is (failures > 3)
    assert ("more" in said) is (failures > 3)
    assert ("drop --last-failed" in said) is (failures == 0)


def test_what_a_campaign_is_does_not_depend_on_when_and_how_it_was_called(tmp_path: Path) -> None:
    told = {"keys": ["a", "b"], "quick": False, "command": "first", "started": "1", "provenance": {"cpu": "x"}}
    (tmp_path / "campaign.json").write_text(json.dumps(told))
    before = campaign_text(tmp_path)
    (tmp_path / "campaign.json").write_text(json.dumps({**told, "command": "second", "started": "2"}, indent=1))
    assert campaign_text(tmp_path) == before != ""
    for change in ({"keys": ["a"]}, {"quick": True}, {"violation": [1]}):
        (tmp_path / "campaign.json").write_text(json.dumps({**told, **change}))
        assert campaign_text(tmp_path) != before


@pytest.mark.parametrize("text", ["", "[1]", "{half"])
def test_a_campaign_that_cannot_be_read_is_no_text(tmp_path: Path, text: str) -> None:
    (tmp_path / "campaign.json").write_text(text)
    assert campaign_text(tmp_path) == ""


def _asked(pipeline: str) -> dict:
    return {"scene_name": "three_cart", "scene": "three_cart", "pipeline": {"name": pipeline, "part": None, "legs": []}}


@pytest.mark.parametrize(
    ("part", "keys"),
    [
        (["b"], "abc"),
        (["c", "a"], "cab"),
        (["d"], "abcd"),
        (["b", "d"], "abcd"),
        (["B"], "aBc"),  # the same run, of other code
        ([], "abc"),
    ],
)
def test_a_part_leaves_the_others_where_they_are(part: list[str], keys: str, tmp_path: Path):
    store = Store(factory.store(tmp_path / "all", [factory.run("strict", None, "strict_lcp", key=key) for key in "abc"]))
    for key in "abc":
        (store.runs / key / "task.json").write_text(json.dumps({"task": _asked(key)}), encoding="utf-8")
    earlier, found = with_others(store, {identity(_asked(key.lower())): key for key in part})
    assert earlier is not None
    assert "".join(found) == keys


def test_what_cannot_be_read_does_not_stay(tmp_path: Path):
    store = Store(factory.store(tmp_path / "all", [factory.run("strict", None, "strict_lcp", key=key) for key in "abc"]))
    for key in "ab":
        (store.runs / key / "task.json").write_text(json.dumps({"task": _asked(key)}), encoding="utf-8")
    (store.runs / "b" / "record.json").unlink()
    assert with_others(store, {identity(_asked("d")): "d"})[1] == ("a", "d")
    (store.folder / CAMPAIGN).unlink()
    assert with_others(store, {identity(_asked("d")): "d"}) == (None, ("d",))

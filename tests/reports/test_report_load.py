"""Reading the records of a folder: what is broken is named, what is whole is kept."""

import json

import pytest
from wording import unsaid

from reports.records.load import ReportError, load

_BROKEN = {
    "cut short": lambda text: text[: len(text) // 2], "empty": lambda _: "", "not JSON": lambda _: "\x00\x01<html>", "a number": lambda _: "1",
    "another schema": lambda text: json.dumps(json.loads(text) | {"surprise": 1}),
    "a string for a number": lambda text: json.dumps(json.loads(text) | {"wall_seconds": "soon"}),
    "NaN": lambda text: json.dumps(json.loads(text) | {"wall_seconds": float("nan")}),
    "infinity": lambda text: json.dumps(json.loads(text) | {"cpu_seconds": float("inf")}), "deep": lambda _: "[" * 100_000,
    "another key": lambda text: json.dumps(json.loads(text) | {"key": "../../etc"}),
}  # fmt: skip


@pytest.mark.parametrize("name", _BROKEN)
def test_a_broken_record_is_named_and_the_rest_is_read(factory, tmp_path, name):
    good, bad = factory.runs()[:2]
    folder = factory.store(tmp_path / "all", [good, bad])
    path = folder / "runs" / bad.key / "record.json"
    path.write_text(_BROKEN[name](path.read_text()))
    stored = load(folder)
    assert [run.key for run in stored.runs] == [good.key]
    assert [item.path for item in stored.unreadable] == [f"runs/{bad.key}/record.json"]
    assert stored.unreadable[0].sentence.endswith(".")
    assert stored.missing == ()


def test_no_folder_is_one_sentence(tmp_path):
    with pytest.raises(ReportError, match="there is no such folder"):
        load(tmp_path / "nowhere")


def test_records_of_an_earlier_schema_are_refused_in_one_sentence(factory, tmp_path):
    """Those that the campaign lists are named, those that it does not are another campaign's."""
    good, old, older = factory.runs()[:3]
    folder = factory.store(tmp_path / "all", [good, old, older], factory.campaign([good, old]))
    for run in (old, older):
        path = folder / "runs" / run.key / "record.json"
        path.write_text(path.read_text().replace('"schema_version":5', '"schema_version":4'))
    stored = load(folder)
    assert [run.key for run in stored.runs] == [good.key]
    (item,) = stored.unreadable
    assert item.path == f"runs/{old.key}/record.json"
    assert not unsaid(item.sentence, "another version … reads 5) … run it again.")
    assert stored.foreign == 1


def test_a_campaign_of_an_earlier_schema_is_named_and_its_runs_are_read(factory, tmp_path):
    folder = factory.store(tmp_path / "all", factory.runs()[:2])
    path = folder / "campaign.json"
    path.write_text(path.read_text().replace('"schema_version":5', '"schema_version":4'))
    stored = load(folder)
    assert (stored.campaign, len(stored.runs)) == (None, 2)
    (item,) = stored.unreadable
    assert item.path == "campaign.json"
    assert not unsaid(item.sentence, "another version … reads 5) … run it again.")

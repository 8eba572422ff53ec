"""A report is left alone only while everything it is made of is older and the same."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from validate.store import standing_report as module
from validate.store.standing_report import campaign_text, standing_report

CAMPAIGN = {"keys": ["a", "b"], "quick": False, "command": "first", "started": "1", "provenance": {"cpu": "x"}}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A campaign's folder and a room of reports, older than the report."""
    root, out = tmp_path / "root", tmp_path / "out"
    monkeypatch.setattr(module, "ROOT", root)
    for path in (root / "reports/pages/page.py", out / "runs/a/record.json", out / "runs/b/record.json"):
        path.parent.mkdir(parents=True)
        path.write_text("{}")
        os.utime(path, (1e9, 1e9))
    (out / "campaign.json").write_text(json.dumps(CAMPAIGN))
    (out / "report.html").write_text("told")
    return out


def test_nothing_new(folder: Path) -> None:
    before = campaign_text(folder)
    (folder / "campaign.json").write_text(json.dumps({**CAMPAIGN, "command": "second", "started": "2"}, indent=1))
    assert standing_report(folder, before) == folder / "report.html"


@pytest.mark.parametrize("name", ["runs/a/record.json", "runs/c/record.json", "../root/reports/pages/page.py"])
def test_a_younger_source(folder: Path, name: str) -> None:
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text("{}")
    os.utime(folder / name, (4e9, 4e9))
    assert standing_report(folder, campaign_text(folder)) is None


@pytest.mark.parametrize("change", [{"keys": ["a"]}, {"quick": True}, {"violation": [1]}])
def test_another_campaign(folder: Path, change: dict[str, object]) -> None:
    before = campaign_text(folder)
    (folder / "campaign.json").write_text(json.dumps({**CAMPAIGN, **change}))
    assert standing_report(folder, before) is None


@pytest.mark.parametrize("text", ["", "[1]", "{half"])
def test_a_campaign_that_could_not_be_read(folder: Path, text: str) -> None:
    (folder / "campaign.json").write_text(text)
    assert campaign_text(folder) == ""
    assert standing_report(folder, "") is None


def test_no_report(folder: Path) -> None:
    (folder / "report.html").unlink()
    assert standing_report(folder, campaign_text(folder)) is None

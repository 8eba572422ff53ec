"""Records that are told when they are stored: the page is then put together without drawing one of them, and is the same page."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from pydantic import ValidationError

from reports import render as page
from reports import telling
from reports.outlines import Outlines
from reports.render import render
from reports.shelf import PLACE
from reports.telling import tell


@pytest.fixture
def folder(factory, tmp_path: Path) -> Path:
    return factory.store(tmp_path / "all", factory.runs()[:3])


@pytest.mark.parametrize("largest", [0, 10**9])
def test_the_page_is_put_together_of_what_was_told(folder: Path, largest: int, monkeypatch: pytest.MonkeyPatch):
    fresh = render(folder, largest=largest)
    shutil.rmtree(folder / PLACE)
    for path in sorted(folder.glob("runs/*/record.json")):
        tell(folder, path.read_bytes())
    monkeypatch.setattr(page, "written", lambda *_: pytest.fail("it was told before"))
    assert render(folder, largest=largest) == fresh


def test_what_is_no_record_is_said_and_nothing_is_kept(folder: Path):
    for text in (b"", b"{}", b'{"pipeline": 1}'):
        with pytest.raises(ValidationError):
            tell(folder, text)
    assert not (folder / PLACE).exists()


def test_a_record_that_changed_since_is_drawn_anew(folder: Path, monkeypatch: pytest.MonkeyPatch):
    path = next(folder.glob("runs/*/record.json"))
    tell(folder, path.read_bytes())
    record = json.loads(path.read_bytes())
    record["message"] = "another message altogether"
    path.write_text(json.dumps(record))
    assert "another message altogether".capitalize() in render(folder, largest=10**9)


def test_a_record_is_read_and_drawn_once(folder: Path, monkeypatch: pytest.MonkeyPatch):
    text = next(folder.glob("runs/*/record.json")).read_bytes()
    tell(folder, text)
    monkeypatch.setattr(telling, "written", lambda *_: pytest.fail("it was told before"))
    monkeypatch.setattr(Outlines, "whole", lambda *_: pytest.fail("nobody needs its traces"))
    tell(folder, text)

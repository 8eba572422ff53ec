"""A text is told again only while everything it is made of is the same; whatever happens to what was kept, the page is the same bytes."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from reports import kept as room
from reports.kept import content_digest, kept
from reports.render import render, write_report


@pytest.fixture
def folder(factory, tmp_path: Path) -> Path:
    return factory.store(tmp_path / "all", factory.runs()[:2])


def _page(folder: Path) -> bytes:
    return write_report(folder).read_bytes()


def _forbidden() -> str:
    raise AssertionError("it was to be told again, not made")


def test_the_same_bytes_made_and_told_again(folder: Path):
    fresh = render(folder).encode()
    assert _page(folder) == fresh
    (folder / "report.html").unlink()
    assert kept(folder, "report", _forbidden).encode() == fresh
    assert _page(folder) == fresh
    assert sorted(path.name for path in folder.iterdir()) == [".report.kept", ".told", "campaign.json", "report.html", "runs"]


@given(data=st.data())
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_any_changed_byte_of_any_input_is_another_text(folder: Path, data: st.DataObject):
    """Neither times nor lengths are looked at: one byte is flipped, and the time of the file set back."""
    (folder / ".told.kept").unlink(missing_ok=True)
    path = data.draw(st.sampled_from(sorted(folder.rglob("*.json"))))
    kept(folder, "told", lambda: "before")
    assert kept(folder, "told", _forbidden) == "before"
    was, stat = path.read_bytes(), path.stat()
    place = data.draw(st.integers(0, len(was) - 1))
    path.write_bytes(was[:place] + bytes([was[place] ^ data.draw(st.integers(1, 255))]) + was[place + 1 :])
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert kept(folder, "told", lambda: "after") == "after"
    path.write_bytes(was)
    assert kept(folder, "told", lambda: "again") == "again"


def test_files_that_come_go_and_are_renamed_are_noticed(folder: Path, tmp_path: Path):
    seen = {content_digest(folder)}
    runs = sorted((folder / "runs").iterdir())
    for change in (
        lambda: (runs[0] / "record.json").unlink(),
        lambda: (runs[0] / "record.json").mkdir(),
        lambda: shutil.rmtree(runs[0]),
        lambda: runs[1].rename(runs[1].with_name("other")),
        lambda: (folder / "campaign.json").unlink(),
    ):
        change()
        seen.add(content_digest(folder))
    renamed = folder.rename(tmp_path / "another")
    seen.add(content_digest(renamed))
    assert None not in seen
    # a record that is a folder is not there, as before
    assert len(seen) == 6


def test_a_change_of_our_sources_templates_or_libraries_is_noticed(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    place = tmp_path / "room"
    shutil.copytree(room._HERE, place, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(room, "_HERE", place)
    seen = {content_digest(folder)}
    for name in ("pages/runs.py", "templates/runs.html", "assets/report.css", "wording.py"):
        (place / name).write_text((place / name).read_text() + "\n")
        seen.add(content_digest(folder))
    (tmp_path / "outside.py").write_text("1")
    seen.add(content_digest(folder, [tmp_path / "outside.py"]))
    (tmp_path / "outside.py").write_text("2")
    seen.add(content_digest(folder, [tmp_path / "outside.py"]))
    monkeypatch.setattr(room.metadata, "version", lambda name: "99")
    seen.add(content_digest(folder))
    assert len(seen) == 8


@pytest.mark.parametrize("damage", [b"", b"half", b"\xff\xfe\n\x00", None])
def test_what_is_damaged_is_made_anew(folder: Path, damage: bytes | None):
    fresh = _page(folder)
    place = folder / ".report.kept"
    place.write_bytes(place.read_bytes()[:-7] if damage is None else damage)
    assert _page(folder) == fresh
    assert kept(folder, "report", _forbidden).encode() == fresh


def test_a_folder_in_its_place_or_one_that_takes_nothing_is_no_reason_to_fail(folder: Path, monkeypatch: pytest.MonkeyPatch):
    (folder / ".told.kept").mkdir()
    assert kept(folder, "told", lambda: "made") == "made"
    assert [path.name for path in folder.iterdir() if path.name.startswith(".partial")] == []

    def refuses(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(room.os, "replace", refuses)
    assert kept(folder, "other", lambda: "made") == "made"
    assert [path.name for path in folder.iterdir() if path.name.startswith((".partial", ".other"))] == []


def test_what_changed_while_the_text_was_made_is_not_kept(folder: Path):
    def make() -> str:
        (folder / "campaign.json").write_text("{}")
        return "of before"

    assert kept(folder, "told", make) == "of before"
    assert kept(folder, "told", lambda: "of now") == "of now"

"""Sections of runs and outlines of records are told again only for the same bytes; whatever happens to what was kept, the page is the same."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from reports import kept as room
from reports import render as page
from reports import split
from reports.outlines import Outlines
from reports.records.check_record import record_of
from reports.records.load import ReportError, load
from reports.render import render
from reports.shelf import PLACE, Shelf


@pytest.fixture
def folder(factory, tmp_path: Path) -> Path:
    """A chain with a sweep of eps, a short run, and a run in two parts."""
    chain, short = factory.runs()[2], factory.runs()[0]
    parts = [short.model_copy(update={"key": f"part-{place}", "pipeline": "parted", "part": place, "parts": 2}) for place in (1, 2)]
    return factory.store(tmp_path / "all", [chain, short, *parts])


def _anew(folder: Path) -> str:
    """The page of the same records, of which nothing is kept."""
    shutil.rmtree(folder / PLACE, ignore_errors=True)
    return render(folder)


def _flip(data: st.DataObject, path: Path) -> bytes:
    """Change one byte and set the time back; the bytes of before."""
    was, stat = path.read_bytes(), path.stat()
    place = data.draw(st.integers(0, len(was) - 1))
    path.write_bytes(was[:place] + bytes([was[place] ^ data.draw(st.integers(1, 255))]) + was[place + 1 :])
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    return was


@pytest.mark.parametrize("largest", [0, 10**9])
def test_the_same_page_told_again_without_reading_a_trace(folder: Path, largest: int, monkeypatch: pytest.MonkeyPatch):
    shutil.rmtree(folder / PLACE, ignore_errors=True)
    fresh = render(folder, largest=largest)

    def forbidden(*_: object) -> None:
        raise AssertionError("it was to be told again, not made")

    monkeypatch.setattr(page, "written", forbidden)
    monkeypatch.setattr(Outlines, "whole", forbidden)
    assert render(folder, largest=largest) == fresh


@given(data=st.data())
@settings(max_examples=4, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_a_changed_byte_of_a_record_or_of_what_is_kept_is_never_told(folder: Path, data: st.DataObject):
    fresh = _anew(folder)
    kept = data.draw(st.sampled_from(sorted(path.name for path in (folder / PLACE).iterdir())))
    _flip(data, folder / PLACE / kept)
    assert render(folder) == fresh
    record = data.draw(st.sampled_from(sorted(folder.glob("runs/*/record.json"))))
    was = _flip(data, record)
    assert render(folder) == _anew(folder)
    record.write_bytes(was)


def test_another_program_finds_nothing_and_what_nobody_asks_for_is_removed(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    place = tmp_path / "room"
    shutil.copytree(room._HERE, place, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(room, "_HERE", place)
    shelf = Shelf(folder)
    shelf.put("before", "section", "1")
    assert Shelf(folder).text("section", "1") == "before"
    assert Shelf(folder).text("section1", "") is None, "words are told apart"
    (place / "wording.py").write_text((place / "wording.py").read_text() + "\n")
    later = Shelf(folder)
    assert later.text("section", "1") is None
    later.put("after", "section", "1")
    later.tidy()
    assert len(list((folder / PLACE).iterdir())) == 1
    assert later.text("section", "1") == "after"


@pytest.mark.parametrize("damage", [b"", b"short", bytes(100)])
def test_what_is_damaged_is_as_none(folder: Path, damage: bytes):
    shelf = Shelf(folder)
    shelf.put("whole", "section")
    (path,) = (folder / PLACE).iterdir()
    path.write_bytes(damage)
    assert shelf.text("section") is None
    assert shelf.kept(lambda: "again", "section") == "again"
    assert shelf.text("section") == "again"


def test_a_file_in_its_place_is_no_reason_to_fail(folder: Path):
    fresh = _anew(folder)
    shutil.rmtree(folder / PLACE)
    (folder / PLACE).write_text("")
    assert render(folder) == fresh


def test_an_outline_is_its_record_without_traces(folder: Path, factory):
    outlines = Outlines(folder, lambda run: pytest.fail("not here") if run.parts > 1 else page.written(page.Templates(), run))
    stored, whole = load(folder, outlines.read), load(folder)
    assert [run.key for run in stored.runs] == [run.key for run in whole.runs]
    for parts, run in zip(stored.parts, whole.runs, strict=True):
        assert outlines.whole(parts) == run
    outline = stored.parts[0][0]
    assert all(stage.plan_trace is None and not stage.history for stage in outline.stages)
    restored = tuple(
        stage.model_copy(update={name: getattr(other, name) for name in ("plan_trace", "replay_trace", "tracked_trace", "history")})
        for stage, other in zip(outline.stages, whole.runs[0].stages, strict=True)
    )
    assert outline.model_copy(update={"stages": restored}) == whole.runs[0]


def test_a_record_that_changes_meanwhile_is_said(folder: Path):
    outlines = Outlines(folder, lambda run: page.written(page.Templates(), run))
    stored = load(folder, outlines.read)
    path = folder / "runs" / stored.parts[0][0].key / "record.json"
    path.write_bytes(record_of(path.read_bytes()).model_copy(update={"message": "other"}).model_dump_json().encode())
    with pytest.raises(ReportError, match="changed while the report was written"):
        outlines.whole(stored.parts[0])


def test_a_folder_that_is_renamed_has_the_same_page(folder: Path, tmp_path: Path):
    before = render(folder)
    assert render(folder.rename(tmp_path / "another")) == before


def test_pages_that_stand_are_left_and_any_other_is_written_again(folder: Path, monkeypatch: pytest.MonkeyPatch):
    index = split.write_pages(folder)
    fresh = {path.name: path.read_bytes() for path in index.parent.iterdir()}
    with monkeypatch.context() as patch:
        patch.setattr(split, "draw", lambda _: pytest.fail("the pages stand"))
        assert split.write_pages(folder) == index
    (index.parent / "runs.html").write_bytes(fresh["runs.html"][:-1])
    index.unlink()
    split.write_pages(folder)
    assert {path.name: path.read_bytes() for path in index.parent.iterdir()} == fresh

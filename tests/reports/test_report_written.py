"""Which pages are written, and when: what goes across runs each time, a run's page where there is none that is younger than its record; and whether
anything of them would change.
"""

import os
import re
import threading
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import pytest

from reports import render as module
from reports.load import ReportError, load
from reports.pages.section import run_pages
from reports.render import PAGES, write_report, write_single


@pytest.fixture
def folder(factory, tmp_path: Path) -> Path:
    """A chain with a sweep of eps, and two short runs.

    All of it was stored long ago.
    """
    chain, short = factory.runs()[2], factory.runs()[0]
    other = replace(short, key="other", pipeline="other")
    stored = factory.store(tmp_path / "all", [chain, short, other])
    for path in stored.glob("runs/*/*"):
        os.utime(path, (1e9, 1e9))
    return stored


def _written(folder: Path) -> dict[str, tuple[int, int]]:
    """Which file each page is, and when it was written: the number of a file that is gone may be given to the next."""
    return {
        path.name: (path.stat().st_ino, path.stat().st_mtime_ns)
        for path in (folder / PAGES).iterdir()
    }


def test_every_link_leads_to_an_anchor_of_a_page(full_folder):
    write_report(full_folder)
    texts = {
        path.resolve(): path.read_text(encoding="utf-8")
        for path in (full_folder / "report.html", *(full_folder / PAGES).iterdir())
    }
    assert {path.name for path in texts if path.suffix != ".html"} == {"report.css", "report.js"}
    anchors = {path: set(re.findall(r' id="([^"]+)"', text)) for path, text in texts.items()}
    for path, text in texts.items():
        for address, anchor in re.findall(r' href="([^"#]*)(?:#([^"]*))?"', text):
            target = (path.parent / unquote(address)).resolve() if address else path
            assert not anchor or anchor in anchors[target], (path, address, anchor)
            assert target in texts
    names = {path.stem for path in texts}
    assert {
        "report",
        "runs",
        "provenance",
        "scene-three_cart",
        "three_cart--strict",
    } <= names


@pytest.mark.slow
def test_pages_together_show_every_figure_of_the_single_file(full_folder):
    single = write_single(full_folder).read_text(encoding="utf-8")
    write_report(full_folder)
    pages = "".join(
        path.read_text(encoding="utf-8")
        for path in (full_folder / "report.html", *(full_folder / PAGES).iterdir())
    )
    figures = [
        figure
        for figure in re.findall(r"<figure .*?</figure>", single, re.DOTALL)
        if "href=" not in figure
    ]
    assert len(figures) > 100
    assert all(figure in pages for figure in figures)


@pytest.mark.slow
def test_a_page_that_stands_is_left_and_any_other_is_written(folder: Path):
    write_report(folder)
    before = _written(folder)
    chain = next(name for name in before if name.startswith("three_cart--relaxed-strict"))
    write_report(folder)
    again = _written(folder)
    keys = {name: key for key, name in run_pages(load(folder).runs).items()}
    of_runs = before.keys() & keys.keys()
    standing = {name for name in before if again[name] == before[name]}
    assert standing == of_runs | {"scene-three_cart.html"}
    assert len(of_runs) == 3
    os.utime(folder / "runs" / keys[chain] / "record.json")
    os.utime(folder / "runs" / "other" / "record.json")
    (folder / PAGES / "three_cart--strict.html").unlink()
    write_report(folder)
    last = _written(folder)
    assert {name for name in again if again[name] != last[name]} == set(again)


@pytest.mark.slow
def test_another_program_writes_all_pages(folder: Path, monkeypatch: pytest.MonkeyPatch):
    write_report(folder)
    before = _written(folder)
    monkeypatch.setattr(module, "_program", lambda: 4 * 10**18)
    write_report(folder)
    assert not {name for name, place in _written(folder).items() if before[name] == place}


@pytest.mark.slow
def test_pages_are_the_same_by_one_process_and_by_several(
    factory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    one, several = (
        factory.store(tmp_path / name / "all", factory.runs()) for name in ("one", "several")
    )
    write_report(one, 1)
    monkeypatch.setattr(module, "_WORTH", 1)
    monkeypatch.setattr(
        threading, "active_count", lambda: 1
    )  # a browser's or a plugin's threads hold nothing that a page needs
    drawn = []
    monkeypatch.setattr(
        module,
        "_write_run",
        lambda *words, write=module._write_run: (drawn.append(words[-1]), write(*words)),
    )
    write_report(several, 3)
    assert drawn == [], "this process drew none"
    assert {path.name: path.read_bytes() for path in (one / PAGES).iterdir()} == {
        path.name: path.read_bytes() for path in (several / PAGES).iterdir()
    }


def test_few_pages_start_no_process(factory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = factory.store(tmp_path / "all", [factory.run("strict", None, "strict_lcp")])
    monkeypatch.setattr(threading, "active_count", lambda: 1)
    monkeypatch.delattr(module.multiprocessing, "get_context")
    write_report(folder, 8)
    assert "three_cart--strict.html" in _written(folder)


@pytest.mark.slow
def test_what_a_process_leaves_undone_is_done_here(
    factory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = factory.store(tmp_path / "all", factory.runs())
    monkeypatch.setattr(module, "_WORTH", 1)
    monkeypatch.setattr(threading, "active_count", lambda: 1)
    monkeypatch.setattr(module, "_write_some", lambda *_: os._exit(9))
    write_report(folder, 2)
    assert {*run_pages(factory.runs()).values()} < set(_written(folder))


def test_a_file_in_the_place_of_the_pages_is_one_sentence(folder: Path):
    (folder / PAGES).write_text("")
    with pytest.raises(ReportError, match="cannot be written"):
        write_report(folder)
    assert [path.name for path in folder.iterdir() if path.name.startswith(".partial")] == []


def test_a_folder_in_the_place_of_a_page_is_one_sentence(folder: Path):
    (folder / PAGES / "three_cart--strict.html" / "in").mkdir(parents=True)
    with pytest.raises(ReportError, match="cannot be written"):
        write_report(folder)
    assert [path.name for path in folder.rglob(".partial*")] == []


@pytest.mark.slow
def test_a_folder_that_is_renamed_has_the_same_pages(factory, tmp_path: Path):
    folder = factory.store(tmp_path / "all", factory.runs()[:1])
    write_report(folder)
    before = {path.name: path.read_bytes() for path in (folder / PAGES).iterdir()} | {
        "report": (folder / "report.html").read_bytes()
    }
    other = folder.rename(tmp_path / "another")
    for path in (other / PAGES).iterdir():
        path.unlink()
    write_report(other)
    assert {path.name: path.read_bytes() for path in (other / PAGES).iterdir()} | {
        "report": (other / "report.html").read_bytes()
    } == before


@pytest.mark.parametrize("name", ["../../etc/passwd", "a/b", "☃", "x" * 300, "CON scene"])
def test_a_scene_of_any_name_has_a_page_in_its_folder(factory, tmp_path: Path, name: str):
    folder = factory.store(
        tmp_path / "all", [factory.run("strict", None, "strict_lcp", scene=factory.scene(name))]
    )
    write_report(folder)
    (page,) = (folder / PAGES).glob("scene-*.html")
    assert f'href="{PAGES}/{page.name}"' in (folder / "report.html").read_text(encoding="utf-8")

"""What each page of a report is called, which sections it has in which order, and where it leads back to."""

import os
import re
from pathlib import Path

import pytest

from reports.render import _OTHERS, is_current, render_run, write_report, write_single
from tests.reports import record_factory as factory

LEAD = "Does this plan through contact hold? Every plan below was replayed with exact contact, in continuous time, and scored."
CAMPAIGN = "touchstone: all of Table I"
CARTS = "Three carts: the outer two push the middle one"
WHOLE = ("../report.html", "The whole report")
ACROSS = ["overview", "table1", "failures", "index"]
SCENE = ["scene-1", "pareto-1", "stages-1", "front-1", "violation", "model-1"]
HILL = ["scene-2", "pareto-2", "stages-2", "model-2"]
OF_SCENE = [WHOLE, ("../report.html#index", "All pages")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes with a run each."""
    runs = [
        factory.run("strict", None, "strict_lcp"),
        factory.ran("x", of=factory.scene("hill", "A hill")),
    ]
    made = factory.store(tmp_path_factory.mktemp("contents") / "all", runs)
    for path in (made, *made.rglob("*")):
        os.utime(path, (1e9, 1e9))
    write_report(made, jobs=1)
    write_single(made)
    return made


def told(text: str) -> tuple[str, str, list[str], list[tuple[str, str]], str]:
    """Title, lead, sections, links to other pages, and the command that writes it anew."""
    contents = re.search(r"<nav.*?</nav>", text, re.DOTALL)
    assert contents is not None
    links = [
        link
        for link in re.findall(r'<li><a href="([^"]*)">(.*?)</a>', contents[0])
        if not link[0].startswith("#")
    ]
    title, lead = re.findall(r"<h1>(.*?)</h1>\n<p>(.*?)</p>", text)[0]
    again = re.search(r"python -m reports [^<]*", text)
    return (
        title,
        lead,
        re.findall(r'<section id="([^"]*)"', text),
        links,
        again[0].strip() if again else "",
    )


@pytest.mark.parametrize(
    ("page", "title", "lead", "sections", "links"),
    [
        ("report", CAMPAIGN, LEAD, ACROSS, []),
        ("pages/scene-three_cart", "three_cart", CARTS, SCENE, OF_SCENE),
        ("pages/scene-hill", "hill", "A hill", HILL, OF_SCENE),
        ("pages/provenance", "Provenance", CAMPAIGN, ["provenance"], [WHOLE]),
        ("pages/runs", "All runs", CAMPAIGN, ["runs"], [WHOLE]),
        ("pages/hill--x", "x on hill", "A hill", ["one"],
         [WHOLE, ("scene-hill.html", "The scene hill"), ("runs.html", "All runs")]),
    ],
)  # fmt: skip
def test_what_a_page_has(
    folder: Path,
    page: str,
    title: str,
    lead: str,
    sections: list[str],
    links: list[tuple[str, str]],
):
    found = told((folder / f"{page}.html").read_text(encoding="utf-8"))
    assert found[:4] == (title, lead, sections, links)
    assert found[4].startswith("python -m reports DIR")
    assert "--single-file" not in found[4]


def test_there_are_no_other_pages(folder: Path):
    """Those of scenes and runs, and the others in their order, of which these two runs have some."""
    names = {path.stem for path in (folder / "pages").iterdir()}
    assert names - set(_OTHERS) == {
        "scene-three_cart",
        "scene-hill",
        "hill--x",
        "three_cart--strict",
        "report",
    }
    assert names >= {"runs", "provenance"}


def test_the_single_file_has_the_sections_of_all_pages(folder: Path):
    title, lead, sections, links, again = told((folder / "single.html").read_text(encoding="utf-8"))
    others = [path for name in _OTHERS if (path := folder / "pages" / f"{name}.html").exists()]
    of_others = [anchor for path in others for anchor in told(path.read_text(encoding="utf-8"))[2]]
    assert (title, lead, links) == (CAMPAIGN, LEAD, [])
    assert sections == [
        *ACROSS,
        *(anchor for anchor in SCENE if anchor != "stages-1"),
        *HILL,
        *of_others,
    ]
    assert again.startswith("python -m reports DIR --single-file")


def test_a_page_of_a_run_alone_leads_nowhere(folder: Path):
    run = factory.run("strict", None, "strict_lcp")
    title, lead, sections, links, again = told(render_run(run, folder))
    assert (title, lead, sections, links, again) == ("strict on three_cart", CARTS, ["one"], [], "")


def test_a_report_is_current_where_it_is_younger_than_all_it_is_made_of(folder: Path):
    """Each file in turn is as young as the report, and then older again."""
    young = (folder / "report.html").stat().st_mtime_ns
    assert is_current(folder)
    for path in (
        folder / "campaign.json",
        folder / "pages",
        folder / "runs" / "x-key",
        folder / "runs" / "x-key" / "record.json",
        folder / "runs" / "x-key" / "replay.nc",
    ):
        before = path.stat().st_mtime_ns
        os.utime(path, ns=(young, young))
        assert not is_current(folder), path
        os.utime(path, ns=(before, before))
        assert is_current(folder), path
    for name in ("pages", "pages/hill--x.html", "report.html", "runs/x-key/record.json"):
        path = folder / name
        before = path.parent.stat().st_mtime_ns
        path.rename(folder.parent / "away")
        assert not is_current(folder), name
        (folder.parent / "away").rename(path)
        os.utime(path.parent, ns=(before, before))
        assert is_current(folder), name

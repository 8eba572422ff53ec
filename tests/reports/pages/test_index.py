"""The index of the other pages: a sentence each with its main figure, links both ways."""

import html
import re

import pytest
from wording import unsaid

from reports.pages.section import Report
from reports.records.load import load
from reports.render import PAGES, write_report, write_single


@pytest.fixture
def folder(factory, tmp_path):
    one, chain, lost = factory.runs()[0], factory.runs()[4], factory.runs()[1]
    lost = lost.model_copy(update={"verdict": "violates", "scene": factory.scene("other")})
    profiled = one.model_copy(update={"profile": {"start": 1.0, "replay": 3.0}})
    return factory.store(tmp_path / "all", [profiled, chain, lost])


def index_of(text: str) -> str:
    found = re.search(r'<section id="index".*?</section>', text, re.DOTALL)
    return found[0]


def test_each_page_is_told_in_a_sentence_with_its_figure(folder):
    index = html.unescape(index_of(write_report(folder).read_text(encoding="utf-8")))
    told = dict(re.findall(r'<dt><a href="pages/([\w-]+)\.html">[^<]*</a></dt><dd>(.*?)</dd>', index))
    assert list(told) == ["runs", "errata", "time-spent", "provenance"]
    assert not unsaid(told["runs"], "3 runs … 2 of which hold")
    assert "replaying (75 %)" in told["time-spent"]
    assert "none of 3 runs come from elsewhere" in told["provenance"]
    rows = [re.sub(r"<[^>]*>", " ", row).split() for row in re.findall(r"<tr><th scope=\"row\">.*?</tr>", index, re.DOTALL)]
    assert rows[0][0] == "three_cart"
    assert rows[0][-6:] == ["2", "of", "2", "softplus_dc+strict,", "cost", "490.83"]
    assert rows[1][0] == "other"
    assert rows[1][-4:] == ["0", "of", "1", "–"]


def test_links_lead_there_and_back(folder):
    report = write_report(folder)
    for name in re.findall(r'href="(pages/[^"#]*)"', index_of(report.read_text(encoding="utf-8"))):
        text = (folder / name).read_text(encoding="utf-8")
        assert 'href="../report.html"' in text
    scene = (folder / PAGES / "scene-other.html").read_text(encoding="utf-8")
    run = next(run for run in Report(load(folder), folder).stored.runs if run.scene.name == "other")
    assert f'href="{run.key}.html"' in scene
    assert 'href="scene-other.html"' in (folder / PAGES / f"{run.key}.html").read_text(encoding="utf-8")
    assert "ours beside Table I of the paper" in (folder / PAGES / "scene-three_cart.html").read_text(encoding="utf-8")


def test_in_one_file_the_index_leads_to_sections(folder):
    text = write_single(folder).read_text(encoding="utf-8")
    links = re.findall(r'href="([^"]*)"', index_of(text))
    assert links
    assert all(link.startswith("#") and f'id="{link[1:]}"' in text for link in links)
    assert 'href="#table1"' in text

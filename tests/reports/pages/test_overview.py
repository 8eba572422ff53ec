"""The index of the other pages: a sentence each with its main figure, links both ways.

The first screen: cells of the matrix, families of marks, and what is there of a folder with little
in it.
"""

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from wording import unsaid

from reports.load import Stored, load
from reports.pages import overview
from reports.pages.section import Report, run_pages
from reports.render import _OTHERS, PAGES, render, write_report


@pytest.fixture
def folder(factory, tmp_path):
    one, chain, lost = factory.runs()[0], factory.runs()[4], factory.runs()[1]
    lost = replace(lost, verdict="violates", scene=factory.scene("other"))
    profiled = replace(one, profile={"start": 1.0, "replay": 3.0})
    return factory.store(tmp_path / "all", [profiled, chain, lost])


def index_of(text: str) -> str:
    found = re.search(r'<section id="index".*?</section>', text, re.DOTALL)
    return found[0]


def test_each_page_is_told_in_a_sentence_with_its_figure(folder):
    index = html.unescape(index_of(write_report(folder).read_text(encoding="utf-8")))
    told = dict(
        re.findall(r'<dt><a href="pages/([\w-]+)\.html">[^<]*</a></dt><dd>(.*?)</dd>', index)
    )
    assert list(told) == [name for name in _OTHERS if name in told], "in the order of the table"
    assert told.keys() >= {"runs", "time-spent", "provenance"}
    assert not unsaid(told["runs"], "3 runs … 2 of which hold")
    assert "replaying (75 %)" in told["time-spent"]
    assert "none of 3 runs come from elsewhere" in told["provenance"]
    rows = [
        re.sub(r"<[^>]*>", " ", row).split()
        for row in re.findall(r"<tr><th scope=\"row\">.*?</tr>", index, re.DOTALL)
    ]
    assert rows[0][0] == "three_cart"
    assert rows[0][-6:] == ["2", "of", "2", "softplus_dc+strict,", "cost", "490.83"]
    assert rows[1][0] == "other"
    assert rows[1][-4:] == ["0", "of", "1", "–"]


@pytest.mark.slow
def test_links_lead_there_and_back(folder):
    report = write_report(folder)
    for name in re.findall(r'href="(pages/[^"#]*)"', index_of(report.read_text(encoding="utf-8"))):
        text = (folder / name).read_text(encoding="utf-8")
        assert 'href="../report.html"' in text
    scene = (folder / PAGES / "scene-other.html").read_text(encoding="utf-8")
    run = next(run for run in Report(load(folder), folder).stored.runs if run.scene.name == "other")
    assert f'href="{run_pages([run])[run.key]}"' in scene
    assert 'href="scene-other.html"' in (folder / PAGES / run_pages([run])[run.key]).read_text(
        encoding="utf-8"
    )
    assert "ours beside Table I of the paper" in (
        folder / PAGES / "scene-three_cart.html"
    ).read_text(encoding="utf-8")


def ended(factory, scene: str, pipeline: str, verdict: str, cost: float | None = 100.0, **changes):
    """A run of one direct stage."""
    run = factory.run(
        "strict", None, "strict_lcp", key=f"{scene}-{pipeline}", verdict=verdict, **changes
    )
    stage = replace(run.stages[0], verdict=verdict, cost=cost, paper={})
    return replace(run, scene=factory.scene(scene), pipeline=pipeline, stages=(stage,))


def section(*runs, folder: Path = Path()):
    return overview.build(Report(Stored(None, runs), folder))


def cells(text: str) -> list[list[tuple[str, str, str]]]:
    """Of each row of the matrix (class, what is shown, tip).

    Empty strings where there is no run.
    """
    table = re.search(r'<table class="grid-of-runs".*?</table>', text, re.DOTALL)
    rows = re.findall(r"<tr><th scope=\"row\">.*?</tr>", table[0], re.DOTALL)
    found = []
    for row in rows:
        inside = [
            re.search(r'class="(\w*)"><a href="[^"]*" title="([^"]*)">(.*?)</a>', cell)
            for cell in re.findall(r"<td.*?</td>", row)
        ]
        found.append(
            [
                (one[1], re.sub(r"<[^>]*>", " ", one[3]).strip(), html.unescape(one[2]))
                if one
                else ("", "", "")
                for one in inside
            ]
        )
    return found


def test_a_cell_is_a_symbol_and_the_cost_over_the_cheapest_plan_that_holds(factory, tmp_path):
    runs = [
        ended(factory, "bank", "a", "holds", 150.0),
        ended(factory, "bank", "b", "holds with feedback", 100.0),
        ended(factory, "bank", "c", "violates", 1.0),
        ended(factory, "hill", "a", "not applicable", None, outcome="refused",
              message="strict_lcp: scene hill has no inputs."),
        ended(factory, "hill", "b", "undecided"),
        ended(factory, "hill", "c", "no plan", None, outcome="infeasible"),
        ended(factory, "moor", "a", "consistent", 0.0),
    ]  # fmt: skip
    bank, hill, moor = cells(render(factory.store(tmp_path / "all", runs)))
    assert [shown[:2] for shown in bank] == [
        ("holds", "✓ 1.50"),
        ("feedback", "↻ 1"),
        ("violates", "✗"),
    ]
    assert [shown[:2] for shown in hill] == [("noplan", "⊘"), ("undecided", "?"), ("noplan", "○")]
    assert [shown[:2] for shown in moor] == [("consistent", "≈"), ("", ""), ("", "")], (
        "what was not run is empty"
    )
    tips = [shown[2] for shown in (*bank, *hill)]
    assert tips[0] == "a on bank: holds, cost 150.00, 1.5 times the cheapest"
    assert tips[1] == "b on bank: holds with feedback, cost 100.00, the cheapest"
    assert tips[2].startswith("c on bank: violates. ")
    assert not unsaid(tips[3], "a on hill: not applicable. … no inputs.")
    assert not unsaid(tips[5], "c on hill: no plan. … infeasible")


def test_where_no_plan_holds_there_is_no_ratio_and_no_film(factory):
    found = section(
        ended(factory, "bank", "a", "violates"), ended(factory, "bank", "b", "no plan", None)
    )
    assert [place.ratio for place in found.values["places"].values()] == [None, None]
    assert found.values["strip"] is None
    assert found.values["findings"][-1] == "No pipeline found a plan that holds."


def test_equal_costs_are_both_the_cheapest(factory):
    found = section(ended(factory, "bank", "a", "holds"), ended(factory, "bank", "b", "holds"))
    assert [place.ratio for place in found.values["places"].values()] == [1.0, 1.0]
    assert all(place.words.endswith("the cheapest") for place in found.values["places"].values())


def test_of_a_relaxation_the_tightest_eps_is_drawn(factory):
    plot = section(factory.run("softplus_dc+strict", "softplus_dc", "strict_lcp")).values["plot"]
    tips = re.findall(r"<title>([^<]*)", str(plot.markup(hidden=False)))
    assert [tip.split(" on ")[0] for tip in tips] == [
        "softplus_dc ε = 10⁻⁷",
        "strict_lcp after softplus_dc",
    ]
    assert "1 of 2 plans violate" in plot.words


def test_the_film_is_of_the_cheapest_plan_on_the_papers_scene(factory, tmp_path):
    dear, cheap = factory.run("strict", None, "strict_lcp"), factory.run("relu_gd", None, "relu_gd")
    cheap = replace(cheap, stages=(replace(cheap.stages[0], cost=400.0),))
    other = ended(factory, "another", "strict", "holds", 1.0)
    folder = factory.store(tmp_path / "all", [other, dear, cheap])
    drawn, _, run = overview.build(Report(load(folder), folder)).values["strip"]
    assert (run.scene.name, run.pipeline) == ("three_cart", "relu_gd")
    assert drawn.words == "6 moments of the plan, from 0 s to 5 s."
    for path in folder.glob("runs/relu_gd*/trajectory.nc"):
        path.unlink()
    assert overview.build(Report(load(folder), folder)).values["strip"][2].pipeline == "strict", (
        "what cannot be drawn is passed over"
    )


def test_a_folder_without_runs_says_so(factory, tmp_path):
    text = render(factory.store(tmp_path / "none", []))
    assert not unsaid(text, "No run is stored")
    assert "grid-of-runs" not in text.partition("<body>")[2]


@pytest.mark.slow
def test_markup_in_names_stays_text_on_the_first_screen(factory, hostile_folder):
    first = re.search(r'<section id="overview".*?</section>', render(hostile_folder), re.DOTALL)
    assert not re.search(r"<(img|b|script|iframe)[ >]", first[0])
    assert first[0].count("&lt;img src=x onerror=") >= 4, (
        "names of scene and pipeline, the command and the sentences are shown"
    )


def test_what_is_damaged_is_told_first_and_the_rest_is_shown(factory, tmp_path):
    runs = factory.runs()[:3]
    folder = factory.store(
        tmp_path / "all",
        runs,
        factory.campaign(runs, quick=True, keys=(*(run.key for run in runs), "gone")),
    )
    cut = folder / "runs" / runs[0].key / "record.json"
    cut.write_text(cut.read_text()[:2000])
    old = folder / "runs" / runs[1].key / "record.json"
    old.write_text(json.dumps(json.loads(old.read_text()) | {"surprise": 1}))
    notices = overview.build(Report(load(folder), folder)).values["notices"]
    assert not unsaid(notices[0], "1 run … no stored record yet")
    assert notices[1].startswith("2 files could not be read: of 1 of them ")
    assert notices[2].startswith("This was a quick campaign")
    text = render(folder)
    assert "it does not follow record schema" in text
    assert "not complete JSON" in text
    assert len(cells(text)[0]) == 1, "the run that can be read is shown"
    (folder / "campaign.json").write_text("{}")
    assert not unsaid(render(folder), "own record is missing or unreadable")

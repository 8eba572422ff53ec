"""The docs as a site: built strictly, whole, and without a request to any network."""

import html
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import formulations
import formulations.mpec
import touchstone
from formulations.pipelines import method_names, pipeline_names
from models.catalog import load_scene, scene_names
from tests.reports import record_factory as factory
from validate.judge.score import metric_names

pytestmark = [pytest.mark.slow, pytest.mark.process]
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for name in ("mkdocs", "material", "mkdocstrings"):
        pytest.importorskip(
            name, reason="the site is built by the extra [docs]: pip install -e '.[docs]'"
        )
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    campaign = factory.store(tmp_path_factory.mktemp("campaign") / "all", factory.runs())
    there = os.environ | {
        "PYTHONPATH": str(ROOT),
        "NO_MKDOCS_2_WARNING": "1",
        "TOUCHSTONE_CAMPAIGN": str(campaign),
    }
    done = subprocess.run(words, cwd=ROOT, env=there, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def text_of(page: Path) -> str:
    return html.unescape(re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8")))


def test_a_page_fetches_nothing_from_a_network(site: Path):
    pages = [*site.rglob("*.html")]
    assert len(pages) > 30
    for page in pages:
        text = page.read_text(encoding="utf-8")
        fetched = re.findall(
            r"<(?:script|img|iframe|source)\b[^>]*?\bsrc=\"?([^\" >]+)", text
        ) + re.findall(r"<link\b[^>]*?\bhref=\"?([^\" >]+)", text)
        assert fetched or page.parent.name == "players"
        assert not [address for address in fetched if "//" in address], page
    for style in site.rglob("*.css"):
        assert not re.findall(r"url\(\"?https?://|@import", style.read_text(encoding="utf-8")), (
            style
        )


def test_search_works_from_a_folder(site: Path):
    assert (site / "search" / "search_index.js").stat().st_size > 100_000
    assert 'src="site/iframe-worker.js"' in (site / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", scene_names())
def test_a_scene_says_what_its_file_says(site: Path, name: str):
    scene, text = load_scene(name), text_of(site / "scenes" / f"{name}.html")
    for item in (
        *scene.coordinates,
        *scene.inputs,
        *scene.parameters,
        *scene.contacts,
        *scene.frictions,
        *scene.shapes,
    ):
        assert item.name in text, item.name
    for limit in scene.limits:
        assert limit.metric in text
        assert limit.reason in text
    assert f'scenes/{name}.html"' in (site / "scenes.html").read_text(encoding="utf-8")
    assert "<math" in (site / "scenes" / f"{name}.html").read_text(encoding="utf-8")


def test_the_gallery_has_the_plans_of_a_campaign_in_motion(site: Path):
    assert re.findall(
        r'<iframe[^>]*src="([^"]+)"', (site / "players.html").read_text(encoding="utf-8")
    ) == ["players/three_cart.html"]
    frame = (site / "players" / "three_cart.html").read_text(encoding="utf-8")
    assert "data-player" in frame
    assert "The cheapest plan that holds: " in frame
    assert "<nav" not in frame


def test_what_there_is_is_listed(site: Path):
    metrics, methods = text_of(site / "metrics.html"), text_of(site / "methods.html")
    assert [name for name in metric_names() if name not in metrics] == []
    assert [name for name in (*method_names(), *pipeline_names()) if name not in methods] == []


def test_the_public_names_have_their_place(site: Path):
    pages = {
        page.stem: page.read_text(encoding="utf-8") for page in (site / "reference").glob("*.html")
    }
    headings = {page: re.findall(r"<h[2-6] id=\"?([\w.]+)", text) for page, text in pages.items()}
    for page, names in (
        (
            "touchstone",
            [
                touchstone._HOME.get(name, ("", name))[1]
                for name in touchstone.__all__
                if name not in ("Scene", "Trajectory")
            ],
        ),
        ("models", ["Scene", "Trajectory", "load_scene", "derive"]),
        ("formulations", formulations.__all__),
        ("formulations.mpec", formulations.mpec.__all__),
    ):
        known = {heading.rpartition(".")[2] for heading in headings[page]}
        assert set(names) <= known, page
    assert "<code>eps</code>" in pages["touchstone"], "a table of parameters"

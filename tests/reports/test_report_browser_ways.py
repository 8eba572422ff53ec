"""Other ways to the page: without its script, by keyboard alone in the player, by addresses of any kind and back again, from page to page on disk."""

from __future__ import annotations

import pytest

from reports.render import render
from reports.split import write_pages


@pytest.fixture(scope="module")
def folded_file(full_folder, tmp_path_factory):
    path = tmp_path_factory.mktemp("folded") / "report.html"
    path.write_text(render(full_folder, largest=0), encoding="utf-8")
    return path


def _settled(page, expression: str):
    """The value once the address has been followed."""
    return page.evaluate(f"new Promise((done) => setTimeout(done, 100)).then(() => ({expression}))")


def test_without_script_nothing_is_offered_that_does_nothing_and_what_is_folded_says_so(chromium, folded_file, page_file):
    for path in (folded_file, page_file):
        page = chromium.open(path, script=False)
        shown = "(e) => e.getClientRects().length > 0"
        assert page.evaluate(f"[...document.querySelectorAll('button, input, select, canvas')].filter({shown}).length") == 0
        assert "sorts by it" not in page.evaluate("document.body.innerText")
        assert page.messages == []
    page = chromium.open(folded_file, script=False)
    said = "[...document.querySelectorAll('.parcel[data-part]')].map((e) => getComputedStyle(e, '::before').content)"
    assert all("needs the page's script" in text for text in page.evaluate(said))
    assert "results.csv" in page.evaluate("document.querySelector('noscript').innerText")
    page = chromium.open(page_file, script=False)
    assert "The motion is drawn by the page's script" in page.evaluate("document.querySelector('.scriptless').textContent")
    assert page.evaluate("getComputedStyle(document.querySelector('.scriptless')).display") == "block"
    page = chromium.open(page_file)
    assert page.evaluate("getComputedStyle(document.querySelector('.scriptless')).display") == "none"
    assert page.evaluate("document.querySelectorAll('#matrix-table thead button').length") > 2


def test_the_player_is_stepped_on_its_button_and_told_once(chromium, page_file):
    page = chromium.open(page_file)
    page.evaluate("document.querySelector('[data-player] .play').focus()")
    told = "document.querySelector('[data-player] output').textContent"
    last = page.evaluate("document.querySelector('[data-player] input').max")
    page.press("End")
    assert page.evaluate("document.querySelector('[data-player] input').value") == last
    ended = page.evaluate(told)
    page.press("ArrowRight")
    assert page.evaluate(told) == ended
    page.press("Home")
    page.press("ArrowRight")
    assert page.evaluate("document.querySelector('[data-player] input').value") == "1"
    assert page.evaluate("document.activeElement.className") == "play"
    # The slider speaks for itself; time running by is not read out.
    assert page.evaluate("document.querySelector('[data-player] output').ariaLive") == "off"


def test_the_address_and_what_is_shown_agree_on_the_way_back(chromium, page_file):
    page = chromium.open(page_file, fragment="#matrix?verdict=holds")
    page.evaluate("document.querySelector('nav a[href=\"#matrix\"]').click()")
    assert _settled(page, "document.getElementById('matrix-verdict').value") == ""
    page.evaluate("history.back()")
    assert _settled(page, "document.getElementById('matrix-verdict').value") == "holds"
    page.evaluate("location.hash = '#runs?crashed'")
    assert _settled(page, "document.querySelectorAll('article.run[hidden]').length") > 0
    page.evaluate("location.hash = '#runs'")
    assert _settled(page, "document.querySelectorAll('article.run[hidden]').length") == 0
    assert page.messages == []


def test_what_holds_most_comes_first_and_is_said_to_descend(chromium, page_file):
    page = chromium.open(page_file)
    page.evaluate("document.querySelector('#matrix-table th[data-sort=holds] button').click()")
    held = page.evaluate("[...document.querySelectorAll('#matrix-table tbody tr')].map((row) => Number(row.cells[1].dataset.holds))")
    assert held == sorted(held, reverse=True)
    assert len(set(held)) > 1
    assert page.evaluate("document.querySelector('#matrix-table th[data-sort=holds]').ariaSort") == "descending"


@pytest.mark.parametrize(
    "fragment",
    [
        "#%",
        "#%E0%A4%A",
        "#matrix?scene=%ZZ&sort=__proto__&x=1",
        "#runs?%E0%A4%A",
        "#<script>alert(1)</script>",
        "#runs?☃",
        "#" + "x" * 20_000,
    ],
    ids=range(7),
)
def test_no_address_is_an_error(chromium, folded_file, fragment):
    page = chromium.open(folded_file, fragment=fragment)
    assert _settled(page, "document.querySelectorAll('#matrix-table th[aria-sort]').length") == 0
    assert page.messages == []
    assert len(page.requests) == 1


def test_a_link_into_the_whole_report_leads_to_the_page_of_its_part(chromium, full_folder):
    index = write_pages(full_folder)
    for fragment, name in (("#runs?crashed", "runs.html"), ("#run-2", "runs.html"), ("#table1", "table1.html"), ("#nowhere", "index.html")):
        page = chromium.open(index, fragment=fragment)
        assert _arrived(page, "location.pathname.split('/').pop() + location.hash", name + fragment) == name + fragment
        assert page.messages == []


def _arrived(page, expression: str, wanted: str) -> str:
    """The value, as soon as it is the wanted one; the patience only ends a test that has failed."""
    for _ in range(100):
        if (value := _settled(page, expression)) == wanted:
            return value
    return value

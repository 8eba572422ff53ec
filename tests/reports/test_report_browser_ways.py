"""Other ways to the page: without its script, by keyboard alone in the player, by addresses of any kind and back again, from page to page on disk."""

from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from wording import unsaid

from reports.render import write_report


@pytest.fixture(scope="module")
def pages(full_folder):
    """report.html and the folder of its pages."""
    report = write_report(full_folder)
    return report, report.parent / "pages"


def _settled(page, expression: str):
    """The value once the address has been followed."""
    return page.evaluate(f"new Promise((done) => setTimeout(done, 100)).then(() => ({expression}))")


@pytest.mark.slow
def test_without_script_nothing_is_offered_that_does_nothing(chromium, pages, run_file, page_file):
    for path in (run_file, pages[0], page_file):
        page = chromium.open(path, script=False)
        shown = "(e) => e.getClientRects().length > 0"
        assert page.evaluate(f"[...document.querySelectorAll('button, input, select, canvas')].filter({shown}).length") == 0
        assert "sorts by it" not in page.evaluate("document.body.innerText")
        assert page.messages == []
    page = chromium.open(page_file, script=False)
    assert not unsaid(page.evaluate("document.querySelector('.scriptless').textContent"), "drawn by the page's script")
    assert page.evaluate("getComputedStyle(document.querySelector('.scriptless')).display") == "block"
    page = chromium.open(page_file)
    assert page.evaluate("getComputedStyle(document.querySelector('.scriptless')).display") == "none"
    assert page.evaluate("document.querySelectorAll('button.take').length") > 2


def test_the_player_is_stepped_on_its_button_and_told_once(chromium, run_file):
    page = chromium.open(run_file)
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


@pytest.mark.slow
def test_the_address_and_what_is_shown_agree_on_the_way_back(chromium, page_file):
    page = chromium.open(page_file, fragment="#runs?violates")
    page.evaluate("document.querySelector('nav a[href=\"#runs\"]').click()")
    assert _settled(page, "document.getElementById('filter').value") == ""
    page.evaluate("history.back()")
    assert _settled(page, "document.getElementById('filter').value") == "violates"
    page.evaluate("location.hash = '#runs?crashed'")
    assert _settled(page, "document.querySelectorAll('article.run[hidden]').length") > 0
    page.evaluate("location.hash = '#runs'")
    assert _settled(page, "document.querySelectorAll('article.run[hidden]').length") == 0
    assert page.messages == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "fragment",
    [
        "#%", "#%E0%A4%A", "#matrix?scene=%ZZ&sort=__proto__&x=1", "#runs?%E0%A4%A", "#<script>alert(1)</script>", "#runs?☃", "#" + "x" * 20_000,
    ],
    ids=range(7),
)  # fmt: skip
def test_no_address_is_an_error(chromium, page_file, fragment):
    page = chromium.open(page_file, fragment=fragment)
    assert _settled(page, "document.querySelectorAll('th[aria-sort]').length") == 0
    assert page.messages == []
    assert len(page.requests) == 1


def test_links_lead_from_page_to_page_and_back(chromium, pages):
    """Followed as the browser understands them: the address of the link, opened."""

    def led(page, link: str) -> Path:
        return Path(unquote(urlsplit(page.evaluate(f"document.querySelector({link!r}).href")).path))

    page = chromium.open(pages[0])
    run, scene = (chromium.open(led(page, link)) for link in (".grid-of-runs td a", "#index tbody a"))
    assert run.evaluate("document.querySelectorAll('article.run svg.plot').length") > 8
    assert scene.evaluate("document.querySelectorAll('[id^=tightening] svg.plot').length") > 8
    assert [led(one, "nav.contents a") for one in (run, scene)] == [pages[0].resolve()] * 2
    assert [one.messages for one in (page, run, scene)] == [[]] * 3


def test_a_closed_stage_is_opened_by_the_contents_of_its_page(chromium, pages):
    page = chromium.open(next(pages[1].glob("softplus_dc-strict*.html")))
    first = "document.querySelector('details.stage')"
    assert page.evaluate(f"{first}.open") is False
    page.evaluate(f"document.querySelector(`nav.contents a[href='#${{{first}.id}}']`).click()")
    assert _settled(page, f"{first}.open") is True


@pytest.mark.slow
@pytest.mark.parametrize(("width", "dark"), [(1400, False), (1400, True), (375, False), (375, True)])
def test_axe_finds_no_violation(chromium, page_file, pages, width, dark):
    """WCAG 2.0, 2.1 and 2.2, A and AA, by axe-core: a page of each kind, and all in one file, with everything open."""
    axe = pytest.importorskip("axe_core_python", reason="axe-core-python is not installed (extra [test])")
    script = (Path(axe.__path__[0]) / "axe.min.js").read_text(encoding="utf-8")
    for path in (pages[0], next(pages[1].glob("softplus_dc-strict*.html")), next(pages[1].glob("scene-*.html")), page_file):
        page = chromium.open(path, width=width, dark=dark)
        assert page.messages == []
        assert page.requests == [path.resolve().as_uri()]
        # Two runs with all they hold stand for the others: hundreds of plots more are the same markup.
        page.evaluate("document.querySelectorAll('article.run').forEach((run, place) => { if (place > 1) run.remove(); })")
        page.evaluate("document.querySelectorAll('details').forEach((item) => { item.open = true; })")
        page.evaluate(script + ";0")
        found = page.evaluate(
            "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa']}).then((result) => "
            "[result.passes.length, result.violations.map((one) => [one.id, one.nodes.length, one.nodes[0].html.slice(0, 200)])])"
        )
        assert found[1] == []
        assert found[0] > 15, "axe looked"


@pytest.mark.parametrize("width", [1400, 390])
def test_no_page_complains_asks_or_scrolls_sideways(chromium, pages, width):
    """Every page that is no run's, of whatever it tells, with all it folds open."""
    kinds = [path for path in (pages[0], *sorted(pages[1].glob("*.html"))) if not path.name.endswith(("-0123456789abcdef.html", "-0.html"))]
    assert {path.stem for path in kinds} == {"report", "runs", "errata", "provenance", "scene-three_cart"}
    for path in kinds:
        page = chromium.open(path, width=width)
        page.evaluate("document.querySelectorAll('details').forEach((item) => { item.open = true; })")
        assert (page.messages, page.requests) == ([], [path.resolve().as_uri()])
        assert page.evaluate("document.documentElement.scrollWidth") <= width, path.name
        page.call("Page.close")

"""The page as its reader meets it: headless Chromium, network off, light and dark, desk and telephone, keyboard alone."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest

from reports.render import write_report

# Smallest contrast of text that WCAG 2.1 AA allows; all text of the page is held to the one for small text.
_CONTRAST = 4.5

_CONTRASTS = """(() => {
  const parse = (text) => { const part = text.match(/[\\d.]+/g).map(Number); return part.length < 4 ? [...part, 1] : part; };
  const light = ([r, g, b]) => [r, g, b].map((c) => c / 255).map((c) => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)
    .reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
  const ground = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const colour = parse(getComputedStyle(at).backgroundColor);
      if (colour[3] > 0.99) return colour;
    }
    return [255, 255, 255, 1];
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const seen = new Set();
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || seen.has(element) || element.closest("script, .sr, .skip, title")) continue;
    seen.add(element);
    const style = getComputedStyle(element);
    const front = light(parse(element.closest("svg") ? style.fill : style.color));
    const back = light(ground(element));
    const ratio = (Math.max(front, back) + 0.05) / (Math.min(front, back) + 0.05);
    if (ratio < LIMIT) found.push([element.tagName, element.getAttribute("class"), element.textContent.slice(0, 30), ratio]);
  }
  return [seen.size, found.slice(0, 5)];
})()""".replace("LIMIT", str(_CONTRAST))

_OUTLINE = """[...document.querySelectorAll("h1,h2,h3,h4,h5,h6")].map((h) => Number(h.tagName[1]))"""


@pytest.fixture(scope="module")
def page_file(full_folder):
    return write_report(full_folder)


@pytest.fixture(scope="module")
def desk(chromium, page_file):
    return chromium.open(page_file)


@pytest.mark.parametrize(("width", "dark"), [(1400, False), (1400, True), (390, False)], ids=["light", "dark", "telephone"])
def test_no_complaint_no_request_no_sideways_scrolling(chromium, page_file, width, dark):
    page = chromium.open(page_file, width=width, dark=dark)
    page.evaluate("document.querySelectorAll('details').forEach((item) => { item.open = true; })")
    assert page.messages == []
    assert page.requests == [page_file.resolve().as_uri()]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    wide = page.evaluate(
        "[...document.querySelectorAll('main > section > *:not(.scroll)')].filter((e) => e.getBoundingClientRect().right > innerWidth + 1).length"
    )
    assert wide == 0
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == ("rgb(20, 23, 27)" if dark else "rgb(255, 255, 255)")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_all_text_has_contrast(chromium, page_file, dark):
    page = chromium.open(page_file, dark=dark)
    page.evaluate("document.querySelectorAll('details').forEach((item) => { item.open = true; })")
    looked, found = page.evaluate(_CONTRASTS)
    assert looked > 1000
    assert found == []


def test_structure_for_those_who_do_not_see_it(desk):
    levels = desk.evaluate(_OUTLINE)
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert desk.evaluate(
        "['main', 'nav', 'header', 'footer'].map((name) => document.querySelectorAll('body > ' + name + ', .frame-of-page > ' + name).length)"
    ) == [1, 1, 1, 1]
    assert desk.evaluate("[...document.querySelectorAll('table')].filter((t) => !t.caption || !t.caption.textContent.trim()).length") == 0
    assert desk.evaluate("[...document.querySelectorAll('th')].filter((h) => !h.scope).length") == 0
    assert (
        desk.evaluate(
            "[...document.querySelectorAll('.draw')].filter((d) => !(d.getAttribute('aria-label').length > 40 && d.tabIndex === 0)).length"
        )
        == 0
    )
    assert desk.evaluate("document.querySelectorAll('svg.plot').length") > 100
    assert desk.evaluate("[...document.querySelectorAll('.sign')].filter((s) => !/\\S+ \\S+/.test(s.textContent)).length") == 0, (
        "a symbol and a word"
    )
    assert (
        desk.evaluate(
            "[...document.querySelectorAll('button, input, canvas')].filter((e) => !(e.textContent.trim() || e.ariaLabel || e.labels?.length)).length"
        )
        == 0
    )


def test_values_are_read_off_a_plot_by_keyboard(desk, factory):
    """The last value of q1 in Fig. 4, as the record has it."""
    desk.evaluate("document.querySelector('#tightening [data-read]').focus()")
    desk.press("End")
    told = desk.evaluate("document.querySelector('#tightening .fig output').textContent")
    assert told.startswith("time 5 s:")
    read = re.search(r"q1, ε = 10⁻⁷ ([\d.]+) m", told)
    assert read is not None
    trace = factory.stage(2, "softplus_dc", 1e-7, None, 0.0).plan_trace
    assert float(read[1]) == pytest.approx(trace.columns["q1"][-1], abs=0.01)
    assert desk.evaluate("document.querySelectorAll('#tightening .cursor').length") == 1


def test_points_of_the_front_tell_their_row_on_focus(desk):
    desk.evaluate("document.querySelector('#front .draw a').focus()")
    assert desk.evaluate("document.querySelector('#front .fig output').textContent").startswith("Row 1, strict_lcp: cost 496.63")


def test_the_filter_follows_the_address(chromium, page_file):
    page = chromium.open(page_file, fragment="#runs?crashed")
    assert page.evaluate(
        "[...document.querySelectorAll('article.run')].filter((run) => !run.hidden).map((run) => run.querySelector('h3').textContent.trim().split(' ')[0])"
    ) == ["crashing"]
    page.evaluate("location.hash = '#run-1'")
    page.evaluate("new Promise((done) => setTimeout(done, 50))")
    assert page.evaluate("document.getElementById('run-1').hidden") is False
    assert page.messages == []


def test_the_player_moves(desk):
    inside = "document.querySelector('[data-player]')"
    before = desk.evaluate(f"{inside}.querySelector('canvas').toDataURL()")
    desk.evaluate(f"(() => {{ const s = {inside}.querySelector('input'); s.value = 60; s.dispatchEvent(new Event('input')); }})()")
    assert desk.evaluate(f"{inside}.querySelector('output').textContent") == "2.00 s"
    assert desk.evaluate(f"{inside}.querySelector('canvas').toDataURL()") != before


def test_hostile_strings_do_nothing(chromium, hostile_folder, factory):
    page = chromium.open(write_report(hostile_folder))
    assert page.messages == []
    assert len(page.requests) == 1
    assert page.evaluate("document.querySelectorAll('img, b, iframe').length") == 0
    assert page.evaluate("document.title").startswith("</script></style><img")
    assert page.evaluate("document.querySelectorAll('script:not([type])').length") == 1


def test_all_is_readable_without_script_and_on_paper(chromium, page_file):
    page = chromium.open(page_file, script=False)
    assert page.messages == []
    pdf = page.call("Page.printToPDF", printBackground=True, preferCSSPageSize=True)["data"]
    assert len(pdf) > 50_000

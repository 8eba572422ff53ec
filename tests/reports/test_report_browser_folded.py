"""The folded report in a headless Chromium: what is folded comes up when it is wanted, and the rules of accessibility hold in it as in the plain one."""

from __future__ import annotations

from pathlib import Path

import pytest

from reports.render import render


@pytest.fixture(scope="module")
def folded_file(full_folder, tmp_path_factory):
    """The same report with everything folded that may be."""
    path = tmp_path_factory.mktemp("folded") / "report.html"
    path.write_text(render(full_folder, largest=0), encoding="utf-8")
    return path


def _until(condition: str) -> str:
    """Waits until it has held for a while; the patience only ends a test that has failed."""
    return (
        "(async () => { for (let turn = 0, held = 0; turn < 1200 && held < 5; turn += 1) {"
        f" held = ({condition}) ? held + 1 : 0; await new Promise((done) => setTimeout(done, 50)); }} }})()"
    )


_UNFOLDED = _until(
    "document.querySelectorAll('#run-5 svg.plot').length > 8 && Math.abs(document.getElementById('run-5').getBoundingClientRect().top) < 40"
)


def test_a_link_into_a_folded_page_unfolds_what_it_leads_to(chromium, folded_file):
    page = chromium.open(folded_file, fragment="#run-5")
    page.evaluate(_UNFOLDED)
    assert page.evaluate("document.querySelector('#run-5 details.whole').open") is True
    assert page.evaluate("document.querySelectorAll('#run-5 svg.plot').length") > 8
    assert page.evaluate("[...document.querySelectorAll('path[d^=\"#\"]')].length") == 0
    assert page.evaluate("document.querySelector('#run-5 .player').hidden") is False
    assert abs(page.evaluate("document.getElementById('run-5').getBoundingClientRect().top")) < 40
    assert page.evaluate("document.querySelectorAll('.parcel[data-part]').length") > 5, "the rest stays folded"
    assert page.messages == []
    assert len(page.requests) == 1


def test_a_stage_unfolds_when_it_is_opened(chromium, folded_file, page_file):
    page = chromium.open(folded_file, fragment="#run-5")
    page.evaluate(_UNFOLDED)
    page.evaluate("document.querySelector('#run-5 details.stage summary').click()")
    line = "document.querySelector('#run-5 details.stage path.ln[data-n]')"
    page.evaluate(_until(line))
    path = f"{line}.getAttribute('d')"
    assert page.evaluate(path) == chromium.open(page_file).evaluate(path)


def test_a_folded_page_is_printed_whole_where_its_runs_are_open(chromium, folded_file, page_file):
    """Its parts are inflated when there is nothing else to do, and put in their places at once when it is printed."""
    page = chromium.open(folded_file)
    left = page.evaluate("""(async () => {
      const left = () => document.querySelectorAll(".parcel[data-part]").length;
      for (let turn = 0; turn < 400 && left(); turn += 1) {
        document.querySelectorAll("details.whole").forEach((item) => { item.open = true; });
        await new Promise((done) => setTimeout(done, 50));
        dispatchEvent(new Event("beforeprint"));
      }
      return left();
    })()""")
    assert left == 0
    assert page.evaluate("document.querySelectorAll('main details:not([open])').length") == 0
    told = "[...document.querySelectorAll('main > section')].map((item) => item.textContent).join('').replace(/\\s+/g, '').length"
    assert page.evaluate(told) == chromium.open(page_file).evaluate(told)
    assert page.messages == []


def test_who_searches_finds_text_of_folded_parts(chromium, folded_file, page_file):
    """Ctrl-F brings the text of every part; plots wait until they are near."""
    page = chromium.open(folded_file)
    left = page.evaluate("""(async () => {
      const left = () => document.querySelectorAll(".parcel[data-part]").length;
      const before = left();
      dispatchEvent(new KeyboardEvent("keydown", { key: "f", ctrlKey: true }));
      for (let turn = 0; turn < 400 && left(); turn += 1) await new Promise((done) => setTimeout(done, 50));
      return [before, left(), document.querySelectorAll("i[data-figure]").length];
    })()""")
    assert left[0] > 5
    assert left[1] == 0
    assert left[2] > 50, "plots that nobody is near are not drawn"
    told = (
        "(() => { document.querySelectorAll('figure, .player').forEach((item) => item.remove());"
        "return [...document.querySelectorAll('main > section')].map((item) => item.textContent).join('').replace(/\\s+/g, ''); })()"
    )
    drawn = page.evaluate("""(async () => {
      const [first] = document.querySelectorAll("i[data-figure]");
      for (let at = first.closest("details"); at; at = at.parentElement.closest("details")) at.open = true;
      first.scrollIntoView({ behavior: "instant" });
      for (let turn = 0; turn < 400 && first.isConnected; turn += 1) await new Promise((done) => setTimeout(done, 50));
      return !first.isConnected;
    })()""")
    assert drawn, "who comes near sees them"
    whole = chromium.open(page_file)
    assert page.evaluate(told) == whole.evaluate(told)
    assert page.messages == []


@pytest.mark.parametrize(("width", "dark"), [(1400, False), (1400, True), (375, False), (375, True)])
def test_axe_finds_no_violation(chromium, page_file, folded_file, width, dark):
    """WCAG 2.0, 2.1 and 2.2, A and AA, by axe-core: the plain page with everything open, and the folded one with a run unfolded."""
    axe = pytest.importorskip("axe_core_python", reason="axe-core-python is not installed (extra [test])")
    script = (Path(axe.__path__[0]) / "axe.min.js").read_text(encoding="utf-8")
    for path, fragment in ((page_file, ""), (folded_file, "#run-5")):
        page = chromium.open(path, width=width, dark=dark, fragment=fragment)
        if fragment:
            page.evaluate(_UNFOLDED)
        else:
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

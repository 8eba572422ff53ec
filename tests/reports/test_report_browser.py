"""The report in a browser: read, zoomed, saved, played, sorted and filtered.

Every way to use it without a mouse.
"""

import csv
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from wording import unsaid

from models.results.check import CheckRecord
from reports.pages.section import run_pages
from reports.render import PAGES, framed, write_report, write_single

pytestmark = pytest.mark.slow

# Smallest contrast of text that WCAG 2.1 AA allows; all text of the page is held to the one for
# small text.
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

_OUTLINE = (
    """[...document.querySelectorAll("h1,h2,h3,h4,h5,h6")].map((h) => Number(h.tagName[1]))"""
)


@pytest.fixture(scope="module")
def desk(chromium, page_file):
    return chromium.open(page_file)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("width", "dark"),
    [(1400, False), (1400, True), (390, False)],
    ids=["light", "dark", "telephone"],
)
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
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == (
        "rgb(20, 23, 27)" if dark else "rgb(255, 255, 255)"
    )


def test_a_frame_shows_its_page_as_it_is(chromium, page_file, tmp_path):
    """As in a notebook; the second time without the sandbox, so that the test can look into it."""
    frame = framed(page_file.read_text(encoding="utf-8"))
    assert len(frame) < page_file.stat().st_size / 2
    notebook = tmp_path / "notebook.html"
    for shown in (frame, frame.replace("sandbox='allow-scripts allow-downloads'", "")):
        notebook.write_text(f"<!doctype html><title>notebook</title>{shown}", encoding="utf-8")
        outside = chromium.open(notebook)
        assert outside.messages == []
    alone = chromium.open(page_file)
    for what in ("title", "body.innerText.length", "querySelectorAll('.player button').length"):
        assert (
            outside.evaluate(f"document.querySelector('iframe').contentDocument.{what}")
            == alone.evaluate(f"document.{what}")
            != 0
        )


def test_a_long_row_of_figures_wraps_on_a_telephone(chromium, page_file):
    """The efforts of a scene with four inputs are wider than the screen."""
    page = chromium.open(page_file, width=390)
    page.evaluate("document.querySelectorAll('details').forEach((item) => { item.open = true; })")
    page.evaluate(
        "document.querySelectorAll('.pairs td.n').forEach((cell) => { cell.textContent = '0.00714 N m, '.repeat(8); })"
    )
    assert page.evaluate("document.querySelectorAll('.pairs td.n').length") > 0
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


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
    assert (
        desk.evaluate(
            "[...document.querySelectorAll('table')].filter((t) => !t.caption || !t.caption.textContent.trim()).length"
        )
        == 0
    )
    assert desk.evaluate("[...document.querySelectorAll('th')].filter((h) => !h.scope).length") == 0
    assert (
        desk.evaluate(
            "[...document.querySelectorAll('.draw')].filter((d) => !(/. (Arrow keys read values|Tab moves from point to point)\\.$/.test(d.getAttribute('aria-label')) && d.tabIndex === 0)).length"
        )
        == 0
    )
    assert desk.evaluate("document.querySelectorAll('svg.plot').length") > 100
    assert (
        desk.evaluate(
            "[...document.querySelectorAll('.sign')].filter((s) => !/\\S+ \\S+/.test(s.textContent)).length"
        )
        == 0
    ), "a symbol and a word"
    assert (
        desk.evaluate(
            "[...document.querySelectorAll('button, input, canvas')].filter((e) => !(e.textContent.trim() || e.ariaLabel || e.labels?.length)).length"
        )
        == 0
    )


def test_values_are_read_off_a_plot_by_keyboard(desk, full_folder, factory):
    """The last value of q1 in Fig. 4, as the record has it."""
    desk.evaluate("document.querySelector('#tightening-1 [data-read]').focus()")
    desk.press("End")
    lines = "[...document.querySelectorAll('#tightening-1 .fig:has([data-read]) output span')].map((line) => line.textContent)"
    # The numbers are unpacked when they are first asked for.
    told = desk.evaluate(
        f"(async () => {{ for (let turn = 0; turn < 400 && !{lines}.length; turn += 1) await new Promise((done) => setTimeout(done, 25)); return {lines}; }})()"
    )
    assert told[0] == "time 5 s"
    read = re.search(r"q1, ε = 10⁻⁷ ([\d.]+) m", "; ".join(told))
    assert read is not None
    run = next(run for run in factory.runs() if run.pipeline == "softplus_dc+strict")
    plan = factory.motion(full_folder, run, run.stages[2]).plan
    assert float(read[1]) == pytest.approx(plan.columns["q1"][-1], abs=1e-3)
    assert desk.evaluate("document.querySelectorAll('#tightening-1 .cursor').length") == 1


def test_points_of_the_front_tell_their_stage_on_focus(desk):
    desk.evaluate("document.querySelector('#front-1 .draw a').focus()")
    assert desk.evaluate("document.querySelector('#front-1 .fig output').textContent").startswith(
        "strict_lcp: cost 496.63"
    )


def test_the_filter_follows_the_address(chromium, page_file):
    page = chromium.open(page_file, fragment="#runs?crashed")
    assert page.evaluate(
        "[...document.querySelectorAll('article.run')].filter((run) => !run.hidden).map((run) => run.querySelector('h3').textContent.trim().split(' ')[0])"
    ) == ["crashing"]
    page.evaluate("location.hash = '#run-1'")
    page.evaluate("new Promise((done) => setTimeout(done, 50))")
    assert page.evaluate("document.getElementById('run-1').hidden") is False
    assert page.messages == []


def test_the_player_moves(chromium, run_file):
    desk = chromium.open(run_file)
    inside = "document.querySelector('[data-player]')"
    before = desk.evaluate(f"{inside}.querySelector('canvas').toDataURL()")
    desk.evaluate(
        f"(() => {{ const s = {inside}.querySelector('input'); s.value = 60; s.dispatchEvent(new Event('input')); }})()"
    )
    assert desk.evaluate(f"{inside}.querySelector('output').textContent") == "2.00 of 5.00 s"
    assert desk.evaluate(f"{inside}.querySelector('canvas').toDataURL()") != before


def _files_of(path: Path) -> set[str]:
    """Addresses of a page and of the files it needs: those of a campaign's folder of pages share two."""
    shared = ("report.css", "report.js") if path.parent.name == PAGES else ()
    return {place.resolve().as_uri() for place in (path, *(path.parent / name for name in shared))}


def test_hostile_strings_do_nothing(chromium, hostile_folder, factory):
    page = chromium.open(write_single(hostile_folder))
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


def test_names_of_small_bodies_do_not_overlap(chromium, factory, tmp_path):
    """What the picture writes on a body or beside it, at any time: nothing on something else, and nothing left out."""
    run = factory.run("strict", None, "strict_lcp")
    names = {shape.name: f"a long name of the {shape.name} cart" for shape in run.scene.shapes}
    shapes = tuple(
        replace(shape, name=names[shape.name], size=(0.02, 0.02)) for shape in run.scene.shapes
    )
    run = replace(run, scene=replace(run.scene, shapes=shapes))
    write_report(factory.store(tmp_path / "small", [run]))
    page = chromium.open(tmp_path / "small" / "pages" / run_pages([run])[run.key])
    pairs = page.evaluate("""(() => {
      const player = document.querySelector("[data-player]"), slider = player.querySelector("input"), pen = player.querySelector("canvas").getContext("2d");
      const write = pen.fillText.bind(pen);
      let told = [];
      pen.fillText = (text, x, y) => { told.push([text, x, y, pen.measureText(text).width]); write(text, x, y); };
      const [seen, over] = [[], []];
      for (let frame = 0; frame <= 150; frame += 15) {
        told = [];
        slider.value = frame;
        slider.dispatchEvent(new Event("input"));
        const names = told.filter((one) => one[0].startsWith("a long name"));
        seen.push(names.length);
        names.forEach((one, place) => names.slice(place + 1).forEach((other) => {
          if (Math.abs(one[1] - other[1]) < (one[3] + other[3]) / 2 && Math.abs(one[2] - other[2]) < 14) over.push([frame, one, other]);
        }));
      }
      return [seen, over];
    })()""")
    assert pairs == [[3] * 11, []]


def test_every_table_is_saved_as_csv(chromium, page_file):
    """The file's text as the button makes it, numbers as a program reads them."""
    page = chromium.open(page_file)
    page.evaluate("document.querySelectorAll('details').forEach((item) => { item.open = true; })")
    assert (
        page.evaluate(
            "document.querySelectorAll('button.take').length === document.querySelectorAll('table').length"
        )
        is True
    )
    page.evaluate(
        "window.saved = []; URL.createObjectURL = (blob) => { saved.push(blob); return 'blob:none'; };"
        "HTMLAnchorElement.prototype.click = function () { saved.push(this.download); }; 0"
    )
    page.evaluate("document.querySelector('#table1 button.take').click()")
    text, name = page.evaluate("saved[0].text().then((text) => [text, saved[1]])")
    rows = list(csv.reader(text.lstrip("\ufeff").splitlines()))
    assert name.endswith(".csv")
    assert rows[0][:5] == [
        "Stage",
        "Verdict",
        "Cost ours",
        "Cost ours, relative to the paper's",
        "Cost paper",
    ]
    assert {len(row) for row in rows} == {len(rows[0])}
    first = next(row for row in rows if row[0].startswith("softplus_dc"))
    assert (float(first[2]), float(first[4])) == (197.863, 197.86)


def test_what_a_link_leads_to_is_opened_with_all_around_it(desk):
    """Where what is next to it is open already, too.

    A browser that opens nothing itself is one that is told of the address afterwards.
    """
    opened = desk.evaluate("""(async () => {
      const added = document.createElement("details");
      added.innerHTML = "<summary>outer</summary><details open><summary>inner</summary><p id='in-two'>here</p></details>";
      document.querySelector("main").append(added);
      history.replaceState(null, "", "#in-two");
      const before = added.open;
      dispatchEvent(new Event("hashchange"));
      const after = added.open;
      added.remove();
      history.replaceState(null, "", "#");
      return [before, after];
    })()""")
    assert opened == [False, True]


def test_a_player_in_a_closed_run_is_there_when_it_is_opened(chromium, page_file):
    page = chromium.open(page_file)
    drawn = "document.querySelector('#run-2 [data-player] output').textContent"
    assert page.evaluate(drawn) == ""
    page.evaluate(
        "document.getElementById('run-2').scrollIntoView({ behavior: 'instant' }); document.querySelector('#run-2 details.whole').open = true"
    )
    assert (
        page.evaluate(
            f"(async () => {{ for (let turn = 0; turn < 400 && !{drawn}; turn += 1) await new Promise((done) => setTimeout(done, 50)); return {drawn}; }})()"
        )
        == "0.00 of 5.00 s"
    )


def test_arrows_of_contact_forces_are_drawn(chromium, run_file):
    """Where a force acts the picture has pixels of the arrows' colour, before the first contact none."""
    desk = chromium.open(run_file)
    count = (
        "(() => { const p = document.querySelector('[data-player]'), s = p.querySelector('input'), c = p.querySelector('canvas');"
        "s.value = FRAME; s.dispatchEvent(new Event('input')); const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        "let n = 0; for (let i = 0; i < d.length; i += 4) if (d[i] === 179 && d[i + 1] === 64 && d[i + 2] === 10) n += 1; return n; })()"
    )
    counts = [desk.evaluate(count.replace("FRAME", str(frame))) for frame in range(0, 151, 10)]
    assert counts[0] == 0
    assert max(counts) > 50


# A4 across, less the margins of 12 mm, in pixels of CSS.
_PAPER = 1032


@pytest.fixture(scope="module")
def many(factory, tmp_path_factory):
    """The folder of one pipeline's runs on sixteen scenes, and of stress cases whose sentences are long."""
    one = factory.run("strict", None, "strict_lcp")
    runs = [
        replace(one, key=f"strict-{place:016d}", scene=factory.scene(f"a_scene_of_number_{place}"))
        for place in range(16)
    ]
    cases = [
        CheckRecord(
            key=f"{place:064d}",
            kind="stress case",
            name=f"{place:02d} A case",
            expected="What is expected of it, at some length. " * 4,
            outcome="answered",
            passed=True,
            found="What happened to it, with figures of every kind. " * 5,
            wall_seconds=2.0,
            cpu_seconds=1.5,
            provenance=factory.provenance(),
        )
        for place in (1, 2)
    ]
    keys = tuple(item.key for item in (*runs, *cases))
    return factory.store(
        tmp_path_factory.mktemp("many") / "all", [*runs, *cases], factory.campaign(runs, keys=keys)
    )


@pytest.fixture(scope="module")
def many_file(many):
    return write_report(many)


def test_paper_has_the_verdicts_of_all_scenes(chromium, many_file):
    page = chromium.open(many_file, width=_PAPER)
    page.call("Emulation.setEmulatedMedia", media="print")
    past = page.evaluate("""(() => {
      const cells = [...document.querySelectorAll(".grid-of-runs th, .grid-of-runs td")];
      const over = cells.filter((cell) => cell.scrollWidth > cell.clientWidth + 1 || cell.getBoundingClientRect().right > innerWidth);
      return [cells.length, over.length];
    })()""")
    assert past == [2 * 17, 0]


def test_one_word_opens_for_paper_what_is_closed_but_the_runs(chromium, many):
    """Motion, stages and log of hundreds of runs would be a thousand pages.

    A run that is open is printed whole.
    """
    page = chromium.open(write_single(many))
    page.evaluate("document.querySelector('#run-2 details.whole > summary').click()")
    told = page.evaluate("""(() => {
      const open = document.querySelectorAll("main details[open]").length;
      dispatchEvent(new Event("beforeprint"));
      const shut = [...document.querySelectorAll("main details:not([open])")].filter((item) => !item.parentElement.closest(".whole:not([open])"));
      const inside = document.querySelectorAll("#run-2 details:not([open])").length;
      dispatchEvent(new Event("afterprint"));
      return [shut.length, shut.every((item) => item.matches("article.run > .whole")), inside, open - document.querySelectorAll("main details[open]").length];
    })()""")
    assert told[:3] == [15, True, 0]
    assert told[3] == 0, "what was open is open, and nothing else"
    assert page.messages == []


def test_stress_cases_are_read_on_a_telephone_without_scrolling_sideways(chromium, many_file):
    page = chromium.open(many_file.parent / PAGES / "stress-cases.html", width=390)
    assert page.evaluate(
        "(() => { const box = document.querySelector('.cases').parentElement; return box.scrollWidth <= box.clientWidth; })()"
    )
    texts = page.evaluate(
        "[...document.querySelectorAll('.cases td.text')].map((cell) => cell.getBoundingClientRect().width)"
    )
    assert len(texts) == 6
    assert min(texts) > 250


@pytest.fixture(scope="module")
def pages(full_folder):
    """report.html and the folder of its pages."""
    report = write_report(full_folder)
    return report, report.parent / "pages"


def _settled(page, expression: str):
    """The value once the address has been followed."""
    return page.evaluate(f"new Promise((done) => setTimeout(done, 100)).then(() => ({expression}))")


def test_without_script_nothing_is_offered_that_does_nothing(chromium, pages, run_file, page_file):
    for path in (run_file, pages[0], page_file):
        page = chromium.open(path, script=False)
        shown = "(e) => e.getClientRects().length > 0"
        assert (
            page.evaluate(
                f"[...document.querySelectorAll('button, input, select, canvas')].filter({shown}).length"
            )
            == 0
        )
        assert "sorts by it" not in page.evaluate("document.body.innerText")
        assert page.messages == []
    page = chromium.open(page_file, script=False)
    assert not unsaid(
        page.evaluate("document.querySelector('.scriptless').textContent"),
        "drawn by the page's script",
    )
    assert (
        page.evaluate("getComputedStyle(document.querySelector('.scriptless')).display") == "block"
    )
    page = chromium.open(page_file)
    assert (
        page.evaluate("getComputedStyle(document.querySelector('.scriptless')).display") == "none"
    )
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


@pytest.mark.parametrize(
    "fragment",
    [
        "#%", "#%E0%A4%A", "#matrix?scene=%ZZ&sort=__proto__&x=1", "#runs?%E0%A4%A",
        "#<script>alert(1)</script>", "#runs?☃", "#" + "x" * 20_000,
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
    run, scene = (
        chromium.open(led(page, link)) for link in (".grid-of-runs td a", "#index tbody a")
    )
    assert run.evaluate("document.querySelectorAll('article.run svg.plot').length") > 8
    assert scene.evaluate("document.querySelectorAll('[id^=tightening] svg.plot').length") > 8
    assert [led(one, "nav.contents a") for one in (run, scene)] == [pages[0].resolve()] * 2
    assert [one.messages for one in (page, run, scene)] == [[]] * 3


def test_a_closed_stage_is_opened_by_the_contents_of_its_page(chromium, pages):
    page = chromium.open(next(pages[1].glob("*--softplus_dc-strict*.html")))
    first = "document.querySelector('details.stage')"
    assert page.evaluate(f"{first}.open") is False
    page.evaluate(f"document.querySelector(`nav.contents a[href='#${{{first}.id}}']`).click()")
    assert _settled(page, f"{first}.open") is True


@pytest.mark.parametrize(("width", "dark"), [(1400, False), (375, True)])
def test_axe_finds_no_violation(chromium, page_file, pages, width, dark):
    """WCAG 2.0, 2.1 and 2.2, A and AA, by axe-core: a page of each kind, and on a telephone at night all in one file, with everything open."""
    axe = pytest.importorskip(
        "axe_core_python", reason="axe-core-python is not installed (extra [test])"
    )
    script = (Path(axe.__path__[0]) / "axe.min.js").read_text(encoding="utf-8")
    kinds = (
        pages[0],
        next(pages[1].glob("*--softplus_dc-strict*.html")),
        next(pages[1].glob("scene-*.html")),
    )
    for path in (page_file,) if dark else kinds:
        page = chromium.open(path, width=width, dark=dark)
        assert page.messages == []
        assert {*page.requests} == _files_of(path)
        # Two runs with all they hold stand for the others: hundreds of plots more are the same
        # markup.
        page.evaluate(
            "document.querySelectorAll('article.run').forEach((run, place) => { if (place > 1) run.remove(); })"
        )
        page.evaluate(
            "document.querySelectorAll('details').forEach((item) => { item.open = true; })"
        )
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
    kinds = [path for path in (pages[0], *sorted(pages[1].glob("*.html"))) if "--" not in path.name]
    assert {path.stem for path in kinds} >= {
        "report",
        "runs",
        "provenance",
        "scene-three_cart",
    }
    for path in kinds:
        page = chromium.open(path, width=width)
        page.evaluate(
            "document.querySelectorAll('details').forEach((item) => { item.open = true; })"
        )
        assert (page.messages, {*page.requests}) == ([], _files_of(path))
        assert page.evaluate("document.documentElement.scrollWidth") <= width, path.name
        page.call("Page.close")

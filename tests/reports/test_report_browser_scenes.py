"""A campaign of many scenes in headless Chromium: all of it on paper, on a telephone, and in the tables that are saved."""

import pytest

from reports.records.check_record import CheckRecord
from reports.render import PAGES, write_report, write_single

# A4 across, less the margins of 12 mm, in pixels of CSS.
_PAPER = 1032


@pytest.fixture(scope="module")
def many(factory, tmp_path_factory):
    """The folder of one pipeline's runs on sixteen scenes, and of stress cases whose sentences are long."""
    one = factory.run("strict", None, "strict_lcp")
    runs = [
        one.model_copy(update={"key": f"strict-{place:016d}", "scene": factory.scene(f"a_scene_of_number_{place}")}) for place in range(16)
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
    return factory.store(tmp_path_factory.mktemp("many") / "all", [*runs, *cases], factory.campaign(runs, keys=keys))


@pytest.fixture(scope="module")
def many_file(many):
    return write_report(many)


@pytest.mark.slow
def test_paper_has_the_verdicts_of_all_scenes(chromium, many_file):
    page = chromium.open(many_file, width=_PAPER)
    page.call("Emulation.setEmulatedMedia", media="print")
    past = page.evaluate("""(() => {
      const cells = [...document.querySelectorAll(".grid-of-runs th, .grid-of-runs td")];
      const over = cells.filter((cell) => cell.scrollWidth > cell.clientWidth + 1 || cell.getBoundingClientRect().right > innerWidth);
      return [cells.length, over.length];
    })()""")
    assert past == [2 * 17, 0]


@pytest.mark.slow
def test_one_word_opens_for_paper_what_is_closed_but_the_runs(chromium, many):
    """Motion, stages and log of hundreds of runs would be a thousand pages; a run that is open is printed whole."""
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
    texts = page.evaluate("[...document.querySelectorAll('.cases td.text')].map((cell) => cell.getBoundingClientRect().width)")
    assert len(texts) == 6
    assert min(texts) > 250

"""The stability page: a row a stress case with a word and a symbol, plots from the record's own data, and what the time step was known to be."""

import html
import re
from dataclasses import replace

import pytest
from wording import unsaid

from models.results.check import AxisRecord, ChartRecord, CheckRecord, SeriesRecord
from models.results.run import TimeStepRecord
from models.results.stored import to_json
from models.results.verdict import Metric
from reports.render import write_single


def figure(name: str, value: float | None, limit: float | None, **changes) -> Metric:
    ok = (
        None
        if limit is None
        else value is not None and (value >= limit if changes.get("at_least") else value <= limit)
    )
    return Metric(
        name=name, value=value, unit="m", meaning="", limit=limit, reason="why so", ok=ok, **changes
    )


def chart(**changes) -> ChartRecord:
    curve = SeriesRecord(name="h = 0.01 s", x=(1.0, 10.0, 100.0), y=(0.0, 1e-3, 1e-1))
    said = {
        "title": "Radius against k",
        "x": AxisRecord(quantity="stiffness", unit="N/m", log=True),
        "y": AxisRecord(quantity="radius", log=True),
    }
    return ChartRecord(
        **{**said, "series": (curve,), "level": 1e-2, "level_words": "limit", **changes}
    )


def case(factory, place: int, title: str, **changes) -> CheckRecord:
    said = {
        "key": f"{place:064d}", "kind": "stress case", "name": f"{place:02d} {title}",
        "expected": f"What is expected of {title}.",
        "outcome": "answered", "passed": True, "found": f"What happened to {title}.",
        "figures": (figure("only told", 3.0, None), figure("first", 0.9, 1.0),
                    figure("second", 1e-9, 1.0), figure("third", 0.5, 1.0)),
        "wall_seconds": 2.0, "cpu_seconds": 1.5, "provenance": factory.provenance(),
    }  # fmt: skip
    return CheckRecord(**{**said, **changes})


@pytest.fixture
def page(factory, tmp_path):
    """The report's text over these stress cases, beside one run."""

    def made(*cases: CheckRecord, **campaign) -> str:
        folder, run = tmp_path / "all", factory.runs()[0]
        record = factory.campaign([run], **campaign)
        factory.store(
            folder,
            [run],
            replace(record, keys=(run.key, *(item.key for item in cases))),
        )
        for item in cases:
            (folder / "runs" / item.key).mkdir(parents=True)
            (folder / "runs" / item.key / "record.json").write_text(to_json(item))
        made.raw = write_single(folder).read_text(encoding="utf-8")
        return html.unescape(made.raw)

    return made


def rows(text: str) -> list[str]:
    body = text[text.index('aria-label="Stress cases"') :]
    return re.findall(
        r"<tr><td class=\"n\">.*?</tr>", body[: body.index("</table>")], flags=re.DOTALL
    )


def test_cases_stand_in_rows_and_what_fails_fails_the_campaign(page, factory):
    """Every table says what it is: the script that offers it as CSV names it by its caption, and ends without one, and the players after it."""
    wrong = case(
        factory,
        3,
        "wrong",
        passed=False,
        figures=(figure("fine", 0.99, 1.0), figure("order", 1.0, 1.8, at_least=True)),
    )
    lost = case(
        factory,
        4,
        "hung",
        outcome="time_limit",
        passed=False,
        found="",
        figures=(),
        message="ended at 120 s.",
        log_tail="last words",
    )
    empty = chart(title="Nothing in it", series=(SeriesRecord(name="none", x=(), y=()),))
    text = page(case(factory, 1, "right", charts=(chart(), empty)), wrong, lost)
    assert not unsaid(
        text,
        "1 of 3 stress cases pass",
        "last words",
        "stress case: 03 wrong: failed - What happened to wrong.",
    )
    assert re.search(r'id="stress-case-03".*?<details open>', text, flags=re.DOTALL)
    hung, failed, right = sorted(
        rows(text), key=lambda row: ("no answer" not in row, "fail" not in row)
    )
    assert not unsaid(hung, "○</span> no answer", "ended at 120 s.")
    assert not unsaid(failed, "✗</span> fail", "order: 1 m (≥ 1.8 m); fine: 0.99 m (≤ 1 m)")
    assert "✓</span> pass" in right
    drawn = text[text.index('id="stress-case-01"') :].split("</article>")[0]
    assert not unsaid(
        drawn,
        "Radius against k",
        "h = 0.01 s: stiffness 1, radius 0",
        "at its lower end, off the line",
        ">limit</text>",
    )
    assert drawn.count("<title>") == 3
    assert "Nothing in it" not in drawn
    body = text[text.index('id="stress-cases"') :]
    assert body.count("<table") == len(re.findall(r"<table[^>]*>\s*<caption>[^<]", body)) > 2


@pytest.mark.slow
def test_what_was_known_of_the_time_step_stands_with_the_scene_and_a_warning_in_the_summary(page):
    known = {
        "scene": "three_cart", "digest": "0", "step": 0.01, "radius": 1.0,
        "contacts": ("left", "right"), "growth": 0.0,
        "largest_step": 0.19,
    }  # fmt: skip
    stable = page(time_steps=(TimeStepRecord(**known),))
    assert "stable in contact" in stable
    assert not unsaid(stable, "left and right closed; … below 0.19 s.")
    warned = page(time_steps=(TimeStepRecord(**{**known, "radius": 3.0, "largest_step": 0.005}),))
    first = warned[warned.index('id="overview"') : warned.index('id="table1"')]
    assert "Scene three_cart: with left and right closed, a step of 0.01 s lies past" in first

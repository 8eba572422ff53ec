"""Every table of the page as the file that its button saves: one head, numbers as a program reads them, names of their own."""

import csv
import io
import re
from dataclasses import replace

import pytest

from reports.render import write_single

pytestmark = pytest.mark.slow

# Presses every button of the page: what it calls each file, and its text.
_SAVED = """(async () => {
  document.querySelectorAll("details").forEach((item) => { item.open = true; });
  const [blobs, names] = [[], []];
  URL.createObjectURL = (blob) => { blobs.push(blob); return "blob:none"; };
  HTMLAnchorElement.prototype.click = function () { names.push(this.download); };
  document.querySelectorAll("button.take").forEach((button) => button.click());
  return Promise.all(blobs.map(async (blob, place) => [names[place], await blob.text()]));
})()"""


def _saved(page) -> dict[str, list[list[str]]]:
    found = page.evaluate(_SAVED)
    tables = {
        name: list(csv.reader(io.StringIO(text.lstrip("\ufeff"), newline=""), strict=True))
        for name, text in found
    }
    assert (
        len(tables) == len(found) == page.evaluate("document.querySelectorAll('table').length")
    ), "each has a name of its own"
    return tables


@pytest.fixture(scope="module")
def tables(chromium, page_file):
    return _saved(chromium.open(page_file))


def test_every_file_has_one_head_and_rows_of_its_length(tables):
    assert len(tables) > 50
    for name, rows in tables.items():
        assert re.fullmatch(r"[^\W_][\w-]{2,150}\.csv", name), name
        assert not name.endswith("-csv.csv")
        assert {len(row) for row in rows} == {len(rows[0])}, name
        assert all(rows[0]), name
        assert len(set(rows[0])) == len(rows[0]), (name, rows[0])


def test_units_and_second_numbers_have_columns_of_their_own(tables):
    score = next(
        rows
        for name, rows in tables.items()
        if name == "strict-on-three_cart-stage-1-judgement-of-this-stage.csv"
    )
    value, unit = score[0].index("Value"), score[0].index("Value, unit")
    told = [row for row in score[1:] if row[value]]
    assert len(told) > 5
    named = [row for row in told if not row[0].endswith("?")]  # a question has its answer there
    assert all(float(row[value]) >= 0 for row in named)
    assert {"m", "N s"} <= {row[unit] for row in named}
    own, against = score[0].index("Value, own error"), score[0].index("Value, against its limit")
    assert {row[own] for row in named} == {"", "3e-09"}
    assert {row[against] for row in named} == {"", "✓ within"}


def test_a_second_number_of_a_cell_has_a_column_too(chromium, factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp")
    (stage,) = run.stages
    metrics = [
        replace(item, value=1.25e-3) if item.name == "replay_terminal_position_error" else item
        for item in stage.metrics
    ]
    stage = replace(stage, metrics=tuple(metrics))
    folder = factory.store(tmp_path / "two", [replace(run, stages=(stage,))])
    head, row, *_ = _saved(chromium.open(write_single(folder)))["three_cart-stages.csv"]
    place = head.index("Terminal error: position [m], below velocity [m/s] replay, velocity")
    assert head[place - 1] == "Terminal error: position [m], below velocity [m/s] replay"
    assert (float(row[place - 1]), float(row[place])) == (1.25e-3, pytest.approx(0.6 * 4.1e-3))


def test_what_is_not_there_is_empty_and_says_why(tables):
    head, *rows = tables["strict-on-three_cart-stage-1-judgement-of-this-stage.csv"]
    assert head[-1] == "Why a value is not there"
    limit = head.index("Limit")
    rows = [row for row in rows if not row[0].endswith("?") and row[0] != "Shown, not judged"]
    assert {bool(row[limit]) for row in rows} == {True, False}
    assert all(row[-1] == ("" if row[limit] else "no limit") for row in rows)
    assert all(float(row[limit]) > 0 for row in rows if row[limit])


def test_tables_without_heads_are_saved_with_one(tables):
    seconds = tables["strict-on-three_cart-stage-1-seconds.csv"]
    assert seconds[0] == ["Quantity", "Seconds"]
    assert all(float(value) >= 0 for _, value in seconds[1:] if value)


def test_nothing_that_a_spreadsheet_would_run_is_saved(chromium, hostile_folder, factory, tmp_path):
    run = factory.run(
        "=cmd|'/C calc'!A0", None, "strict_lcp", scene=factory.scene('@SUM(1+1)"\n,x')
    )
    pages = [hostile_folder, factory.store(tmp_path / "formula", [run])]
    for folder in pages:
        for name, rows in _saved(chromium.open(write_single(folder))).items():
            assert re.fullmatch(r"[\w-]+\.csv", name), name
            for field in (
                field
                for row in rows
                for field in row
                if not re.fullmatch(r"-?[\d.]+(e-?\d+)?", field)
            ):
                assert not field.startswith(("=", "+", "-", "@", "\t", "\r", "−")), (name, field)

"""A large page keeps parts folded, a split report has pages: both tell what the plain page tells."""

from __future__ import annotations

import base64
import json
import re
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.parcels import Parcels, line_bytes
from reports.records.load import ReportError
from reports.render import LARGEST_PLAIN, render
from reports.split import write_pages


def unpacked(text: str) -> tuple[dict, bytes]:
    raw = zlib.decompress(base64.b64decode(text))
    end = 4 + int.from_bytes(raw[:4], "little")
    return json.loads(raw[4:end]), raw[end:]


def lines_of(raw: bytes) -> list[str]:
    """What fold.js does, written again: seven bits a byte, counts, all x, all y."""
    numbers, value, shift = [], 0, 0
    for byte in raw:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            numbers.append(value)
            value, shift = 0, 0
    amount, rest = numbers[0], [-(one + 1) // 2 if one % 2 else one // 2 for one in numbers[1 + numbers[0] :]]
    counts = numbers[1 : 1 + amount]
    total, lines, start = sum(counts), [], 0
    for count in counts:
        x = y = 0
        points = []
        for dx, dy in zip(rest[start : start + count], rest[total + start : total + start + count], strict=True):
            x, y = x + dx, y + dy
            points.append(f"{x / 5:.1f},{y / 5:.1f}".replace(".0,", ",").removesuffix(".0"))
        lines.append("M" + "L".join(points))
        start += count
    return lines


def unfolded(page: str) -> str:
    """The page with every part back in its place."""
    blocks = dict(re.findall(r'<script type="application/octet-stream" data-block="(b\d+)">([^<]*)</script>', page))
    contents = {}
    for name, text in blocks.items():
        words, raw = unpacked(text)
        lines = lines_of(raw)
        figures = [re.sub(r'(?<= d=")#(\d+)', lambda found: lines[int(found[1])], figure) for figure in words["figures"]]  # noqa: B023
        contents[name] = [re.sub(r'<i data-figure="(\d+)"></i>', lambda found: figures[int(found[1])], part) for part in words["parts"]]  # noqa: B023
    place = re.compile(r'<div class="parcel" data-block="(b\d+)" data-part="(\d+)" data-holds="[^"]*"></div>')
    while place.search(page):
        page = place.sub(lambda found: contents[found[1]][int(found[2])], page)
    page = re.sub(r"<noscript>.*?</noscript>\n", "", page, flags=re.DOTALL)
    return re.sub(r'<script type="application/octet-stream".*?</script>\n', "", page, flags=re.DOTALL)


_PLACES = st.integers(-4000, 4000)


@given(st.lists(st.lists(st.tuples(_PLACES, _PLACES), min_size=1, max_size=20), max_size=8))
def test_lines_come_back_to_a_fifth_of_a_pixel(lines):
    drawn = ["M" + "L".join(f"{x / 5:.1f},{y / 5:.1f}".replace(".0,", ",").removesuffix(".0") for x, y in line) for line in lines]
    assert lines_of(line_bytes(drawn)) == drawn


def test_parts_inside_parts_come_back():
    parcels = Parcels()
    inner = parcels.keep("one", '<p id="inner">in</p>')
    outer = parcels.keep("two", f'<div id="outer">{inner}</div>')
    whole = f"<main>{outer}</main>"
    assert parcels.inline(whole) == '<main><div id="outer"><p id="inner">in</p></div></main>'
    (page,), blocks = parcels.folded([whole])
    assert 'data-holds="outer inner"' in page
    assert [unpacked(block.text)[0]["parts"] for block in blocks] == [
        ['<div id="outer"><div class="parcel" data-block="b1" data-part="0" data-holds="inner"></div></div>'],
        ['<p id="inner">in</p>'],
    ]


def test_a_folded_page_unfolds_to_the_plain_one(full_folder):
    plain, folded = render(full_folder, largest=10**9), render(full_folder, largest=0)
    assert len(folded) < len(plain) / 3
    assert "softplus_dc+strict" in folded
    assert unfolded(folded) == plain


def test_hostile_strings_do_not_leave_a_folded_part(hostile_folder, factory):
    folded = render(hostile_folder, largest=0)
    assert not re.search(r"<(img|b|iframe)\b", folded)
    assert not re.search(r"<(img|b|iframe)\b", unfolded(folded))
    assert unfolded(folded) == render(hostile_folder, largest=10**9)


def test_a_name_that_looks_like_a_place_is_text(factory, tmp_path):
    run = factory.run("strict", None, "strict_lcp", pipeline_title="\x010\x02 <div class=parcel data-part=0>")
    quantity = run.scene.coordinates[0].model_copy(update={"name": "q1\x010\x02"})
    run = run.model_copy(update={"scene": run.scene.model_copy(update={"coordinates": (quantity, *run.scene.coordinates[1:])})})
    folder = factory.store(tmp_path / "odd", [run])
    page = render(folder)
    assert "\x01" not in page
    assert "0 &lt;div class=parcel" in page
    assert unfolded(render(folder, largest=0)) == page


def test_small_pages_are_plain(factory, tmp_path):
    page = render(factory.store(tmp_path / "one", [factory.runs()[0]]))
    assert len(page) < LARGEST_PLAIN
    assert "data-block" not in page.split("<script>")[0]


def test_pages_tell_the_same_and_lead_to_each_other(full_folder):
    index = write_pages(full_folder)
    assert index.name == "index.html"
    pages = {path.name: path.read_text(encoding="utf-8") for path in index.parent.glob("*.html")}
    plain = render(full_folder, largest=10**9)
    anchors = {name: set(re.findall(r' id="([^"]+)"', text)) for name, text in pages.items()}
    for name, text in pages.items():
        for place, anchor in re.findall(r' href="([^"#]*)#([^"]+)"', text):
            assert anchor in anchors[place or name], (name, place, anchor)
        assert 'data-block="b' not in text
    drawn = [figure for figure in re.findall(r"<figure .*?</figure>", plain, re.DOTALL) if "href=" not in figure]
    assert len(drawn) > 50
    everything = "".join(pages.values())
    assert all(figure in everything for figure in drawn)
    assert len([name for name in pages if name.startswith("run-")]) == plain.count('<article class="run"')


def test_pages_of_runs_that_are_gone_go_too(factory, tmp_path):
    index = write_pages(factory.store(tmp_path / "once", [factory.run("strict", None, "strict_lcp")]))
    pages = {path.name for path in index.parent.iterdir()}
    for name in ("run-7.html", "run-of-mine.html"):
        (index.parent / name).write_text("old")
    write_pages(index.parent.parent)
    assert {path.name for path in index.parent.iterdir()} == pages | {"run-of-mine.html"}


def test_a_file_in_the_place_of_the_pages_is_one_sentence(factory, tmp_path):
    folder = factory.store(tmp_path / "blocked", [])
    (folder / "report").write_text("")
    with pytest.raises(ReportError, match="cannot be written"):
        write_pages(folder)

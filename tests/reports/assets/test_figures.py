"""Figures, tables and the player as their buttons and keys work them in headless Chromium."""

import base64
import csv
import io
import struct
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

pytestmark = pytest.mark.slow

# Every file that is saved from now on: its name, and its bytes.
_LISTEN = """(() => {
  window.saved = [];
  const create = URL.createObjectURL;
  let blob = null;
  URL.createObjectURL = (made) => { blob = made; return create(made); };
  HTMLAnchorElement.prototype.click = function () { saved.push([this.download, blob]); };
  document.querySelectorAll("details").forEach((item) => { item.open = true; });
})()"""
_BYTES = """(async () => {
  for (let turn = 0; turn < 400 && saved.length < COUNT; turn += 1) await new Promise((done) => setTimeout(done, 25));
  return Promise.all(saved.map(async ([name, blob]) => [name, btoa(String.fromCharCode(...new Uint8Array(await blob.arrayBuffer())))]));
})()"""
_NAMED = "[...document.querySelectorAll('figure')].find((one) => one.querySelector('figcaption').textContent.startsWith(NAME))"


def _saved(page, figure: str) -> dict[str, bytes]:
    """The three files of a figure by their endings."""
    page.evaluate(_LISTEN)
    page.evaluate(
        f"{_NAMED.replace('NAME', repr(figure))}.querySelectorAll('.save button').forEach((button) => button.click())"
    )
    files = page.evaluate(_BYTES.replace("COUNT", "3"))
    assert page.messages == []
    assert len(files) == 3
    return {name.rpartition(".")[2]: base64.b64decode(text) for name, text in files} | {
        "names": [name for name, _ in files]
    }


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_a_figure_is_saved_as_drawing_picture_and_numbers(
    chromium, run_file, full_folder, factory, dark
):
    page = chromium.open(run_file, dark=dark)
    files = _saved(page, "Positions")
    assert sorted(files["names"]) == [
        f"strict-on-three_cart-stage-1-positions-plan-dotted-replay-solid-m.{kind}"
        for kind in ("csv", "png", "svg")
    ]
    root = ElementTree.fromstring(files["svg"])
    space = "{http://www.w3.org/2000/svg}"
    words = {text.text for text in root.iter(f"{space}text")}
    assert {"Positions: plan dotted, replay solid", "time [s]", "position [m]"} <= words
    fills = {element.get("stroke") for element in root.iter(f"{space}path")}
    assert "rgb(11, 98, 173)" in fills, "light colours, whatever the page's are"
    assert (
        len(
            [
                line
                for line in root.iter(f"{space}path")
                if line.get("stroke-width") in ("1.8px", "1.5px") and "l" in line.get("d", "")
            ]
        )
        == 6
    )
    assert not [element for element in root.iter() if element.get("class")]
    width, height = (2 * int(root.get(side)) for side in ("width", "height"))
    assert files["png"].startswith(b"\x89PNG")
    assert struct.unpack(">II", files["png"][16:24]) == (width, height)

    head, *rows = csv.reader(io.StringIO(files["csv"].decode("utf-8-sig")))
    assert head == ["series", "time [s]", "position [m]"]
    run = next(run for run in factory.runs() if run.pipeline == "strict")
    plan = factory.motion(full_folder, run, run.stages[-1]).plan
    for name in ("q1", "q2", "q3"):
        mine = np.array([(float(t), float(q)) for series, t, q in rows if series == f"{name} plan"])
        assert mine[:, 0] == pytest.approx(plan.t, abs=1e-6)
        assert mine[:, 1] == pytest.approx(plan.columns[name], abs=1e-4)
    assert {series for series, *_ in rows} == {
        f"{name} {what}" for name in ("q1", "q2", "q3") for what in ("plan", "replay")
    }


def test_a_span_that_is_dragged_is_enlarged_until_a_double_click(chromium, run_file):
    page = chromium.open(run_file)
    state = page.evaluate("""(async () => {
      document.querySelectorAll("details").forEach((item) => { item.open = true; });
      const area = document.querySelector("[data-read]"), svg = area.querySelector("svg");
      area.scrollIntoView({ behavior: "instant", block: "center" });
      const told = () => [svg.querySelector("path[data-n]").getAttribute("d"), [...svg.querySelectorAll(".tick.x text")].map((one) => one.textContent)];
      const send = (kind, share, buttons) => {
        const box = svg.getBoundingClientRect();
        const place = { clientX: box.left + box.width * share, clientY: box.top + box.height / 2, bubbles: true, buttons, button: 0, pointerType: "mouse" };
        svg.dispatchEvent(new (kind === "dblclick" ? MouseEvent : PointerEvent)(kind, place));
      };
      const before = told();
      send("pointerover", 0.5, 0);
      send("pointerdown", 0.5, 1);
      send("pointermove", 0.7, 1);
      send("pointerup", 0.7, 0);
      for (let turn = 0; turn < 200 && told()[0] === before[0]; turn += 1) await new Promise((done) => setTimeout(done, 25));
      const enlarged = told();
      send("dblclick", 0.5, 0);
      return [before, enlarged, told()];
    })()""")
    before, enlarged, after = state
    assert enlarged[0] != before[0]
    ticks = [float(text) for text in enlarged[1]]
    assert len(ticks) >= 3
    assert 0.0 < ticks[0] < ticks[-1] < 5.0
    assert after == before


def test_a_table_is_sorted_filtered_and_saved_as_it_is_shown(chromium, page_file):
    page = chromium.open(page_file)
    page.evaluate(_LISTEN)
    table = "document.querySelector('table[data-name=\"three_cart stages\"]')"
    costs = f"[...{table}.tBodies[0].rows].filter((row) => !row.hidden).map((row) => row.cells[2].querySelector('data')?.value ?? null)"
    before = page.evaluate(costs)
    button = f"[...{table}.querySelectorAll('.sort')].find((one) => one.closest('th').textContent.startsWith('ours'))"
    page.evaluate(f"{button}.focus()")
    found = {}
    for way in ("ascending", "descending"):
        page.press("Enter")
        assert page.evaluate(f"{button}.closest('th').ariaSort") == way
        found[way] = page.evaluate(costs)
    for way, values in found.items():
        known = [float(value) for value in values if value is not None]
        assert known == sorted(known, reverse=way == "descending")
        assert values[len(known) :] == [None] * (len(values) - len(known)), (
            "what is empty comes last"
        )
        assert len(set(known)) > 3
    page.press("Enter")
    assert page.evaluate(costs) == before

    tools = f"{table}.closest('.scroll').previousElementSibling"
    page.evaluate(
        f"(() => {{ const i = {tools}.querySelector('input'); i.value = 'softplus_dc'; i.dispatchEvent(new Event('input')); }})()"
    )
    shown = len(page.evaluate(costs))
    assert 0 < shown < len(before)
    assert (
        page.evaluate(f"{tools}.querySelector('output').textContent") == f"{shown} of {len(before)}"
    )
    page.evaluate(f"{tools}.querySelector('.take').click()")
    ((_, text),) = page.evaluate(_BYTES.replace("COUNT", "1"))
    assert len(base64.b64decode(text).decode("utf-8-sig").splitlines()) == 1 + shown


def test_the_player_has_speeds_a_loop_and_things_to_hide(chromium, run_file):
    page = chromium.open(run_file)
    player = "document.querySelector('[data-player]')"
    page.evaluate(
        f"window.player = {player}; player.scrollIntoView({{ behavior: 'instant' }}); window.slider = player.querySelector('input'); 0"
    )
    page.evaluate(
        "window.pick = (name, value) => { const c = player.querySelector(`[name=${name}]`); if (c.type === 'checkbox') c.checked = value; else c.value = value; c.dispatchEvent(new Event('change')); }; 0"
    )
    picture = "player.querySelector('canvas').toDataURL()"
    page.evaluate("slider.value = 60; slider.dispatchEvent(new Event('input'))")
    for name in ("plan", "replay", "labels"):
        before = page.evaluate(picture)
        page.evaluate(f"pick('{name}', false)")
        assert page.evaluate(picture) != before, name
        page.evaluate(f"pick('{name}', true)")
        assert page.evaluate(picture) == before, name
    # Frames of a clock of our own: 0.4 s of it are 0.4 s of the motion, at a tenth of the speed a
    # tenth of that.
    page.evaluate(
        "window.clock = 0; performance.now = () => clock; window.queue = []; window.requestAnimationFrame = (step) => queue.push(step);"
        "window.pass = (ms) => { clock += ms; queue.splice(0).forEach((step) => step(clock)); }; 0"
    )
    told = "player.querySelector('output').textContent"
    for speed, reached in (("1", "0.40"), ("0.1", "0.04"), ("2", "0.80")):
        page.evaluate(
            f"slider.value = 0; slider.dispatchEvent(new Event('input')); pick('speed', '{speed}'); player.querySelector('.play').click(); pass(400)"
        )
        assert page.evaluate(told) == f"{reached} of 5.00 s"
        page.evaluate("player.querySelector('.play').click(); queue.length = 0")
    page.evaluate(
        "pick('speed', '2'); slider.value = 140; slider.dispatchEvent(new Event('input')); player.querySelector('.play').click(); pass(1000)"
    )
    assert page.evaluate(told) == "5.00 of 5.00 s"
    assert page.evaluate("[queue.length, player.querySelector('.play').ariaLabel]") == [0, "Play"]
    page.evaluate("pick('loop', true); player.querySelector('.play').click(); pass(4000)")
    assert page.evaluate("[queue.length, player.querySelector('.play').ariaLabel]") == [1, "Pause"]
    assert page.evaluate(told) == "0.00 of 5.00 s"
    page.evaluate("slider.focus()")
    for key, value in (("End", 150), ("Home", 0), ("ArrowRight", 1)):
        page.press(key)
        assert page.evaluate("Number(slider.value)") == value
    assert page.messages == []

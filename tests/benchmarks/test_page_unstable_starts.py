"""The page of unstable starts: its sentences are counted from the starts, a start without a plan is shown as one, names are escaped."""

import html
import re

import pytest

from benchmarks.page import render


def start(theta: float, **changes: object) -> dict:
    values = {
        "x": 0.1, "theta": theta, "share": 1.0, "outcome": "solved", "balanced": True,
        "why": "every limit is kept.", "wall_impulse": 0.0,
        "tracked_end": 0.02, "open_end": 0.1, "plan_end": 0.01, "effort": 0.03, "peak": 0.1,
        "amplification": 3000.0,
        "plan_cpu_s": 0.5, "judge_cpu_s": 0.7,
    }  # fmt: skip
    return values | changes


STARTS = (
    start(0.1),
    start(0.2, share=0.85, effort=0.05),
    start(0.4, wall_impulse=2.0, open_end=3.0, effort=0.2),
    start(-0.4, balanced=False, wall_impulse=1.0, tracked_end=0.4,
          why="<script>it ends 0.4 away</script>"),
    start(0.0, balanced=False, outcome="infeasible", why="no plan", tracked_end=None, open_end=None,
          plan_end=None, effort=None, peak=None,
          amplification=None),
)  # fmt: skip


@pytest.fixture
def page(benches, tmp_path) -> str:
    folder = tmp_path / "all"
    record = {
        "kind": "unstable_starts",
        "scene": "cart_pole_walls",
        "pipeline": "softplus_dc+strict",
        "seed": 1,
        "limit": 0.2,
    }
    benches.leave(folder, record | {"starts": list(STARTS)})
    return render(folder)


def test_the_sentence_is_counted_from_the_starts(page: str):
    (told,) = re.findall(r'<p class="conclusion">(.*?)</p>', html.unescape(page))
    assert (
        "3 of 5 starts are balanced in the replay with feedback, 1 of them by a wall; in the open loop 2 of these plans end as near."
        in told
    )
    assert (
        "Balanced without a wall, the feedback's RMS effort is 4 % of the half-range of the inputs in the median, at most 5 %."
        in told
    )
    assert (
        "Balanced by a wall, the feedback's RMS effort is 20 % of the half-range of the inputs in the median, at most 20 %."
        in told
    )
    assert "1 of them needed a plan that leaves the feedback some of the inputs." in told


def test_every_start_is_a_point_and_what_has_no_end_is_none(page: str):
    section = page[page.index('id="unstable-starts"') :]
    section = section[: section.index("</section>")]
    assert (
        section.count("not balanced, end") == 2 + 1
    )  # a title each; the one without a plan in the first plot only
    assert section.count('<tr><th scope="row">') == len(STARTS)


def test_words_of_a_record_are_escaped(page: str):
    assert "<script>it ends" not in page
    assert "&lt;script&gt;it ends 0.4 away" in page

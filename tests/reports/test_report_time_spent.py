"""Where time goes: the ten slowest runs by the profile in their records, and one sentence over all."""

import re

from reports.pages import time_spent
from reports.pages.section import Report
from reports.records.load import load
from reports.render import PAGES, write_report


def profiled(run, key, scale=1.0, **more):
    """3.5 s: half a second of start, one of solving's linear algebra, two of replay."""
    profile = {"start": 0.5 * scale, "linear_algebra": 1.0 * scale, "replay": 2.0 * scale} | more
    return run.model_copy(update={"key": key, "profile": profile, "wall_seconds": sum(profile.values())})


def test_the_ten_slowest_stand_first(factory, tmp_path):
    first = factory.runs()[0]
    runs = [profiled(first, f"{first.pipeline}-{n:02d}", scale=n) for n in range(1, 13)]
    section = time_spent.build(Report(load(factory.store(tmp_path / "all", [*runs, factory.runs()[1]]))))
    slowest = section.values["slowest"]
    assert [item.run.wall_seconds for item in slowest] == [3.5 * n for n in range(12, 2, -1)]
    for item in slowest:
        assert sum(item.groups) == item.run.wall_seconds
        assert item.phases[0][0] == "replaying"
    assert abs(sum(part.width for part in slowest[0].bar) - section.values["width"]) < 0.1, "the slowest fills the bar"
    assert abs(sum(part.width for part in slowest[-1].bar) - section.values["width"] * 3 / 12) < 0.1
    assert section.values["without"] == 1


def test_phases_nobody_named_are_shown_and_escaped(factory, tmp_path):
    first = factory.runs()[0]
    folder = factory.store(tmp_path / "all", [profiled(first, "one", **{factory.HOSTILE: 9.0, "made_up": 0.0})])
    write_report(folder)
    text = (folder / PAGES / "time-spent.html").read_text(encoding="utf-8")
    assert "<img" not in text
    section = re.search(r'id="time-spent".*?</section>', text, re.DOTALL)
    assert "9.00 s" in section[0]

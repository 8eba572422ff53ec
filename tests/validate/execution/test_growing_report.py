"""The report of a campaign is there when its first scene has ended, and grows; writing it takes a bounded share of the time."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from models.errors import MachineError
from validate.execution import growing_report
from validate.execution.growing_report import GrowingReport


def settled(written: list[object], count: int) -> None:
    ends = time.monotonic() + 20.0
    while len(written) < count and time.monotonic() < ends:
        time.sleep(0.005)


def test_one_is_written_at_a_time_and_the_next_waits_its_share(monkeypatch: pytest.MonkeyPatch):
    written: list[object] = []
    let = threading.Event()

    def write() -> None:
        let.wait(20.0)
        written.append(time.monotonic())

    with GrowingReport(write) as report:
        for _ in range(3):
            report.update()
        assert not written, "it is written beside us"
        let.set()
        settled(written, 1)
        time.sleep(0.05)
        report.update()  # the first took long: the next is due after twenty times as long
        assert len(written) == 1
        monkeypatch.setattr(growing_report, "_SHARE", 1e9)
        report._next = 0.0
        report.update()
        settled(written, 2)
    assert len(written) == 2


def test_a_disk_that_refuses_is_left_to_the_end():
    asked: list[object] = []

    def write() -> None:
        asked.append(None)
        raise MachineError("the disk is full.")

    with GrowingReport(write) as report:
        report.update()
        settled(asked, 1)
    assert asked


@pytest.mark.slow
def test_an_interrupted_campaign_has_a_report_of_the_scenes_that_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The second scene never ends: report and tables of the first are there, and say what is missing."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "fakes"))
    from validate.cli.narrator import PlainNarrator
    from validate.execution.campaign import run_campaign
    from validate.plan.runs import CampaignSettings

    class Impatient(PlainNarrator):
        def runs(self, folders):
            report = tmp_path / "report.html"
            if report.exists() and "bouncing_mass" in report.read_text(encoding="utf-8"):
                raise KeyboardInterrupt

    settings = CampaignSettings(
        out=tmp_path,
        scenes=("bouncing_mass", "three_cart"),
        expression="free_motion or =gd_converged",
        jobs=1,
    )
    with pytest.raises(KeyboardInterrupt):
        run_campaign(settings, Impatient())
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "1 run of the campaign has no stored record yet" in " ".join(text.split())
    assert (tmp_path / "results.csv").read_text().count("bouncing_mass,free_motion,") == 1
    assert "three_cart" not in (tmp_path / "results.csv").read_text()

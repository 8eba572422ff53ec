"""The report of a running campaign is rewritten as scenes end, in a bounded share of the time."""

from __future__ import annotations

import threading
import time
from contextlib import closing
from pathlib import Path

import pytest

from models.errors import MachineError
from validate.campaign import growing_report
from validate.campaign.growing_report import GrowingReport


def settled_future(report: GrowingReport) -> None:
    assert report._writing is not None
    report._writing.result(20.0)


def settled(written: list[object], count: int) -> None:
    ends = time.monotonic() + 20.0
    while len(written) < count and time.monotonic() < ends:
        time.sleep(0.005)


def ignored(path: Path) -> None:
    """Take the path of a report."""


def test_growing_report_waits_twenty_times_the_duration():
    written: list[object] = []
    go = threading.Event()

    def write() -> Path:
        go.wait(20.0)
        time.sleep(0.1)
        written.append(None)
        return Path("report.html")

    with closing(GrowingReport(write, ignored)) as report:
        for _ in range(3):
            report.update()
        assert not written, "update does not block"
        go.set()
        settled(written, 1)
        settled_future(report)
        report.update()
        report.update()
    assert len(written) == 1, "the next rewrite is due after 2 s"


def test_growing_report_rewrites_when_it_is_due(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(growing_report, "_SHARE", 1e9)
    written: list[object] = []
    told: list[Path] = []

    def write() -> Path:
        written.append(None)
        return Path("report.html")

    with closing(GrowingReport(write, told.append)) as report:
        for count in (1, 2):
            report.update()
            settled(written, count)
            settled_future(report)
            time.sleep(0.001)
    assert len(written) == 2
    assert told == [Path("report.html")], "the path is reported once"


@pytest.mark.parametrize("error", [MachineError("the disk is full."), ValueError("a bug")])
def test_growing_report_leaves_errors_to_the_last_write(error: Exception):
    asked: list[object] = []

    def write() -> Path:
        asked.append(None)
        raise error

    with closing(GrowingReport(write, ignored)) as report:
        report.update()
        settled(asked, 1)
        settled_future(report)
        report.update()
    assert asked


@pytest.mark.slow
def test_an_interrupted_campaign_has_a_report_of_the_scenes_that_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Ctrl-C in the second scene leaves the report and tables of the first, with the missing run listed."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "fakes"))
    from validate.campaign.campaign import run_campaign
    from validate.campaign.runs import CampaignSettings
    from validate.cli.narrator import PlainNarrator

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

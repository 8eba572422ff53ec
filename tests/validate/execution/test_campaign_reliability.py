"""Campaigns that are killed, that share a folder, or whose cells come in another order: the same numbers, nothing lost, nothing left behind.

`python -m benchmarks kills` kills more often, others than the campaign, and more kinds of cells.
"""

import signal
import time
from pathlib import Path

import pytest
from killed_campaigns import Kill, finished, kill_and_resume, processes, start, unfinished, untimed

pytestmark = pytest.mark.process

# Most of them share their beginning; two of them crash, and are run again whenever the campaign is.
CELLS = "soft or only_good"
_KILLS = [Kill(), Kill(victim="supervisor")]


@pytest.fixture(scope="module")
def cache(cli_environment) -> Path:
    return Path(cli_environment["TOUCHSTONE_CACHE"])


@pytest.fixture(scope="module")
def temporary(tmp_path_factory):
    """The folder for temporary files of every campaign here."""
    folder = tmp_path_factory.mktemp("temporary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(folder))
        yield folder


@pytest.fixture(scope="module")
def killed(cache, temporary, tmp_path_factory):
    """The folder of a campaign that nothing happened to, and what was seen of one that was killed."""
    folder = tmp_path_factory.mktemp("reliable")
    return folder / "whole", kill_and_resume(folder, cache, _KILLS, 1, "-j", "2", cells=CELLS)


@pytest.mark.slow
def test_a_killed_campaign_loses_nothing_and_leaves_nothing(killed, temporary):
    _, seen = killed
    assert seen.faults == []
    assert seen.kills == _KILLS
    assert list(temporary.iterdir()) == []


@pytest.mark.slow
def test_two_campaigns_in_the_folder_of_a_killed_one_do_not_disturb_each_other(cache, killed, temporary, tmp_path):
    """They start while what the killed one was running has perhaps not ended yet."""
    out, (whole, _) = tmp_path / "out", killed
    first = start(out, cache, f"{CELLS} or only_family", "-j", "2")
    for _ in range(1200):
        if finished(out):
            break
        time.sleep(0.1)
    kept = finished(out)
    first.send_signal(signal.SIGKILL)
    first.wait()
    both = [start(out, cache, CELLS, "-j", "1") for _ in range(2)]
    assert [process.wait() for process in both] == [1, 1]
    assert kept
    assert untimed(out) == untimed(whole)
    assert set(finished(out)) == set(finished(whole))
    assert unfinished(out) == []
    assert processes(out) == []
    assert list(temporary.iterdir()) == []

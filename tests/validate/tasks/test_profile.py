"""Where the wall time of a cell goes: nothing is left out, and nothing is counted twice."""

import json
import subprocess
import sys
import time

import pytest

from validate.tasks.profile import START, Profile


def test_laps_leave_nothing_out():
    began = time.monotonic()
    profile = Profile(began)
    time.sleep(0.02)
    assert profile.lap("first") >= 0.02
    time.sleep(0.01)
    profile.lap("second")
    time.sleep(0.01)
    profile.lap("first")
    assert list(profile.seconds) == ["first", "second"]
    assert profile.seconds["first"] >= 0.03
    assert profile.total == pytest.approx(time.monotonic() - began, abs=5e-3)


def test_a_split_lap_keeps_its_length():
    profile = Profile(time.monotonic() - 1.0)
    profile.split({"build": 0.25, "evaluate": 0.5, "translate": 0.0}, rest="solve_rest")
    assert profile.seconds == pytest.approx({"build": 0.25, "evaluate": 0.5, "solve_rest": 0.25}, abs=5e-3)
    assert profile.total == pytest.approx(1.0, abs=5e-3)


def test_parts_that_claim_more_than_passed_are_scaled_to_it():
    """CPU clocks of several threads, or clocks that began before the lap, can say more than the wall."""
    profile = Profile(time.monotonic() - 1.0)
    profile.split({"build": 3.0, "evaluate": 1.0}, rest="solve_rest")
    assert profile.seconds == pytest.approx({"build": 0.75, "evaluate": 0.25, "solve_rest": 0.0}, abs=5e-3)
    assert profile.total == pytest.approx(1.0, abs=5e-3)


def test_the_start_of_the_process_counts():
    """To the tick of the system, not to the second in which it tells when it was booted."""
    told = "from validate.tasks.profile import Profile; print(Profile.since_process_start().total)"
    began = time.monotonic()
    started = float(subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True).stdout)
    assert 0.01 < started < time.monotonic() - began + 0.02


@pytest.mark.slow
def test_a_cells_profile_is_its_wall_time(cli, tmp_path):
    done = cli("all", "--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart", "--out", str(tmp_path), "-k", "only_good or only_slow")
    assert done.returncode in (0, 1), done.stderr
    records = [json.loads(path.read_text()) for path in tmp_path.glob("runs/*/record.json")]
    assert len(records) == 2
    for record in records:
        assert sum(record["profile"].values()) == pytest.approx(record["wall_seconds"])
        assert {START, "imports", "scene", "compile", "opening", "solve_rest", "replay", "writing", "record"} <= set(record["profile"])
    slow = next(record for record in records if "slow" in record["pipeline"])
    assert slow["profile"]["solve_rest"] >= 0.6, "the fake sleeps that long, and claims nothing of it"

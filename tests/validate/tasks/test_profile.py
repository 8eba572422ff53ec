"""Where the wall time of a cell goes: nothing is left out, and nothing is counted twice."""

import json
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from validate.tasks.profile import START, Profile, waits


@pytest.fixture
def passes(monkeypatch):
    """passes(0.25): so much time on a clock that otherwise stands still at 100 s."""
    now = [100.0]
    monkeypatch.setattr("validate.tasks.profile.time", SimpleNamespace(monotonic=lambda: now[0]))
    return lambda seconds: now.append(now.pop() + seconds)


def test_laps_leave_nothing_out(passes):
    profile = Profile(99.5)
    passes(0.25)
    profile.lap("first")
    passes(0.5)
    profile.lap("second")
    passes(0.125)
    profile.lap("first")
    assert profile.seconds == {"first": 0.875, "second": 0.5}
    assert list(profile.seconds) == ["first", "second"]
    assert profile.total == 1.375


@pytest.mark.parametrize(("parts", "expected"), [
    ({"build": 0.25, "evaluate": 0.5, "translate": 0.0},
     {"build": 0.25, "evaluate": 0.5, "rest": 0.25}),
    ({"build": 3.0, "evaluate": 1.0}, {"build": 0.75, "evaluate": 0.25, "rest": 0.0}),
])  # fmt: skip
def test_a_split_lap_keeps_its_length(passes, parts, expected):
    """CPU clocks of several threads, or clocks that began before the lap, can say more than the wall: parts are scaled to it."""
    profile = Profile(99.0)
    profile.split(parts, rest="rest")
    assert profile.seconds == expected
    profile.split({}, rest="nothing")
    assert profile.seconds == {**expected, "nothing": 0.0}


def test_the_start_of_the_process_counts():
    """To the tick of the system, not to the second in which it tells when it was booted."""
    told = "from validate.tasks.profile import Profile; print(Profile.since_process_start().total)"
    began = time.monotonic()
    started = float(
        subprocess.run(
            [sys.executable, "-c", told], capture_output=True, text=True, check=True
        ).stdout
    )
    assert 0.01 < started < time.monotonic() - began + 0.02


@pytest.mark.slow
def test_a_cells_profile_is_its_wall_time(cli, tmp_path):
    done = cli(
        "all",
        "--plugin",
        "campaign_fakes:PLUGIN",
        "--scene",
        "three_cart",
        "--out",
        str(tmp_path),
        "-k",
        "only_good or only_slow",
    )
    assert done.returncode in (0, 1), done.stderr
    records = [json.loads(path.read_text()) for path in tmp_path.glob("runs/*/record.json")]
    assert len(records) == 2
    for record in records:
        assert sum(record["profile"].values()) == pytest.approx(record["wall_seconds"])
        assert {
            START,
            "imports",
            "scene",
            "compile",
            "opening",
            "solve_rest",
            "replay",
            "writing",
            "record",
        } <= set(record["profile"])
    slow = next(record for record in records if "slow" in record["pipeline"])
    assert slow["profile"]["solve_rest"] >= 0.6, (
        "the fake sleeps that long, and claims nothing of it"
    )


@pytest.mark.parametrize(
    ("wall", "cpu", "sentence"),
    [
        (90.0, 45.0, ""),
        (90.0, 130.0, ""),
        (90.0, 7.25, " The machine was busy: it gave 7.25 CPU s in 90 s."),
    ],
)
def test_waits_busy_machine_gives_cpu_share(wall: float, cpu: float, sentence: str):
    assert waits(wall, cpu) == sentence

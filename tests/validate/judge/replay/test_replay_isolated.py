"""Somebody's FMU that misbehaves, replayed in its child: every ending right, good runs beside it unchanged, nothing left."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from foreign_fmu import (
    COSIMULATION,
    EXCHANGE,
    FULL_MAP,
    build_foreign,
    foreign_plan,
    left,
    write_plan,
)

from validate.judge.judgement import wire_fmu
from validate.judge.replay import Replay, ReplayOutcome
from validate.judge.replay.run import replay_foreign
from validate.processes.isolated import Limits

pytestmark = [pytest.mark.slow, pytest.mark.process]

ROOT = Path(__file__).parents[4]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("foreign")
    write_plan(folder / "plan.csv")
    (folder / "map.toml").write_text(FULL_MAP, encoding="utf-8")
    return folder


@pytest.fixture(autouse=True)
def place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    place = tmp_path / "place"
    place.mkdir()
    monkeypatch.setenv("TEST_MARK", str(place))
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


def run(folder: Path, fmu: Path, limits: Limits | None = None) -> Replay:
    wired = wire_fmu(
        fmu,
        folder / "plan.csv",
        map_path=folder / "map.toml",
        limits=limits or Limits(seconds=60.0, memory=2 * 1024**3),
    )
    return replay_foreign(wired.foreign, wired.package, wired.plan, limits=wired.limits)


@pytest.fixture(scope="module")
def good(folder: Path) -> Replay:
    return run(folder, build_foreign(folder / "good.fmu"))


def test_a_good_one_follows_the_closed_form(good: Replay):
    assert good.ok, good.message
    plan = foreign_plan()
    assert good.q[good.knots, 0] == pytest.approx(plan[:, 1], abs=1e-8)
    assert good.v[good.knots, 0] == pytest.approx(plan[:, 2], abs=1e-7)
    assert good.lam[good.knots, 0] == pytest.approx(plan[:, 4], abs=1e-4)
    assert good.error.everyday.position < 1e-5
    assert [event.closes for event in good.events] == [True, False]


@pytest.mark.parametrize(
    ("mode", "kinds", "outcome", "words"),
    [
        ("hang", EXCHANGE, ReplayOutcome.TIME_LIMIT, "time limit of 2 s"),
        ("segfault", COSIMULATION, ReplayOutcome.CRASHED, "SIGSEGV"),
        ("exit", EXCHANGE, ReplayOutcome.NO_RESULT, "exit code 0"),
        ("abort", EXCHANGE, ReplayOutcome.ABORTED, "SIGABRT"),
        ("nan", COSIMULATION, ReplayOutcome.NOT_A_NUMBER, "not a finite number"),
        ("memory", EXCHANGE, ReplayOutcome.MEMORY_LIMIT, "memory limit of 1 GiB"),
        ("fatal", COSIMULATION, ReplayOutcome.FATAL, "status 4 (fatal)"),
        ("kills_parent", EXCHANGE, ReplayOutcome.CRASHED, "SIGKILL"),
        ("kills_group", COSIMULATION, ReplayOutcome.CRASHED, "SIGKILL"),
        ("overflow", EXCHANGE, ReplayOutcome.CRASHED, "SIGSEGV"),
        ("trap", COSIMULATION, ReplayOutcome.CRASHED, "SIGFPE"),
        ("stops", COSIMULATION, ReplayOutcome.TIME_LIMIT, "time limit of 2 s"),
        ("alarm", EXCHANGE, ReplayOutcome.CRASHED, "SIGALRM"),
        ("fills", COSIMULATION, ReplayOutcome.ABORTED, "SIGABRT"),
        ("leaves_at_once", EXCHANGE, ReplayOutcome.NO_RESULT, "exit code 0"),
        ("killed", EXCHANGE, ReplayOutcome.CRASHED, "SIGKILL"),
        ("descriptors", COSIMULATION, ReplayOutcome.NO_RESULT, "exit code 1"),
    ],
)  # fmt: skip
def test_each_misbehaviour_has_its_own_outcome(folder, place, good, mode, kinds, outcome, words):
    limits = Limits(seconds=2.0 if mode in ("hang", "stops") else 60.0, memory=1024**3)
    result = run(folder, build_foreign(folder / f"{mode}.fmu", mode, kinds), limits)
    assert (result.outcome, result.ok) == (outcome, False)
    assert words in result.message
    assert left(place) == []


def test_garbage_on_its_output_and_a_forked_child_spoil_nothing(
    folder: Path, place: Path, good: Replay
):
    garbage = run(folder, build_foreign(folder / "garbage.fmu", "garbage"))
    assert garbage.q.tobytes() == good.q.tobytes()
    forking = run(folder, build_foreign(folder / "fork.fmu", "fork"))
    assert forking.q.tobytes() == good.q.tobytes()
    assert "behind, which we ended" in forking.message
    again = run(folder, folder / "good.fmu")
    assert (again.q.tobytes(), again.error) == (good.q.tobytes(), good.error)
    assert left(place) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("chdir", "the working folder is /,"), ("closes", "file descriptor 0 is closed"),
        ("signals", "the handler of SIGHUP"),
        ("environment", "is gone"), ("rounding", "rounding of numbers is upward"),
        ("mask", "the mask of new files is 777"),
        ("file", "'left.txt' is new or changed"), ("daemon", "behind, which we ended"),
        ("shell", "behind, which we ended"),
        ("garbage", "The FMU prints: '{"),
    ],
)  # fmt: skip
def test_what_it_does_to_its_process_is_said(folder: Path, place: Path, mode: str, words: str):
    result = run(folder, build_foreign(folder / f"{mode}.fmu", mode, COSIMULATION))
    assert (result.ok, words in result.message) == (True, True), result.message
    assert left(place) == []


def test_nothing_is_left_when_the_command_is_killed(folder: Path, place: Path):
    """kill -9 of `python -m validate replay` while the FMU hangs, with a process of its own left behind."""
    hanging = build_foreign(folder / "hang.fmu", "hang")
    command = [
        sys.executable, "-m", "validate", "replay", str(folder / "plan.csv"), "--fmu", str(hanging),
        "--map", str(folder / "map.toml"),
    ]  # fmt: skip
    process = subprocess.Popen(
        command, cwd=ROOT, env={**os.environ, "TMPDIR": str(place)}, stdout=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 300
    while not any(name.isdigit() for name in left(place)):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    while left(place) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert left(place) == []

"""FMUs that go wrong in twenty-eight ways, under `check`: each is named, the checks go on, and no process and no file is left."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from foreign_fmu import COSIMULATION, EXCHANGE, MODES, build_foreign, left

from validate.fmu_check import Status, check_fmu

pytestmark = pytest.mark.process

_RUN = "values stay finite"
_HOST = "leaves its host as it was"
_FIRST = "starts and ends"
# Mode -> the check that fails, and words of its sentence; a bad end comes in the first check of
# Co-Simulation already.
_ENDS = {
    "hang": "it hung", "segfault": "SIGSEGV", "exit": "exit code 0", "abort": "SIGABRT",
    "memory": "", "fatal": "status 4 (fatal)", "kills_parent": "SIGKILL",
    "kills_group": "SIGKILL", "overflow": "SIGSEGV", "trap": "SIGFPE", "stops": "it hung",
    "alarm": "SIGALRM", "fills": "", "leaves_at_once": "exit code 0",
    "killed": "SIGKILL", "descriptors": "exit code 1",
}  # fmt: skip
_CHANGES = {
    "garbage": "prints on the standard output", "fork": "behind",
    "chdir": "the working folder is /,", "closes": "file descriptor 0 is closed",
    "signals": "the handler of SIGHUP",
    "environment": "is gone", "rounding": "upward", "daemon": "behind",
    "file": "'left.txt' is new or changed", "thread": "1 thread", "mask": "777", "shell": "behind",
}  # fmt: skip
_FAILS = (
    {mode: (_FIRST, words) for mode, words in _ENDS.items()}
    | {mode: (_HOST, words) for mode, words in _CHANGES.items()}
    | {"nan": (_RUN, "body.vel is nan")}
)


def test_every_mode_is_here():
    assert set(_FAILS) == set(MODES) - {"good"}


@pytest.mark.slow
@pytest.mark.parametrize("mode", _FAILS)
def test_it_is_named_and_nothing_is_left(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    place = tmp_path / "place"
    place.mkdir()
    monkeypatch.setenv("TEST_MARK", str(place))
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    kinds = EXCHANGE if mode in ("signals", "thread", "daemon") else COSIMULATION
    name, words = _FAILS[mode]
    report = check_fmu(
        build_foreign(tmp_path / "it.fmu", mode, kinds), names=[_FIRST, _HOST, _RUN], seconds=3.0
    )
    rows = {row.name: row for row in report.rows}
    assert rows[name].status is Status.FAILED, report.rows
    assert words in rows[name].sentence
    assert set(rows) == {_FIRST, _HOST, _RUN}
    assert left(place) == []

"""Runs the trials, one child each, and says of each what was found and what to do."""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from models.errors import MachineError
from validate.execution.isolated import Isolated, Limits, run_isolated
from validate.store.disk import write_durably

# A folder with less room than this [bytes] does not hold a campaign with its FMUs and trajectories.
_ROOM = 500 * 1024**2
_SECONDS = 300.0


class State(Enum):
    """OK; ABSENT: an extra that is not installed, and nothing else is wrong; BROKEN: something the main job needs does not work."""

    OK = "works"
    ABSENT = "not installed"
    BROKEN = "does not work"


@dataclass(frozen=True, kw_only=True)
class MachineFinding:
    """sentence: what was found; remedy: what to do about it ("" if nothing); seconds of the clock."""

    name: str
    state: State
    sentence: str
    remedy: str = ""
    seconds: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A small piece of the real thing, run in a child.

    needed: the main job does not work without it; absent: what an empty answer means; remedy: how to mend it; rests_on: trials that it cannot pass if
    they fail.
    """

    name: str
    function: str
    remedy: str
    needed: bool = True
    absent: str = ""
    rests_on: tuple[str, ...] = ()


TRIALS = (
    Trial(name="C compiler", function="compiler", remedy="pip install ziglang, or set CC to a compiler you have"),
    Trial(name="cache", function="cache", remedy="set TOUCHSTONE_CACHE to a folder you can write"),
    Trial(name="Ipopt", function="ipopt", remedy="pip install --force-reinstall cyipopt-wheels==1.7.0.dev0"),
    Trial(name="PyTorch", function="gradient", remedy="pip install --force-reinstall 'torch>=2.4'", rests_on=("C compiler", "cache")),
    Trial(
        name="FMU",
        function="fmu",
        remedy="pip install --force-reinstall fmpy scikit-sundae; a temporary folder that allows execution (TMPDIR)",
        rests_on=("C compiler", "cache"),
    ),
    Trial(
        name="proofs (extra [global])",
        function="integer_programs",
        remedy="pip install pyscipopt",
        needed=False,
        absent="method global will say that it cannot run",
    ),
)


def examine_machine(out: Path, trials: tuple[Trial, ...] = TRIALS) -> Iterator[MachineFinding]:
    """One finding after the other, as they are made. out: the folder a campaign would write to."""
    yield _interpreter()
    yield _store(out)
    broken = set()
    for trial in trials:
        finding = _tried(trial)
        if finding.state is State.BROKEN:
            first = [name for name in trial.rests_on if name in broken]
            if first:
                finding = replace(finding, remedy=f"mend {' and '.join(first)} first")
            broken.add(trial.name)
        yield finding


def _interpreter() -> MachineFinding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    sentence = f"Python {platform.python_version()} on {cores} {'core' if cores == 1 else 'cores'}"
    return MachineFinding(name="Python", state=State.OK, sentence=sentence)


def _store(out: Path) -> MachineFinding:
    """Write durably and read back where the campaign would, and leave nothing."""
    began = time.monotonic()
    place = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
    try:
        if not place.is_dir():
            raise NotADirectoryError(20, "there is a file of that name")
        with tempfile.TemporaryDirectory(prefix=".touchstone-doctor-", dir=place) as folder:
            write_durably(Path(folder) / "whole", "touchstone")
            if (Path(folder) / "whole").read_text() != "touchstone":
                raise OSError(5, "what was written reads back differently")
        room = shutil.disk_usage(place).free
    except (OSError, MachineError) as error:
        cause = error.__cause__ or error
        sentence, remedy = (
            f"{place} cannot be written to ({getattr(cause, 'strerror', cause)})",
            "choose another folder with --out, or free this one",
        )
        return MachineFinding(name="store", state=State.BROKEN, sentence=sentence, remedy=remedy)
    enough = room >= _ROOM
    return MachineFinding(
        name="store",
        state=State.OK if enough else State.BROKEN,
        sentence=f"{place} can be written to and has {room / 1024**3:.1f} GiB free",
        remedy="" if enough else f"make room: a campaign of all scenes wants about {_ROOM // 1024**2} MiB",
        seconds=time.monotonic() - began,
    )


def _tried(trial: Trial) -> MachineFinding:
    limits = Limits(seconds=_SECONDS, memory=16 * 1024**3)
    done = run_isolated(f"validate.doctor.trials:{trial.function}", {}, limits=limits, what=trial.name)
    if done.ok and done.value:
        return MachineFinding(name=trial.name, state=State.OK, sentence=str(done.value), seconds=done.wall)
    state = State.BROKEN if trial.needed and not done.ok else State.ABSENT
    sentence = trial.absent if done.ok else _why(done)
    return MachineFinding(name=trial.name, state=state, sentence=sentence, remedy=trial.remedy, seconds=done.wall)


def _why(done: Isolated) -> str:
    last = done.output.strip().splitlines()[-1:] or [""]
    return " ".join([done.sentence.rstrip("."), *(f"(last line of its output: {line.strip()[:200]})" for line in last if line.strip())])

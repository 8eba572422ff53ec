"""Campaigns whose process is killed, or interrupted, at random moments, and what must be true of their folder at any moment, and in the end."""

import contextlib
import csv
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import Any

import psutil

from models.results.stored import from_json

FAKES_FOLDER = Path(__file__).parent
# Cells that end well, badly, slowly, in a crash that is run anew by every resumption, and with
# processes left over; most of them share stages.
CELLS = "good or soft_alone or slow or infeasible or raises or litter or chain"
# What is written over whenever the same cell is run again.
_RUN_AGAIN = frozenset({"crashed"})
_PATIENCE = 300.0
_LOOK = 0.01
# In the environment of a campaign, and of all that it starts.
_MARK = "KILLED_CAMPAIGN"


@dataclass(frozen=True, kw_only=True)
class Kill:
    """Who is ended, and how. engine: by which the campaign runs.

    victim: `campaign`, or of a cell at work its `child`, the `supervisor` of that, what

    that was forked from (`preloaded`), the Dask `worker` that began it, or `scheduler`, that of a
    cluster that stands; number: the signal.
    """

    engine: str = "local"
    victim: str = "campaign"
    number: signal.Signals = signal.SIGKILL


class Fault(Enum):
    """What a kill may do to a campaign."""

    LOST = "lost"
    CORRUPT = "corrupt"
    UNEQUAL = "unequal tables"
    LEFT = "left behind"
    WORDS = "wrong words"


@dataclass
class Kills:
    """What was seen. kills: that hit a campaign at work.

    moments: of each, how many cells were stored and how many seconds that was ago at least;

    kept: finished cells that were found again, unchanged, after a kill; faults: after how many
        kills, which, and what exactly.
    """

    kills: list[Kill] = field(default_factory=list)
    campaigns: int = 0
    kept: int = 0
    moments: list[tuple[int, float]] = field(default_factory=list)
    faults: list[tuple[int, Fault, str]] = field(default_factory=list)

    def blame(self, fault: Fault, what: str) -> None:
        """Something went wrong, after the last kill."""
        self.faults.append((len(self.kills), fault, what))


def environment(cache: Path) -> dict[str, str]:
    return {
        **os.environ,
        "PYTHONPATH": str(FAKES_FOLDER),
        "TOUCHSTONE_CACHE": str(cache),
        "NO_COLOR": "1",
    }


def family(out: Path) -> list[str]:
    """Living processes that a campaign of `start` brought about in whatever way, workers of its own cluster too, and its cells' processes."""
    return _named(numbers_of(f"{_MARK}={out}\0".encode())) + processes(out)


def start(out: Path, cache: Path, cells: str, *more: str) -> subprocess.Popen[bytes]:
    if (
        signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    ):  # in the background of a shell, which what it starts would inherit
        signal.signal(signal.SIGINT, signal.default_int_handler)
    chosen = ("--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart", "-k", cells)
    command = [sys.executable, "-m", "validate", "all", *chosen, "--out", str(out), *more]
    with open(out.with_suffix(".log"), "ab") as log:
        return subprocess.Popen(
            command,
            stdout=log,
            stderr=log,
            stdin=subprocess.DEVNULL,
            env={**environment(cache), _MARK: str(out)},
            start_new_session=True,
        )


def untimed(out: Path) -> list[dict[str, str]]:
    """results.csv without its columns of times."""
    rows = csv.DictReader((out / "results.csv").read_text(encoding="utf-8").splitlines())
    return [{name: value for name, value in row.items() if not name.endswith("_s")} for row in rows]


def finished(out: Path) -> dict[str, bytes]:
    """Stored records by key, without the surveys that are added at the end of a campaign."""
    return {
        path.parent.name: _as_it_ended(path.read_bytes())
        for path in (out / "runs").glob("[!.]*/record.json")
    }


def _as_it_ended(content: bytes) -> bytes:
    """Return a record without surveys and times; a damaged one unchanged."""
    try:
        record = json.loads(content)
        for stage in record.get("stages", ()):
            stage["survey"] = None
    except ValueError:
        return content
    if "stages" in record:
        record |= {"wall_seconds": 0.0, "cpu_seconds": 0.0, "profile": {}}
    return json.dumps(record).encode()


def records(out: Path) -> dict[str, Any]:
    """The records of its runs, by pipeline."""
    from models.results.run import RunRecord

    paths = (out / "runs").glob("[!.]*/record.json")
    found = [from_json(RunRecord, path.read_bytes()) for path in paths]
    return {record.pipeline: record for record in found}


def _stored(out: Path) -> int:
    return len(list((out / "runs").glob("[!.]*/record.json")))


def unfinished(out: Path) -> list[str]:
    """Files and folders that a campaign writes before they have their names."""
    return [str(path.relative_to(out)) for path in out.rglob(".*")]


def processes(out: Path) -> list[str]:
    """Living processes that belong to cells of this folder, or were started by them: they have their temporary files there, or are there."""
    return _named(numbers_of(f"TMPDIR={out}".encode(), out))


def numbers_of(word: bytes, folder: Path | None = None) -> list[int]:
    """The living processes whose environment shows this word, if there is one, or which are somewhere in this folder."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            is_there = folder is not None and Path(os.readlink(entry / "cwd")).is_relative_to(
                folder
            )
            if is_there or (word and word in (entry / "environ").read_bytes()):
                found.append(int(entry.name))
    return sorted(found)


def _named(numbers: Iterable[int]) -> list[str]:
    """Their command lines."""
    found = []
    for number in numbers:
        with contextlib.suppress(OSError):
            found.append(Path(f"/proc/{number}/cmdline").read_bytes().decode(errors="replace"))
    return found


def kill_and_resume(
    folder: Path,
    cache: Path,
    kills: Sequence[Kill],
    seed: int,
    *more: str,
    cells: str = CELLS,
    where: Callable[[str], str] = str,
    scheduler: Callable[[], int] = int,
) -> Kills:
    """Run campaigns in `folder`, until each of the kills has hit one at work.

    One that was hit is resumed in the same folder, by the engine of the next

    kill, until it comes to its end undisturbed, and is then compared with one that nobody killed.

    where: what `--engine` is given for the name of an engine; scheduler: the number of the process
        of the cluster that stands.

    When a kill comes is drawn as: how many cells are stored first, 0 to all that are missing, then
    how long after that, up to the longest pause between two of them in the whole campaign - or,
    before the first, up to when that was stored. So kills fall everywhere on a busy machine too.
    """
    draw, seen, waiting = random.Random(seed), Kills(), list(kills)
    first, pause = _paces(folder / "whole", start(folder / "whole", cache, cells, *more))
    expected, whole = untimed(folder / "whole"), set(finished(folder / "whole"))
    while waiting:
        seen.campaigns += 1
        out, hit = folder / f"killed{seen.campaigns}", True
        while hit:
            kill, before, told = (waiting or kills)[0], finished(out), _log(out)
            wanted = draw.randint(0, len(whole - set(before)))
            moment = draw.uniform(0.0, pause if wanted else first)
            process = start(out, cache, cells, *more, "--engine", where(kill.engine))
            hit = (
                bool(waiting)
                and _reaches(process, out, len(before) + wanted, moment)
                and _hits(kill, process, out, scheduler)
            )
            code = process.wait()
            if hit:
                seen.kills.append(waiting.pop(0))
                seen.moments.append((len(before) + wanted, moment))
            elif waiting:  # it was faster than the whole one: the machine was busy then
                first, pause = 0.7 * first, 0.7 * pause
            if hit and kill.number == signal.SIGINT:
                _look_at_words(out, code, _log(out).removeprefix(told), before, seen)
            _look(out, before, seen)
        if untimed(out) != expected:
            seen.blame(
                Fault.UNEQUAL,
                f"{out.name}: results.csv is not that of a campaign that nobody killed",
            )
        if left := unfinished(out):
            seen.blame(Fault.LEFT, f"{out.name}: {left}")
        if set(finished(out)) != whole:
            seen.blame(Fault.LOST, f"{out.name}: other cells are stored")
    return seen


def _hits(
    kill: Kill, campaign: subprocess.Popen[bytes], out: Path, scheduler: Callable[[], int]
) -> bool:
    """Whether the victim was there."""
    if kill.number != signal.SIGKILL:
        os.killpg(campaign.pid, kill.number)  # all in the foreground hear it
        return True
    while campaign.poll() is None:
        with contextlib.suppress(psutil.NoSuchProcess, ProcessLookupError):
            number = {"campaign": campaign.pid, "scheduler": scheduler()}.get(
                kill.victim
            ) or _above_a_cell(out).get(kill.victim)
            if number is not None:
                os.kill(number, kill.number)
                return True
        time.sleep(_LOOK)
    return False


def _above_a_cell(out: Path) -> dict[str, int]:
    """Numbers of the processes to which a cell at work in this folder is owed, by their names in Kill."""
    for number in numbers_of(b"", out):
        above = [psutil.Process(number), *psutil.Process(number).parents()]
        supervisors = [
            process.pid
            for process in above[1:]
            if "validate.processes.supervisor" in process.cmdline()
        ]
        if supervisors:
            names = ("child", "supervisor", "preloaded")
            return {
                **dict(zip(names, (number, *supervisors), strict=False)),
                "worker": above[len(supervisors) + 1].pid,
            }
    return {}


def _paces(out: Path, process: subprocess.Popen[bytes]) -> tuple[float, float]:
    """Of a campaign that runs to its end: seconds until its first cell is stored, and the longest pause between two, or after the last."""
    times, stored = [time.monotonic()], 0
    while process.poll() is None:
        if (now := _stored(out)) > stored:
            stored = now
            times.append(time.monotonic())
        time.sleep(_LOOK)
    times.append(time.monotonic())
    pauses = [later - earlier for earlier, later in pairwise(times)]
    return pauses[0], max(pauses[1:], default=0.0)


def _reaches(process: subprocess.Popen[bytes], out: Path, stored: int, moment: float) -> bool:
    """Whether a campaign still runs this long [s] after so many of its cells are stored."""
    while _stored(out) < stored:
        if process.poll() is not None:
            return False
        time.sleep(_LOOK)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(moment)
    return process.poll() is None


def _log(out: Path) -> str:
    path = out.with_suffix(".log")
    return path.read_text(encoding="utf-8") if path.exists() else ""


_SAID = re.compile(
    r"^interrupted: (\d+) of \d+ runs are stored in \S+; resume with: \S+ -m validate all ",
    re.MULTILINE,
)


def _look_at_words(out: Path, code: int, told: str, before: dict[str, bytes], seen: Kills) -> None:
    """Of a campaign that was interrupted: how it ended, what it said and wrote."""
    begun, said = " to run\n" in told, _SAID.search(told)
    # A shell says 130 of a death by the signal too; so ends Python where it came while text was
    # compiled, whatever is done about it.
    code = 130 if code == -signal.SIGINT else code
    if (
        code not in (130, *(() if "report:" not in told else (0, 1)))
        or "Traceback" in told
        or (begun and code == 130 and said is None)
    ):
        seen.blame(Fault.WORDS, f"exit code {code}, {told[-2000:]!r}")
    if left := unfinished(out):
        seen.blame(Fault.LEFT, str(left))
    if said is not None:
        again = {key for key, content in before.items() if _outcomes(content) & _RUN_AGAIN}
        now = finished(out)
        stored = len([key for key in now if key not in again or now[key] != before[key]])
        rows = {row["pipeline"] for row in untimed(out)}
        if not int(said[1]) == stored == len(rows):
            seen.blame(
                Fault.WORDS, f"{said[0]!r}, but {stored} are stored and {len(rows)} in results.csv"
            )


def _outcomes(content: bytes) -> set[str]:
    from models.results.stored import record_of

    record = record_of(content)
    return {
        record.outcome,
        *(stage.outcome for stage in getattr(record, "stages", ())),
    }  # it may have crashed behind stages that are whole


def _look(out: Path, before: dict[str, bytes], seen: Kills) -> None:
    from models.results.stored import record_of

    see_gone(lambda: family(out), seen, "processes")
    if "TMPDIR" in os.environ:
        see_gone(lambda: os.listdir(os.environ["TMPDIR"]), seen, "temporary files")
    now = finished(out)
    for key, content in now.items():
        try:
            record = record_of(content)
        except ValueError as error:
            seen.blame(Fault.CORRUPT, f"the record of {key}: {error}")
            continue
        if record.key != key:
            seen.blame(Fault.CORRUPT, f"{key} holds the record of another cell")
    for key, content in before.items():
        if _outcomes(content) & _RUN_AGAIN:
            continue
        if now.get(key) == content:
            seen.kept += 1
        else:
            seen.blame(
                Fault.LOST, f"the finished cell {key} is {'another' if key in now else 'gone'}"
            )


def see_gone(left: Callable[[], Iterable[str]], seen: Kills, what: str) -> None:
    """Wait until nothing is left; what is left for good is a fault."""
    until = time.monotonic() + _PATIENCE
    while (found := list(left())) and time.monotonic() < until:
        time.sleep(0.05)
    if found:
        seen.blame(Fault.LEFT, f"{what}: {found}")

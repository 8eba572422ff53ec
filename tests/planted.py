"""Planted defects: one small mistake at a time in a copy of the tree; do the tests find the mistake?

    python -m tests.planted --seed 1 --draws 50 -j 2
    python -m tests.planted --room judge --room fmu --list

A seed draws the same defects from the same code: a line of the room, then a mistake on that line
(tests/defects.py). A defect that cannot be imported or compiled is drawn again. The tests run in
three steps: the quick tests that import the file, the other quick tests of the room, the slow ones.
A test that fails must pass without the defect. The tree itself is never changed.
"""

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from time import monotonic

from tests.defects import Mistake, mistakes_in, replaced

ROOT = Path(__file__).resolve().parents[1]
# Room -> patterns of the files in which mistakes are made, and of the tests that must find them.
ROOMS = {
    "scenes": (
        ("models/*.py", "models/scene/*.py", "models/scenes/*.py"),
        ("tests/models/*.py", "tests/validate/judge/test_exact_plans.py"),
    ),
    "codegen": (
        ("models/codegen/*.py", "models/codegen/*.[ch]"),
        ("tests/models/codegen/*.py", "tests/models/*.py"),
    ),
    "fmu": (
        ("models/fmu/*.py", "models/fmu/coupled/*.py", "models/fmu/mjcf/*.py"),
        ("tests/models/fmu/**/*.py", "tests/validate/fmi/*.py"),
    ),
    "fmu shell": (
        (
            "models/fmu/shell/*.[ch]",
            "models/fmu/coupled/*.[ch]",
            "models/fmu/mjcf/*.[ch]",
        ),
        ("tests/models/fmu/**/*.py", "tests/validate/fmi/*.py", "tests/validate/judge/replay/*.py"),
    ),
    "transcription": (
        ("formulations/transcription/*.py",),
        ("tests/formulations/transcription/*.py", "tests/formulations/test_methods*.py"),
    ),
    "ipopt": (
        ("formulations/ipopt/**/*.py", "formulations/ipopt/ldlt/*.[ch]"),
        ("tests/formulations/ipopt/*.py",),
    ),
    "shooting": (("formulations/shooting/*.py",), ("tests/formulations/shooting/*.py",)),
    "multiple_shooting": (
        ("formulations/multiple_shooting/*.py", "formulations/multiple_shooting/*.c"),
        ("tests/formulations/multiple_shooting/*.py",),
    ),
    "contact_modes": (
        ("formulations/contact_modes/*.py", "formulations/contact_modes/*.c"),
        ("tests/formulations/contact_modes/*.py", "tests/formulations/test_methods_mpcc.py"),
    ),
    "methods": (
        ("formulations/methods/*.py", "formulations/*.py"),
        ("tests/formulations/test_method*.py", "tests/formulations/shooting/*.py"),
    ),
    "mpec": (
        ("formulations/mpec/*.py", "formulations/ampl/*.py"),
        ("tests/formulations/mpec/*.py", "tests/formulations/ampl/*.py"),
    ),
    "certificate": (
        ("formulations/certificate/*.py",),
        ("tests/formulations/mpec/*.py", "tests/formulations/test_methods_mpcc.py"),
    ),
    "judge": (
        (
            "validate/judge/**/*.py",
            "validate/fmi/*.py",
            "validate/fmi/*.c",
            "validate/truth/*.py",
            "validate/tasks/stage.py",
            "validate/tasks/paper.py",
        ),
        (
            "tests/validate/judge/**/*.py",
            "tests/validate/fmi/*.py",
            "tests/validate/tasks/test_stage.py",
            "tests/validate/tasks/test_campaign_violation.py",
        ),
    ),
    "checker": (("validate/fmu_check/*.py",), ("tests/validate/fmu_check/*.py",)),
    "stress": (("validate/stress/**/*.py",), ("tests/validate/stress/*.py",)),
    "record": (
        ("validate/tasks/*record*.py", "validate/campaign/results.py", "models/results/*.py"),
        (
            "tests/validate/store/*.py",
            "tests/validate/tasks/*.py",
            "tests/validate/campaign/test_campaign*.py",
            "tests/validate/test_campaign_end_to_end.py",
            "tests/validate/campaign/test_results_rows.py",
            "tests/reports/test_records.py",
            "tests/reports/test_re*_[!b]*.py",
        ),
    ),
    "store": (
        ("validate/store/*.py", "validate/campaign/*.py"),
        (
            "tests/validate/store/*.py",
            "tests/validate/campaign/*.py",
            "tests/validate/cli/test_c*.py",
            "tests/validate/cli/test_show*.py",
            "tests/validate/tasks/test_profile.py",
        ),
    ),
    "processes": (
        ("validate/processes/*.py", "validate/tasks/[!fprs]*.py", "validate/tasks/path.py"),
        (
            "tests/validate/processes/*.py",
            "tests/validate/campaign/*.py",
            "tests/validate/tasks/*.py",
        ),
    ),
    "commands": (("validate/cli/*.py",), ("tests/validate/cli/*.py",)),
    "report": (("reports/**/*.py",), ("tests/reports/**/test_*.py",)),
}
# Time limit for the tests of one defect [s]; a test that hangs has found the defect.
_LONGEST = 1200.0
_HANGS = "it hangs"


@dataclass(frozen=True)
class Defect:
    """A mistake in a file of a room; source is the whole text of the file with the mistake."""

    room: str
    path: str
    mistake: Mistake
    source: str

    def __str__(self) -> str:
        mistake = self.mistake
        change = f"`{_short(mistake.before)}` -> `{_short(mistake.after)}`"
        return f"{self.path}:{mistake.line} {mistake.kind}: {change}"


def _short(text: str) -> str:
    words = " ".join(text.split())
    return words if len(words) <= 60 else f"{words[:57]}..."


def drawn(rooms: list[str], seed: int) -> Iterator[Defect]:
    """Yield defects from the rooms in turn, each on another line, until no line is left."""
    dice = random.Random(seed)
    texts: dict[Path, str] = {}
    lines: dict[str, list[tuple[Path, int]]] = {}
    for room in rooms:
        lines[room] = []
        for path in sorted({path for pattern in ROOMS[room][0] for path in ROOT.glob(pattern)}):
            texts[path] = path.read_text(encoding="utf-8")
            lines[room] += [(path, line) for line in sorted(mistakes_in(path.name, texts[path]))]
        dice.shuffle(lines[room])
    while any(lines.values()):
        for room in rooms:
            if not lines[room]:
                continue
            path, line = lines[room].pop()
            mistake = dice.choice(mistakes_in(path.name, texts[path])[line])
            name = path.relative_to(ROOT).as_posix()
            yield Defect(room, name, mistake, replaced(texts[path], mistake))


def tests_of(defect: Defect, tree: Path) -> tuple[list[str], list[str]]:
    """Return the test files of the room: those that import the file or its package, and the rest."""
    patterns = ROOMS[defect.room][1]
    paths = sorted({path for pattern in patterns for path in tree.glob(pattern)})
    names = [path.relative_to(tree).as_posix() for path in paths if path.name.startswith("test_")]
    package, _, module = defect.path.rpartition(".")[0].replace("/", ".").rpartition(".")
    imports = re.compile(
        rf"^\s*(from|import) ({re.escape(package)}\.{re.escape(module)}\b"
        rf"|{re.escape(package)} import .*\b{re.escape(module)}\b)",
        re.MULTILINE,
    )
    near = [name for name in names if imports.search((tree / name).read_text(encoding="utf-8"))]
    return near, [name for name in names if name not in near]


@dataclass(frozen=True)
class Result:
    """A planted defect. found_by: the test that failed, ""; in_first: by the first tier."""

    defect: Defect
    found_by: str
    in_first: bool
    seconds: float


def tried(defect: Defect, copy: Path) -> Result | None:
    """Plant a defect in a copy of the tree and run the tests; None if it cannot be built."""
    began, place = monotonic(), copy / defect.path
    sound = place.read_text(encoding="utf-8")
    failed, files, in_first = [], [], False
    place.write_text(defect.source, encoding="utf-8")
    try:
        if not _can_be_imported(defect.path, copy):
            return None
        near, others = tests_of(defect, copy)
        for files, marks in ((near, FIRST), (others, FIRST), ([*near, *others], REST)):
            if not files:
                continue
            code, output = _run(copy, [*PYTEST, "-m", marks, *files])
            if _DOES_NOT_COMPILE.search(output):
                return None
            if code not in (0, _NONE_CHOSEN):
                failed, in_first = who_failed(output, copy), marks == FIRST
                break
    finally:
        place.write_text(sound, encoding="utf-8")
    if failed and not failed[0].startswith(_HANGS):
        named = "::" in failed[0]
        code, output = _run(
            copy,
            [*PYTEST, "-m", "not peer", failed[0]]
            if named
            else [*PYTEST, "--collect-only", *files],
        )
        if code != 0:
            raise SystemExit(
                f"{failed[0]} fails without any defect too; fix it first: {_last_line(output)}"
            )
    return Result(defect, "".join(failed[:1]), in_first, monotonic() - began)


def _can_be_imported(path: str, copy: Path) -> bool:
    if not path.endswith(".py"):
        return True
    module = path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    return _run(copy, ["-c", f"import {module}"])[0] == 0


# The error of a C compiler in the output of a test.
_DOES_NOT_COMPILE = re.compile(r"\.[ch]:\d+:\d+: error:")


def who_failed(said: str, copy: Path) -> list[str]:
    """The tests that pytest names as failed.

    Where its process died instead, the one that its dump of the stack says it was in.
    """
    failed = re.findall(r"^(?:FAILED|ERROR) ([^\s\[]+\[.*?\](?= - |$)|\S+)", said, re.MULTILINE)
    inside = re.findall(
        rf'^  File "{re.escape(str(copy))}/(tests/\S+\.py)", line \d+ in (test_\w+)$',
        said,
        re.MULTILINE,
    )
    return failed or ["::".join(place) for place in inside[:1]] or [_last_line(said)]


# The exit code of pytest where no test has the marks asked for; how it is started.
_NONE_CHOSEN = 5
PYTEST = ("-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist")
# The tests of README's command, and the others.
FIRST = "(whole or not slow) and not peer"
REST = "slow and not (whole or peer)"


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or ["(no output)"])[-1]


def _run(copy: Path, words: list[str]) -> tuple[int, str]:
    environment = {
        **os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1",
        "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
    }  # fmt: skip
    try:
        done = subprocess.run(
            [sys.executable, *words],
            cwd=copy,
            env=environment,
            capture_output=True,
            text=True,
            timeout=_LONGEST,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return 1, f"{_HANGS}: {_LONGEST:g} s"
    return done.returncode, done.stdout + done.stderr


def _copy(folder: Path) -> Path:
    """The files of the tree as they are, but for what git ignores."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout
    for name in filter(None, listed.decode().split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.planted", description="How many planted defects the tests find."
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument(
        "--room", choices=list(ROOMS), action="append", help="only this room; may be repeated"
    )
    parser.add_argument(
        "-j", "--jobs", type=int, default=2, metavar="N", help="so many defects at a time"
    )
    parser.add_argument("--list", action="store_true", help="say what would be planted, and stop")
    told = parser.parse_args()
    if told.draws < 1 or told.jobs < 1:
        parser.error("--draws and --jobs must be 1 or more.")
    stream = drawn(told.room or list(ROOMS), told.seed)
    if told.list:
        for _, defect in zip(range(told.draws), stream, strict=False):
            print(f"{defect.room:12} {defect}")
        return
    with (
        tempfile.TemporaryDirectory(prefix="planted-") as folder,
        ThreadPoolExecutor(told.jobs) as pool,
    ):
        lock, copies = Lock(), SimpleQueue[Path]()
        for number in range(told.jobs):
            copies.put(_copy(Path(folder) / str(number)))

        def one(_: int) -> Result | None:
            copy = copies.get()
            try:
                while True:
                    with lock:
                        defect = next(stream, None)
                    result = tried(defect, copy) if defect else None
                    if result is not None:
                        print(_row(result), flush=True)
                    if defect is None or result is not None:
                        return result
            finally:
                copies.put(copy)

        print("| room | defect | found by | s |\n|---|---|---|---|", flush=True)
        results = [result for result in pool.map(one, range(told.draws)) if result is not None]
    print(f"\n{_summary(results)}; seed {told.seed}.")


def _summary(results: list[Result]) -> str:
    """Return how many defects were found: in all, by the first tier, and by room."""
    drawn_in = Counter(result.defect.room for result in results)
    found_in = Counter(result.defect.room for result in results if result.found_by)
    rooms = ", ".join(f"{room} {found_in[room]} of {count}" for room, count in drawn_in.items())
    first = sum(result.in_first for result in results)
    return f"{found_in.total()} of {len(results)} found, {first} by the first tier: {rooms}"


def _row(result: Result) -> str:
    tier = "" if result.in_first else " (slow)"
    found = f"`{result.found_by}`{tier}" if result.found_by else "**survived**"
    return f"| {result.defect.room} | {str(result.defect).replace('|', chr(92) + '|')} | {found} | {result.seconds:.0f} |"


if __name__ == "__main__":
    main()

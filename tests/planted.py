"""Planted defects: one small mistake at a time in a copy of the house, and whether the tests of its room find it.

    python -m tests.planted --seed 1 --draws 50 -j 2 # every room; --room judge for one; --list says
    what would be planted

A seed draws the same defects from the same code: each line that can be wrong once, then a mistake
    on that line. What does not import is drawn
again. First come the quick tests that import the file, then the quick ones of the room, then the
    slow ones; what fails must pass without the defect. The tree itself is never
changed: each worker has a copy of it, which is removed at the end, however that comes.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from time import monotonic

ROOT = Path(__file__).resolve().parents[1]
# Room -> the files in which mistakes are made, and the tests that answer for them.
ROOMS = {
    "judge": (("validate/judge/**/*.py", "validate/fmi/*.py", "validate/tasks/stage.py",
               "validate/tasks/paper.py"),
              ("tests/validate/judge/**/*.py", "tests/validate/fmi/*.py",
               "tests/validate/tasks/test_stage.py",
               "tests/validate/tasks/test_campaign_violation.py")),
    "record": (("validate/tasks/*record*.py", "validate/store/results.py", "reports/records/*.py"),
               ("tests/validate/store/*.py", "tests/validate/tasks/*.py",
                "tests/validate/plan/test_campaign*.py",
                "tests/validate/test_campaign_end_to_end.py",
                "tests/validate/execution/test_campaign_rel*.py", "tests/reports/records/*.py",
                "tests/reports/test_re*_[!b]*.py")),
    "certificate": (("formulations/mpec/certificate/*.py",),
                    ("tests/formulations/mpec/**/test_*.py",
                     "tests/formulations/test_methods_mpcc.py")),
    "proof": (("formulations/proof/*.py",), ("tests/formulations/proof/*.py",)),
    "store": (("validate/store/[!r]*.py", "validate/plan/selection.py"),
              ("tests/validate/store/*.py", "tests/validate/plan/*.py",
               "tests/validate/cli/test_c*.py", "tests/validate/cli/test_show*.py",
               "tests/validate/execution/test_campaign*.py",
               "tests/validate/execution/test_cell*.py", "tests/validate/tasks/test_profile.py")),
    "report": (("reports/**/*.py",), ("tests/reports/**/test_*.py",)),
}  # fmt: skip
# Longest that the tests of one defect may take [s]; past it they hang, which is an answer too.
_LONGEST = 1200.0
_HANGS = "it hangs"


Place = ast.expr | ast.stmt


@dataclass(frozen=True)
class Defect:
    room: str
    path: str
    line: int
    kind: str
    before: str
    after: str
    source: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line} {self.kind}: `{_short(self.before)}` -> `{_short(self.after)}`"


def _short(text: str) -> str:
    words = " ".join(text.split())
    return words if len(words) <= 60 else f"{words[:57]}..."


_OPPOSITE: dict[type[ast.AST], tuple[str, type[ast.AST]]] = {
    ast.Add: ("sign", ast.Sub), ast.Sub: ("sign", ast.Add), ast.Mult: ("operator", ast.Div),
    ast.Div: ("operator", ast.Mult),
    ast.Lt: ("comparison", ast.LtE), ast.LtE: ("comparison", ast.Lt),
    ast.Gt: ("comparison", ast.Lt), ast.GtE: ("comparison", ast.Gt),
    ast.Eq: ("comparison", ast.NotEq), ast.NotEq: ("comparison", ast.Eq),
    ast.Is: ("comparison", ast.IsNot), ast.IsNot: ("comparison", ast.Is),
    ast.In: ("comparison", ast.NotIn), ast.NotIn: ("comparison", ast.In),
    ast.And: ("condition", ast.Or), ast.Or: ("condition", ast.And),
}  # fmt: skip
_TWINS = {
    "max": "min",
    "min": "max",
    "any": "all",
    "all": "any",
    "maximum": "minimum",
    "minimum": "maximum",
}
# Their arguments may change places.
_COMMUTE = {*_TWINS, "Max", "hypot", "array_equal", "gcd", "suppress"}


def mistakes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """What could be written in a node's place by mistake: (kind, node)."""
    match node:
        case ast.BinOp(left=left, op=op, right=right) if not isinstance(left, ast.JoinedStr):
            if type(op) in _OPPOSITE:
                kind, other = _OPPOSITE[type(op)]
                yield kind, ast.BinOp(left, other(), right)
            if isinstance(op, (ast.Add, ast.Sub)):
                yield "dropped term", left
        case ast.AugAssign(target=target, op=op, value=value) if type(op) in _OPPOSITE:
            kind, other = _OPPOSITE[type(op)]
            yield kind, ast.AugAssign(target, other(), value)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield "sign", operand
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "condition", operand
        case ast.Compare(left=left, ops=[op], comparators=comparators):
            kind, other = _OPPOSITE[type(op)]
            yield kind, ast.Compare(left, [other()], comparators)
        case ast.BoolOp(op=op, values=values):
            kind, other = _OPPOSITE[type(op)]
            yield kind, ast.BoolOp(other(), values)
            yield "condition", values[0]
        case ast.If(test=test) | ast.IfExp(test=test) if not (
            isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"
        ):
            yield "condition always true", ast.Constant(True)
        case ast.Constant(value=value) if isinstance(value, (int, float)) and not isinstance(
            value, bool
        ):
            yield "constant", ast.Constant(2 * value if value else type(value)(1))
        case ast.Subscript(value=value, slice=ast.Constant(value=int(index))):
            yield "index", ast.Subscript(value, ast.Constant(index + 1))
        case ast.Subscript(
            value=value, slice=ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(index)))
        ):
            yield (
                "index",
                ast.Subscript(
                    value,
                    ast.Constant(index - 1)
                    if index == 1
                    else ast.UnaryOp(ast.USub(), ast.Constant(index - 1)),
                ),
            )
        case ast.Call(func=func, args=args, keywords=keywords):
            name = (
                func.id
                if isinstance(func, ast.Name)
                else func.attr
                if isinstance(func, ast.Attribute)
                else ""
            )
            if (
                name not in _COMMUTE
                and len(args) > 1
                and not any(isinstance(item, ast.Starred) for item in args[:2])
            ):
                yield "arguments swapped", ast.Call(func, [args[1], args[0], *args[2:]], keywords)
            for values in _neighbours([item.value for item in keywords]):
                given = [
                    ast.keyword(item.arg, value)
                    for item, value in zip(keywords, values, strict=True)
                ]
                yield "columns exchanged", ast.Call(func, args, given)
            if name == "abs" and len(args) == 1:
                yield "sign", args[0]
            if name in _TWINS:
                other = _TWINS[name]
                yield (
                    "extreme",
                    ast.Call(
                        ast.Name(other)
                        if isinstance(func, ast.Name)
                        else ast.Attribute(func.value, other),
                        args,
                        keywords,
                    ),
                )
        case ast.Dict(keys=keys, values=values) if None not in keys:
            for exchanged in _neighbours(values):
                yield "columns exchanged", ast.Dict(keys, exchanged)
        case _:
            return


def _neighbours(values: list[ast.expr]) -> Iterator[list[ast.expr]]:
    """The values with two neighbours exchanged."""
    for second in range(1, len(values)):
        yield [*values[: second - 1], values[second], values[second - 1], *values[second + 1 :]]


def _places(tree: ast.Module) -> Iterator[ast.AST]:
    """Nodes whose value matters when the program runs: not annotations, docstrings, decorators, nor what only a type checker reads."""
    todo: list[ast.AST] = [tree]
    while todo:
        node = todo.pop()
        yield node
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_params"):
                continue
            todo += [
                item
                for item in (value if isinstance(value, list) else [value])
                if isinstance(item, ast.AST)
            ]


def candidates(text: str) -> dict[int, list[tuple[str, Place, str]]]:
    """Line -> its possible mistakes: (kind, what is replaced, the text in its place)."""
    found: dict[int, list[tuple[str, Place, str]]] = defaultdict(list)
    for node in _places(ast.parse(text)):
        for kind, other in mistakes(node):
            place = node.test if isinstance(node, ast.If | ast.IfExp) else node
            assert isinstance(place, Place)
            written = ast.unparse(ast.fix_missing_locations(other))
            if written != ast.unparse(place):
                found[place.lineno].append(
                    (
                        kind,
                        place,
                        f"({written})"
                        if isinstance(node, ast.BinOp | ast.BoolOp | ast.Compare)
                        else written,
                    )
                )
    return found


def replaced(text: str, place: Place, written: str) -> str:
    """The text with another in this place; columns of the tree count bytes."""
    lines = text.encode().splitlines(keepends=True)
    assert place.end_lineno is not None
    assert place.end_col_offset is not None
    before = b"".join(lines[: place.lineno - 1]) + lines[place.lineno - 1][: place.col_offset]
    after = lines[place.end_lineno - 1][place.end_col_offset :] + b"".join(
        lines[place.end_lineno :]
    )
    return (before + written.encode() + after).decode()


def drawn(rooms: list[str], seed: int) -> Iterator[Defect]:
    """Defects without end, each on another line, the rooms in turn."""
    dice = random.Random(seed)
    lines: dict[str, list[tuple[Path, int]]] = {}
    texts: dict[Path, str] = {}
    for room in rooms:
        lines[room] = []
        for path in sorted({path for pattern in ROOMS[room][0] for path in ROOT.glob(pattern)}):
            texts[path] = path.read_text(encoding="utf-8")
            lines[room] += [(path, line) for line in sorted(candidates(texts[path]))]
        dice.shuffle(lines[room])
    while any(lines.values()):
        for room in rooms:
            if not lines[room]:
                continue
            path, line = lines[room].pop()
            kind, place, written = dice.choice(candidates(texts[path])[line])
            before = ast.get_source_segment(texts[path], place) or ""
            name = path.relative_to(ROOT).as_posix()
            yield Defect(
                room, name, line, kind, before, written, replaced(texts[path], place, written)
            )


def tests_of(defect: Defect, tree: Path) -> tuple[list[str], list[str]]:
    """Test files of the room: those that import the file or the package it is in, and the others."""
    every = sorted(
        {
            path
            for pattern in ROOMS[defect.room][1]
            for path in tree.glob(pattern)
            if path.name.startswith("test_")
        }
    )
    module = defect.path.removesuffix(".py").replace("/", ".")
    package = module.rpartition(".")[0]
    imports = re.compile(
        rf"^\s*(from|import) ({re.escape(module)}|{re.escape(package)} import .*\b{module.rpartition('.')[2]}\b)",
        re.MULTILINE,
    )
    near = [path for path in every if imports.search(path.read_text(encoding="utf-8"))]
    names = [path.relative_to(tree).as_posix() for path in near]
    return names, [
        name for name in (path.relative_to(tree).as_posix() for path in every) if name not in names
    ]


@dataclass(frozen=True)
class Result:
    defect: Defect
    found_by: str
    seconds: float


def tried(defect: Defect, copy: Path) -> Result | None:
    """What the tests say of a defect, planted in a copy of the tree; None if it does not import."""
    began, place = monotonic(), copy / defect.path
    sound = place.read_text(encoding="utf-8")
    module = defect.path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    found, asked = [], []
    place.write_text(defect.source, encoding="utf-8")
    try:
        if _run(copy, ["-c", f"import {module}"])[0] != 0:
            return None
        near, others = tests_of(defect, copy)
        for files, marks in ((near, "not slow"), (others, "not slow"), ([*near, *others], "slow")):
            if files and not found:
                code, said = _run(copy, [*PYTEST, "-m", f"{marks} and not peer", *files])
                found, asked = [] if code in (0, _NONE_CHOSEN) else who_failed(said, copy), files
    finally:
        place.write_text(sound, encoding="utf-8")
    if found and not found[0].startswith(_HANGS):
        named = "::" in found[0]
        code, said = _run(
            copy, [*PYTEST, found[0]] if named else [*PYTEST, "--collect-only", *asked]
        )
        if code != 0:
            raise SystemExit(
                f"{found[0]} fails without any defect too; mend it first: {_last_line(said)}"
            )
    return Result(defect, "".join(found[:1]), monotonic() - began)


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
    found = sum(bool(result.found_by) for result in results)
    print(f"\n{found} of {len(results)} found, {len(results) - found} survived; seed {told.seed}.")


def _row(result: Result) -> str:
    found = f"`{result.found_by}`" if result.found_by else "**survived**"
    return f"| {result.defect.room} | {str(result.defect).replace('|', chr(92) + '|')} | {found} | {result.seconds:.0f} |"


if __name__ == "__main__":
    main()

"""Rules of the house: who may import whom, how long a file may be, and that importing a room costs little."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from benchmarks.house import read, structure

ROOT = Path(__file__).parents[1]
ROOMS = ("models", "formulations", "validate", "reports")


def test_import_contracts():
    done = subprocess.run(
        [Path(sys.executable).with_name("lint-imports")], cwd=ROOT, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("models", {"pyomo", "torch", "sympy"}),
        ("formulations", {"pyomo", "torch", "cyipopt"}),
        ("formulations.pipelines", {"pyomo", "torch", "cyipopt", "sympy"}),
        ("validate", {"pyomo", "torch", "fmpy", "sympy"}),
        ("reports", {"pyomo", "torch", "sympy", "fmpy"}),
        (
            "validate.judge.replay.job",
            {"pyomo", "torch", "sympy", "scipy", "sksundae", "pydantic", "h5py"},
        ),  # the child of every replay
        (
            "validate.fmu_check.host",
            {"pyomo", "torch", "sympy", "scipy", "sksundae", "pydantic", "h5py"},
        ),  # and of every check
    ],
)
def test_importing_a_room_is_cheap(module: str, heavy: set[str]):
    code = (
        f"import sys, {module}; print([name for name in {sorted(heavy)!r} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_what_is_shipped_reads_nothing_that_is_not():
    """No path of a shipped room is made of a folder that a checkout alone has.

    Sentences may name one.
    """
    made = []
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if (
                    isinstance(node, ast.Constant)
                    and isinstance(node.value, str)
                    and re.fullmatch(r"(tests|docs|benchmarks)(/\S*)?", node.value)
                ):
                    made.append(f"{path.relative_to(ROOT)}:{node.lineno}: {node.value}")
    assert not made, made


@pytest.mark.slow
def test_house_structure_stays():
    """No circles, annotations counted; nine in ten docstrings of arrays have shape, unit, errors."""
    found = structure(read(ROOT))
    assert found["circles (modules in them)"] == "0 (0)"
    assert int(found["imports of our modules inside functions"]) <= 50
    assert int(found["class names with two meanings"]) <= 10
    assert int(found["loose Python files in validate/"]) <= 2
    assert int(found["modules that a run may reach"]) <= 180
    assert int(found["largest folder except catalogs"].split()[0]) <= 14
    documented = found["public functions of arrays: docstring with shape, unit, errors"]
    assert min(int(part.split()[0]) for part in documented.split(", ")) >= 90, documented


def _lines(path: Path) -> int:
    """Lines of a file but for the docstrings of functions and classes, which nobody should save on."""
    text = path.read_text(encoding="utf-8")
    nodes = ast.walk(ast.parse(text)) if path.suffix == ".py" else ()
    told = [
        node.body[0]
        for node in nodes
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        and ast.get_docstring(node) is not None
    ]
    return len(text.splitlines()) - sum(
        (item.end_lineno or item.lineno) - item.lineno for item in told
    )


@pytest.mark.slow
def test_no_file_is_a_drawer():
    """One file is one idea that a stranger can name, in at most 750 lines beside its docstrings.

    `util.py` names none.
    """
    long = []
    for room in (*ROOMS, "tests", "benchmarks"):
        for path in (ROOT / room).rglob("*"):
            limit = dict.fromkeys((".py", ".c", ".h", ".j2", ".js"), 750).get(path.suffix)
            if limit and _lines(path) > limit:
                long.append(f"{path.relative_to(ROOT)}: more than {limit} lines")
            if path.stem in {"util", "utils", "helpers", "misc"}:
                long.append(f"{path.relative_to(ROOT)}: a drawer")
    assert not long, long


@pytest.mark.slow
def test_a_test_that_hangs_is_stopped_and_named(tmp_path: Path):
    (tmp_path / "test_one.py").write_text(
        "import time\n\ndef test_sleeps():\n    time.sleep(3600.0)\n", encoding="utf-8"
    )
    words = [
        "pytest",
        "-c",
        ROOT / "pyproject.toml",
        "--rootdir",
        tmp_path,
        "-p",
        "no:cacheprovider",
        tmp_path,
    ]
    done = subprocess.run(
        [sys.executable, "-m", *words, "-o", "faulthandler_timeout=1"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert 'test_one.py", line 4 in test_sleeps' in done.stderr
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "pytest"
    ]["ini_options"]
    assert 0 < settings["faulthandler_timeout"] <= 1200

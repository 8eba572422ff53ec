"""Rules of the house: who may import whom, how long a file may be, and that importing a room costs little."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("models", "formulations", "validate", "reports")


def test_import_contracts():
    done = subprocess.run(
        [Path(sys.executable).with_name("lint-imports")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("models", {"pyomo", "torch", "sympy"}),
        ("formulations", {"pyomo", "torch", "cyipopt"}),
        ("formulations.catalog", {"pyomo", "torch", "cyipopt", "sympy"}),
        ("validate", {"pyomo", "torch", "fmpy", "sympy"}),
        ("reports", {"pyomo", "torch", "sympy", "fmpy"}),
    ],
)
def test_importing_a_room_is_cheap(module: str, heavy: set[str]):
    code = f"import sys, {module}; print([name for name in {sorted(heavy)!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_file_is_a_drawer():
    """Long files and `util.py` hide structure: 300 lines of Python, 400 of C or a template."""
    long = []
    for room in (*ROOMS, "tests", "benchmarks"):
        for path in (ROOT / room).rglob("*"):
            limit = {".py": 300, ".c": 400, ".h": 400, ".j2": 400, ".js": 400}.get(path.suffix)
            if limit and len(path.read_text(encoding="utf-8").splitlines()) > limit:
                long.append(f"{path.relative_to(ROOT)}: more than {limit} lines")
            if path.stem in {"util", "utils", "helpers", "misc"}:
                long.append(f"{path.relative_to(ROOT)}: a drawer")
    assert not long, long

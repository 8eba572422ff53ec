"""Planted defects: each is one mistake on one line, a seed repeats them, and no file is changed."""

import ast
import subprocess
import sys
from itertools import islice, takewhile
from pathlib import Path

import pytest

from tests.defects import Mistake, mistakes_in, replaced
from tests.planted import PYTEST, ROOMS, ROOT, Defect, drawn, tried

TEXT = '''"""A docstring of 2 - 1."""

def f(a: int = 3, *, b: float) -> list[int]:
    s = "ü" + str(a - 2)
    if a < b and not b:
        s += g(a, b, last=-a, first=[1, 2][0])
    return max(s, {"one": 1, "two": b})
'''


C_TEXT = """/* 1 + 2 */
#define TWICE(x) (2 * (x))
static double f(const double *x, int n)
{
    double s = 0.0; // 3 - 1
    for (int i = 0; i < n && !x[i]; i++) s += fmax(x[i] - 1.5e-3, 0);
    if (!s) return *x == 1 ? x2(s) : g("a + b");
    return s;
}
"""


def written(line: int, text: str = TEXT, name: str = "x.py") -> set[tuple[str, str]]:
    """Return (kind, the line with the mistake)."""
    return {
        (mistake.kind, replaced(text, mistake).splitlines()[line - 1].strip())
        for mistake in mistakes_in(name, text).get(line, [])
    }


def alike(some: list[str], others: list[str]) -> int:
    """How many lines are the same from the beginning on."""
    return sum(
        1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(some, others, strict=False))
    )


def test_python_mistakes_of_every_kind():
    assert not written(1), "a docstring computes nothing"
    assert written(3) == {("constant", "def f(a: int = 6, *, b: float) -> list[int]:")}, (
        "annotations compute nothing"
    )
    assert ("sign", 's = "ü" + str((a + 2))') in written(4)
    assert ("dropped term", 's = "ü" + str((a))') in written(4)
    assert {
        ("comparison", "if (a <= b) and not b:"),
        ("condition", "if (a < b or not b):"),
        ("condition always true", "if True:"),
    } <= written(5)
    calls = written(6)
    assert ("arguments swapped", "s += g(b, a, last=-a, first=[1, 2][0])") in calls
    assert ("columns exchanged", "s += g(a, b, last=[1, 2][0], first=-a)") in calls
    assert ("index", "s += g(a, b, last=-a, first=[1, 2][1])") in calls
    assert ("sign", "s -= g(a, b, last=-a, first=[1, 2][0])") in calls
    last = written(7)
    assert ("columns exchanged", "return max(s, {'one': b, 'two': 1})") in last
    assert any(kind == "extreme" and "min(" in line for kind, line in last)


def test_c_mistakes_of_every_kind():
    for line in (1, 2, 3, 4, 8, 9):
        assert not written(line, C_TEXT, "x.c"), "comments, macros and declarations stay"
    assert written(5, C_TEXT, "x.c") == {("constant", "double s = 1.0; // 3 - 1")}
    loop = "for (int i = 0; i < n && !x[i]; i++) s += fmax(x[i] - 1.5e-3, 0);"
    assert written(6, C_TEXT, "x.c") == {
        ("constant", loop.replace("i = 0", "i = 1")),
        ("comparison", loop.replace("i < n", "i <= n")),
        ("condition", loop.replace("&&", "||")),
        ("sign", loop.replace("+=", "-=")),
        ("extreme", loop.replace("fmax", "fmin")),
        ("sign", loop.replace("] - ", "] + ")),
        ("constant", loop.replace("1.5e-3", "0.003")),
        ("constant", loop.replace(", 0)", ", 1)")),
    }
    branch = 'if (!s) return *x == 1 ? x2(s) : g("a + b");'
    assert written(7, C_TEXT, "x.c") == {
        ("condition", branch.replace("!s", "s")),
        ("comparison", branch.replace("==", "!=")),
        ("constant", branch.replace("== 1", "== 2")),
    }


@pytest.mark.slow
def test_drawn_defect_changes_one_line():
    for defect in islice(drawn(list(ROOMS), seed=5), 100):
        sound = (ROOT / defect.path).read_text(encoding="utf-8")
        if defect.path.endswith(".py"):
            ast.parse(defect.source)
        before, after = sound.splitlines(), defect.source.splitlines()
        begin = alike(before, after)
        end = alike(before[begin:][::-1], after[begin:][::-1])
        assert len(after) - begin - end == 1, (
            "an expression may be of several lines, and is written on one; all else stays"
        )


@pytest.mark.slow
def test_a_seed_draws_the_same_and_another_one_others():
    first, again, other = (
        [str(defect) for defect in islice(drawn(["judge", "store"], seed), 30)]
        for seed in (1, 1, 2)
    )
    assert first == again
    assert len(set(first) & set(other)) < 5
    assert len(set(first)) == 30


def test_every_room_has_files_and_tests():
    for room, (files, tests) in ROOMS.items():
        for patterns in (files, tests):
            assert any(True for pattern in patterns for _ in ROOT.glob(pattern)), room


CHANGE = Mistake("constant", 1, 4, 5, "1", "2")


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository of one file and a folder for its tests."""
    (tmp_path / "tests").mkdir()
    (tmp_path / "own.py").write_text("X = 1\n", encoding="utf-8")
    monkeypatch.setattr("tests.planted.ROOT", tmp_path)
    monkeypatch.setitem(ROOMS, "own", (("own.py",), ("tests/test_*.py",)))
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("def f(:\n", None), ("import no_such_module\n", None),
        ("X = 2\n", "tests/test_x.py::test_x[a name, of - words]"),
        ("X = 3\n", "tests/test_x.py::test_x"), ("X = 1\n", ""),
    ],
)  # fmt: skip
def test_what_fails_is_named_what_does_not_import_is_drawn_again_and_the_file_is_as_before(
    source, says, own
):
    (own / "tests" / "test_x.py").write_text(
        'import os, pytest\nfrom own import X\n\n@pytest.mark.parametrize("y", [1], ids=["a name, of - words"])\ndef test_x(y):\n'
        "    if X == 3:\n        os.abort()\n    assert X == y\n",
        encoding="utf-8",
    )
    found = tried(Defect("own", "own.py", CHANGE, source), own)
    assert (None if found is None else found.found_by) == says
    assert (own / "own.py").read_text(encoding="utf-8") == "X = 1\n"


@pytest.mark.slow
def test_a_test_that_fails_anyway_ends_the_draw(own: Path):
    (own / "tests" / "test_x.py").write_text(
        "from own import X\n\ndef test_x():\n    assert X == 3\n", encoding="utf-8"
    )
    with pytest.raises(SystemExit, match="fails without any defect too"):
        tried(Defect("own", "own.py", CHANGE, "X = 2\n"), own)


def test_the_tests_start_as_a_draw_starts_them():
    """Without pytest-xdist, whose hooks conftest.py must not ask for."""
    said = subprocess.run(
        [sys.executable, *PYTEST, "--collect-only", __file__],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert said.returncode == 0, said.stdout + said.stderr

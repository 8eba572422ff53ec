"""The planter of defects: what it writes is one mistake on one line, the same for a seed, and it leaves every file as it was."""

import ast
import subprocess
import sys
from itertools import islice, takewhile
from pathlib import Path

import pytest

from tests.planted import PYTEST, ROOMS, ROOT, Defect, candidates, drawn, replaced, tried

TEXT = '''"""A docstring of 2 - 1."""

def f(a: int = 3, *, b: float) -> list[int]:
    s = "ü" + str(a - 2)
    if a < b and not b:
        s += g(a, b, last=-a, first=[1, 2][0])
    return max(s, {"one": 1, "two": b})
'''


def written(line: int) -> set[tuple[str, str]]:
    """(kind, the line with the mistake)"""
    return {
        (kind, replaced(TEXT, place, text).splitlines()[line - 1].strip())
        for kind, place, text in candidates(TEXT)[line]
    }


def alike(some: list[str], others: list[str]) -> int:
    """How many lines are the same from the beginning on."""
    return sum(
        1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(some, others, strict=False))
    )


def test_mistakes_of_every_kind_are_written_where_they_belong():
    assert 1 not in candidates(TEXT), "a docstring computes nothing"
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


@pytest.mark.slow
def test_a_mistake_is_on_one_line_and_can_be_read():
    for defect in islice(drawn(list(ROOMS), seed=5), 60):
        sound = (ROOT / defect.path).read_text(encoding="utf-8")
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
    found = tried(Defect("own", "own.py", 1, "constant", "1", "2", source), own)
    assert (None if found is None else found.found_by) == says
    assert (own / "own.py").read_text(encoding="utf-8") == "X = 1\n"


@pytest.mark.slow
def test_a_test_that_fails_anyway_ends_the_draw(own: Path):
    (own / "tests" / "test_x.py").write_text(
        "from own import X\n\ndef test_x():\n    assert X == 3\n", encoding="utf-8"
    )
    with pytest.raises(SystemExit, match="fails without any defect too"):
        tried(Defect("own", "own.py", 1, "constant", "1", "2", "X = 2\n"), own)


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

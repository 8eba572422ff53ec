"""`python -m benchmarks house` counts lines, constants, words and imports."""

import subprocess
from pathlib import Path

import pytest

from benchmarks import house

PATH = """import numpy as np

from validate import loose


class One: ...


def f(x: np.ndarray) -> np.ndarray:
    \"\"\"x (n, nq) [m]. Raises ValueError.\"\"\"
    loose.run()
    return x


def g(x: np.ndarray) -> None:
    pass
"""
ONE = """from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from models.two import Two

LIMIT = 7.5  # What a limit is. It tells nobody.
NAMES = {"a": 4}
NONE = None


class One:
    \"\"\"A
    class.\"\"\"

    two: "Two"
"""
FILES = {
    "models/__init__.py": '"""Nothing."""\n',
    "models/one.py": ONE,
    "models/two.py": "from models.one import One  # a comment\n\n\nclass Two(One): ...\n",
    "models/shell.c": "/* a\n   comment */\nint x; // y\n\n",
    "validate/loose.py": "def run() -> None:\n    from models import one\n\n    one.One(8)\n",
    "validate/tasks/path.py": PATH,
    "reports/page.html": "<p>\n<!-- a\ncomment -->\n",
    "tests/test_x.py": "x = 1\n\n",
    "docs/page.md": "a" * 2000,
    "untracked.py": "x = 1\n",
}


@pytest.fixture
def tree(tmp_path: Path) -> house.Tree:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    tracked = sorted({name.split("/")[0] for name in FILES} - {"untracked.py"})
    subprocess.run(["git", "add", *tracked], cwd=tmp_path, check=True)
    return house.read(tmp_path)


def test_house_sizes(tree: house.Tree):
    assert house.sizes(tree) == {
        "product: Python code lines": 8 + 2 + 3 + 8,
        "product: C lines": 1,
        "product: JavaScript lines": 0,
        "product: CSS lines": 0,
        "product: template lines": 1,
        "product: TOML lines": 0,
        "tests: Python code lines": 1,
        "benchmarks: Python code lines": 0,
        "product files": 7,
        "tracked files": 9,
        "names of numeric constants": 2,
        "unusual numeric literals": 3,
        "words of docstrings and comments": 1 + 2 + 7 + 2 + 6,
        "sentences with a headless opening": 1,
        "tell, say, ask, somebody and the like": 2,
        "kB of docs and README": 2,
        "kB of CHANGELOG": 0,
    }


def test_house_structure(tree: house.Tree):
    assert list(house.structure(tree).values()) == [
        "1",
        "4 (models)",
        "4",  # path, loose, one, two
        "1 (2)",  # one and two, by an annotation
        "1",
        "1",
        "50 %, 50 %, 50 %",
    ]


def test_code_lines_without_comments_and_docstrings():
    text = (
        '"""A\nmodule."""\n\n# a comment\nx = """a\ntext"""\n\n\n'
        'def f():\n    """Docstring."""\n    return (\n        x\n    )\n'
    )
    assert house.code_lines(text) == 6

"""`python -m benchmarks house` counts what it says."""

import subprocess
from pathlib import Path

import pytest

from benchmarks import house

FILES = {
    "models/__init__.py": '"""Nothing."""\n',
    "models/one.py": '"""One."""\n\nfrom typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n    from models.two import Two\n\n\nclass One:\n    """A\n    class."""\n\n    two: "Two"\n',
    "models/two.py": "from models.one import One  # a comment\n\n\nclass Two(One): ...\n",
    "validate/loose.py": "def run() -> None:\n    from models import one\n\n    one.One()\n",
    "validate/tasks/path.py": (
        'import numpy as np\n\nfrom validate import loose\n\n\nclass One: ...\n\n\ndef f(x: np.ndarray) -> np.ndarray:\n    """x (n, nq) [m]. Raises ValueError."""\n'
        "    loose.run()\n    return x\n\n\ndef g(x: np.ndarray) -> None:\n    pass\n"
    ),
    "reports/page.html": "<p>\n",
    "tests/test_x.py": "x = 1\n\n",
    "untracked.py": "x = 1\n",
}


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    subprocess.run(
        ["git", "add", "models", "validate", "reports", "tests"], cwd=tmp_path, check=True
    )
    monkeypatch.setattr(house, "ROOT", tmp_path)
    return tmp_path


def test_what_is_counted(tree: Path):
    assert list(house.measure().values()) == [
        "18",  # 0 + 5 + 2 + 3 + 8
        "6",
        "1",
        "3 (models)",
        "4",  # run, loose, one, two
        "1 (2)",  # one and two, by an annotation
        "1",
        "1",
        "50 %, 50 %, 50 %",
        "2",
    ]


def test_code_is_what_is_no_comment_docstring_or_blank_line():
    assert (
        house.code_lines(
            '"""A\nmodule."""\n\n# a comment\nx = """a\ntext"""\n\n\ndef f():\n    """Told."""\n    return (\n        x\n    )\n'
        )
        == 6
    )

"""`python -m benchmarks`: every command of the docs exists, and a mistake is one sentence."""

import re
import signal

import pytest
from wording import unsaid

from benchmarks import ROOT
from benchmarks.commands import _COMMANDS, group
from benchmarks.measure import run_child
from validate.cli.group import run

TEXT = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", _COMMANDS)
def test_a_command_explains_itself_and_the_docs_name_it(
    name: str, capsys: pytest.CaptureFixture[str]
):
    assert run([name, "--help"], group, "python -m benchmarks") == 0
    assert f"Usage: python -m benchmarks {name}" in capsys.readouterr().out
    assert re.search(rf"`{name}[` ]|benchmarks {name}\b", TEXT), name


def test_commands_in_docs_and_readme_exist():
    texts = [
        path.read_text(encoding="utf-8")
        for path in (*(ROOT / "docs").glob("*.md"), ROOT / "README.md")
    ]
    for name in {
        name for text in texts for name in re.findall(r"python -m benchmarks ([a-z-]+)", text)
    }:
        assert name in _COMMANDS, name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("siute",), "did you mean suite?"),
        (("report", ".", "--browser", "/no/browser"), "there is no program"),
        (("kills", "--count", "0"), "x>=1"),
        (("golden", "compare", "."), "no campaign in this folder"),
        (("rejudge", "."), "no campaign in this folder"),
        (("report", "no_such_folder"), "no campaign in this folder"),
        (("plans", "--pipeline", "nobody"), "is not one of"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence(
    words: tuple[str, ...],
    sentence: str,
    tmp_path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    assert run(words, group, "python -m benchmarks") == 2
    said = capsys.readouterr().err
    assert not unsaid(said, sentence)
    assert len(said.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_child_that_takes_too_long_is_ended_by_its_limit():
    assert run_child("timeit", "-n", "10000000000", cpu_limit=1).returncode == -signal.SIGXCPU

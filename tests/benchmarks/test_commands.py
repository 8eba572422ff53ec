"""`python -m benchmarks`: every command that is told exists, what was measured is told on the page, and mistakes are one sentence."""

import json
import os
import re
import signal
import subprocess
import sys

import click
import pytest
from wording import unsaid

from benchmarks import ROOT
from benchmarks.command_times import Checkout
from benchmarks.commands import _COMMANDS, group
from benchmarks.measure import least, run_child
from benchmarks.page import render
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


def test_a_commands_seconds_are_those_of_all_its_processes(tmp_path):
    burns = "import time\nwhile time.process_time() < 0.3: pass"
    starts = (
        f"import subprocess, sys; subprocess.run([sys.executable, '-c', {burns!r}], check=True)"
    )
    checkout = Checkout(ROOT, tmp_path / "folder")
    assert 0.3 <= checkout.run(["-c", starts]) < 3.0
    assert checkout.run(["-c", "pass"]) < 0.3
    with pytest.raises(click.ClickException, match="ended with 2: broken"):
        checkout.run(["-c", "import sys; print('broken', file=sys.stderr); sys.exit(2)"])


@pytest.mark.slow
def test_what_is_measured_is_listed_and_told_with_its_origin(cli, tmp_path):
    done = cli("run", "shooting", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == str(tmp_path / "page.html")
    told = json.loads((tmp_path / "shooting.json").read_text())
    assert told["provenance"]["command"].startswith("python -m benchmarks shooting")
    assert [row[0] for row in told["tables"][0]["rows"][:3]] == [
        "relu: kernel",
        "relu: rollout",
        "relu: iteration",
    ]
    assert re.findall('<section id="(.*?)"', render(tmp_path)) == ["overview", "table-shooting"]
    (line,) = [
        line
        for line in cli("list", str(tmp_path)).stdout.splitlines()
        if line.startswith("shooting")
    ]
    assert line.split()[1] == "measured"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("siute",), "did you mean suite?"), (("run", "golden"), "is not one of"),
        (("page", "no_such_folder"), "there is no such folder"),
        (("page", "."), "no benchmark has left figures there"),
        (("commands", "--beside", "docs"), "docs is no checkout of touchstone"),
        (("cosim", "--step", "0.003"), "does not divide 0.01 s"),
        (("replay", "three_cart", "nobody"), "there is no scene"),
        (("verdicts", "exact", "--mujoco", "/no/python"), "there is no program"),
        (("kills", "--count", "0"), "x>=1"),
        (("golden", "compare", "."), "no campaign in this folder"),
        (("rejudge", "."), "no campaign in this folder"),
        (("report", "no_such_folder"), "no campaign in this folder"),
        (("fuzz", "readers", "--only", "nobody"), "there is no reader"),
        (("plans", "--only", "nobody"), "no scene … 'nobody'"),
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
def test_ctrl_c_ends_a_run_with_its_children_in_one_word(tmp_path):
    """The second benchmark is not begun, and a child that is interrupted with us tells nothing of its own."""
    command = [
        sys.executable,
        "-m",
        "benchmarks",
        "run",
        "mpec-growth",
        "shooting",
        "--out",
        str(tmp_path / "out"),
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    running = subprocess.Popen(
        command,
        cwd=tmp_path,
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.default_int_handler
        ),  # which a shell's background ignores
    )
    first = (
        running.stderr.readline()
    )  # the smallest size is solved, the next one is a child that runs
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate()
    assert first.startswith("100 pairs")
    assert running.returncode == 130
    assert said.strip() == "error: interrupted."
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_child_that_takes_too_long_is_ended_by_its_limit():
    assert run_child("benchmarks.mpec.growth", "55", cpu_limit=1).returncode == -signal.SIGXCPU


def test_least_calls_its_work_as_often_as_allowed():
    calls = []
    assert least(lambda: calls.append(1) or len(calls), repetitions=3)[0] == 1
    assert len(calls) == 3
    least(lambda: calls.append(1), repetitions=3, enough=-1.0)
    assert len(calls) == 4

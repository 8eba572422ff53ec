"""The shell completes commands, options and scenes of the installed program, by the line that the docs give."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from validate.cli.group import run

pytestmark = pytest.mark.process

SHELLS = ("bash", "zsh", "fish")


def asked(
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    instruction: str,
    line: str = "",
) -> str:
    """What the program prints for `_TOUCHSTONE_COMPLETE=instruction touchstone`, where a line has been typed up to its end."""
    monkeypatch.setenv("_TOUCHSTONE_COMPLETE", instruction)
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
    assert run([]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    return out


@pytest.mark.parametrize("shell", SHELLS)
def test_each_shell_gets_a_script_for_the_installed_name(monkeypatch, capfd, shell):
    script = asked(monkeypatch, capfd, f"{shell}_source")
    assert "_TOUCHSTONE_COMPLETE" in script
    assert re.search(r"\btouchstone\b", script)
    program = shutil.which(shell)
    if program is not None:
        subprocess.run([program, "-n"], input=script, text=True, check=True)


def test_the_docs_say_the_same_line():
    text = (Path(__file__).parents[3] / "docs" / "campaigns.md").read_text(encoding="utf-8")
    assert 'eval "$(_TOUCHSTONE_COMPLETE=bash_source touchstone)"' in text
    assert all(f"{shell}_source" in text for shell in SHELLS)


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("touchstone sh", ["plain,show"]), ("touchstone all --qu", ["plain,--quick"]),
        ("touchstone all --scene two_f", ["plain,two_finger", "plain,two_finger_lift"]),
        ("touchstone replay plan.csv --scene trans", ["plain,transport"]),
        ("touchstone fmu bounc", ["plain,bouncing_mass"]),
        ("touchstone all --scene my/own", ["file,my/own"]), ("touchstone nonsense --qu", []),
    ],
)  # fmt: skip
def test_what_is_offered(monkeypatch, capfd, line, offered):
    assert asked(monkeypatch, capfd, "bash_complete", line).split() == offered

"""The command line as a user has it: a process of its own, with the fakes of campaign_fakes.py within reach."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from forked_commands import forked_commands

from validate.cli import trials
from validate.cli.group import run

FAKES_FOLDER = Path(__file__).parent / "fakes"


@pytest.fixture(scope="session")
def cli_environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """With a cache of its own, which goes with the folders of the tests: commands are killed here.

    Processes of pytest-xdist share one.
    """
    base = tmp_path_factory.getbasetemp()
    cache = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "cache"
    cache.mkdir(exist_ok=True)
    return {
        **os.environ,
        "PYTHONPATH": str(FAKES_FOLDER),
        "TOUCHSTONE_CACHE": str(cache),
        "NO_COLOR": "1",
    }


@pytest.fixture(scope="session")
def cli(
    cli_environment: dict[str, str],
) -> Iterator[Callable[..., subprocess.CompletedProcess[str]]]:
    """cli("list", "--json") runs `python -m validate list --json` to its end, in a process that need not import what others have."""
    with forked_commands(cli_environment) as run:
        yield lambda *arguments, **environment: run(
            ["-m", "validate", *arguments], {**cli_environment, **environment}
        )


@pytest.fixture
def start_cli(cli_environment: dict[str, str]):
    """The same without waiting: a Popen in a session of its own, killed at the end of the test."""
    started: list[subprocess.Popen[str]] = []
    if (
        signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    ):  # in the background of a shell, which what it starts would inherit
        signal.signal(signal.SIGINT, signal.default_int_handler)

    def start(*arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "validate", *arguments]
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=cli_environment,
            start_new_session=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def dry_run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    """dry_run("--scene", "three_cart") runs `all .. --dry-run` in this process, without trials of the machine; a first word "run" replaces "all"."""
    monkeypatch.setattr(trials, "TRIALS", ())

    def called(*words: str) -> subprocess.CompletedProcess[str]:
        capfd.readouterr()
        command = [*words] if words[0] == "run" else ["all", *words]
        code = run([*command, "--dry-run"])
        return subprocess.CompletedProcess(command, code, *capfd.readouterr())

    return called

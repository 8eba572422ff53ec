"""`.. | head`: whoever reads the output goes away.

The exit code says that, never that all holds or that something does not; nothing stays behind.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from wording import unsaid

from validate.cli.group import READER_GONE

pytestmark = pytest.mark.process

FAKES = ("--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart")
# One line each on stdout; on stderr (with stdout, as `2>&1 | head` has it) the second too.
COMMANDS = {
    "list": ("list",), "help": ("--help",), "a dry run": ("all", *FAKES, "-k", "only_good", "--dry-run"),
    "a typo": ("lsit",), "a campaign": ("all", *FAKES, "-k", "only_good"),
}  # fmt: skip


# Where stderr is heard: one that writes once at its end, and one that tells of its progress.
CASES = [(command, True) for command in COMMANDS] + [("list", False), ("a campaign", False)]


@pytest.fixture
def gone() -> Iterator[int]:
    """The end to write to of a pipe that nobody reads."""
    reads, writes = os.pipe()
    os.close(reads)
    yield writes
    os.close(writes)


@pytest.mark.slow
@pytest.mark.parametrize(("command", "together"), CASES)
def test_a_reader_that_is_gone_is_told_as_that(
    command: str, together: bool, gone: int, cli_environment, tmp_path
):
    out = ("--out", str(tmp_path / "out")) if "--plugin" in COMMANDS[command] else ()
    done = subprocess.run(
        [sys.executable, "-m", "validate", *COMMANDS[command], *out], stdout=gone,
        stderr=subprocess.STDOUT if together else subprocess.PIPE, stdin=subprocess.DEVNULL,
        env=cli_environment, check=False,
    )  # fmt: skip
    assert done.returncode == READER_GONE == 141
    said = (done.stderr or b"").decode()
    assert "Traceback" not in said
    assert "Exception ignored" not in said
    assert "error:" not in said


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/dev/full").exists(), reason="only Linux has a device that is always full"
)
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("command", ["list", "help", "a campaign"])
def test_an_output_that_cannot_be_written_is_one_sentence(
    command: str, unbuffered: str, cli_environment, tmp_path
):
    """Whether Python learns of it as it writes, or as it ends.

    Where stderr is full too only the exit code can tell it.
    """
    out = ("--out", str(tmp_path / "out")) if "--plugin" in COMMANDS[command] else ()
    words = [sys.executable, "-m", "validate", *COMMANDS[command], *out]
    environment = {**cli_environment, "PYTHONUNBUFFERED": unbuffered}
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            words, stdout=full, stderr=subprocess.PIPE, text=True, env=environment, check=False
        )
        mute = subprocess.run(words, stdout=full, stderr=full, env=environment, check=False)
    assert (done.returncode, mute.returncode) == (3, 3)
    assert not unsaid(
        done.stderr.splitlines()[-1],
        "error: ",
        "cannot be written (No space left on device)",
        "make room",
    )
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-"])
def test_streams_that_are_closed_are_none_to_write_to(closed: str, cli_environment):
    shell = f"'{sys.executable}' -m validate list {closed}"
    assert subprocess.run(["sh", "-c", shell], env=cli_environment, check=False).returncode == 0


@pytest.mark.slow
def test_what_finished_is_stored_and_used_again(gone: int, cli, cli_environment, tmp_path):
    command = ("all", *FAKES, "-k", "only_good", "--out", str(tmp_path / "out"))
    subprocess.run(
        [sys.executable, "-m", "validate", *command],
        stdout=gone,
        stderr=subprocess.DEVNULL,
        env=cli_environment,
        check=False,
    )
    again = cli(*command)
    assert "1 stored, 0 to run" in again.stderr
    assert again.returncode == 0

"""Code of somebody else, called as an FMU is: whatever it does has its own ending, and no process and no file is left of it."""

import os
import subprocess
import tempfile
from pathlib import Path

import psutil
import pytest
from killed_campaigns import FAKES_FOLDER

from models.codegen.compiler import find_compiler
from validate.execution.isolated import Ending, Limits, run_isolated

pytestmark = pytest.mark.process

_SLEEP = 600 + os.getpid()  # seconds of a daemon: by these it is known as ours, not that of a test in another process
THROWS = """
#include <new>
#include <stdexcept>
extern "C" void throw_out() { throw std::runtime_error("nobody catches this"); }
extern "C" void refused_by_new() { volatile char *p = new char[(unsigned long)1 << 44]; p[0] = 1; }
"""
_CALLS = (
    ("one_huge_allocation", Ending.MEMORY_LIMIT, "memory limit of 4 GiB"), ("null_pointer", Ending.SIGNAL, "SIGSEGV"),
    ("endless_recursion", Ending.SIGNAL, "SIGSEGV"), ("exit_in_a_thread", Ending.NO_RESULT, "exit code 0"), ("change_folder", Ending.OK, ""),
    ("close_files", Ending.OK, ""), ("ignore_signals", Ending.TIME_LIMIT, "time limit of 2 s"), ("start_daemon", Ending.OK, ""),
    ("start_daemon_and_crash", Ending.SIGNAL, "SIGSEGV"), ("remove_what_is_there", Ending.OK, ""), ("take_all_limits", Ending.NO_RESULT, "without a result"),
    ("jump_out", Ending.SIGNAL, "it crashed"), ("break_the_heap", Ending.ABORT, "SIGABRT"), ("crash_when_unloaded", Ending.OK, ""),
    ("stop_the_group", Ending.SIGNAL, "SIGTERM"),
)  # fmt: skip


@pytest.fixture(autouse=True)
def place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    place = tmp_path / "place"
    place.mkdir()
    monkeypatch.setenv("PYTHONPATH", str(FAKES_FOLDER))
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    library = tmp_path_factory.mktemp("calls") / "calls.so"
    command = [
        *find_compiler().command, "-O0", "-w", f"-DSLEEP={_SLEEP}", "-shared", "-fPIC", "-pthread", "-o", str(library),
        str(FAKES_FOLDER / "foreign_calls.c"),
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True)
    return library


def call(library: Path, name: str, seconds: float = 60.0):
    limits = Limits(seconds=seconds, memory=4 * 1024**3)  # far above what Python and numpy take for themselves
    return run_isolated("isolated_functions:calls", [str(library), name], limits=limits, what="model.fmu")


def sleepers() -> set[str]:
    """Numbers of the processes that sleep as the daemon does."""
    commands = ((item.pid, item.info["cmdline"] or []) for item in psutil.process_iter(["cmdline"]))
    return {str(number) for number, words in commands if words[:2] == ["sleep", str(_SLEEP)]}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ending", "words"), _CALLS)
def test_it_ends_as_it_should_and_leaves_nothing(name: str, ending: Ending, words: str, library: Path, place: Path):
    before = sleepers()
    done = call(library, name, seconds=2.0 if ending is Ending.TIME_LIMIT else 60.0)
    assert done.ending is ending, done
    assert words in done.sentence
    assert done.strays == (1 if "daemon" in name else 0)
    assert sleepers() <= before
    assert list(place.iterdir()) == []


@pytest.mark.parametrize(("name", "ending"), [("throw_out", Ending.ABORT), ("refused_by_new", Ending.MEMORY_LIMIT)])
def test_exceptions_of_cplusplus(name: str, ending: Ending, tmp_path: Path):
    source, library = tmp_path / "throws.cpp", tmp_path / "throws.so"
    source.write_text(THROWS, encoding="utf-8")
    try:
        subprocess.run(["c++", "-shared", "-fPIC", "-o", str(library), str(source)], check=True, capture_output=True)
    except FileNotFoundError:
        pytest.skip("no C++ compiler")
    assert call(library, name).ending is ending

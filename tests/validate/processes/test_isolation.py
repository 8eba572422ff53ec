"""Isolated calls, of our own code and of somebody else's: every way to misbehave has its own ending, good calls beside it are unchanged, nothing is left running or on disk."""

import errno
import faulthandler
import importlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import psutil
import pytest
from killed_campaigns import FAKES_FOLDER, numbers_of

from models.codegen.compiler import find_compiler
from models.errors import MachineError
from validate.processes import isolated, process
from validate.processes.isolated import FOLDER_PREFIX, Ending, IsolatedCalls, Limits, run_isolated

pytestmark = pytest.mark.process


@pytest.fixture(autouse=True)
def own_place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The functions importable in children, all folders of children in one place, and a mark on every process."""
    place = tmp_path / "place"
    place.mkdir()
    monkeypatch.setenv("PYTHONPATH", str(FAKES_FOLDER))
    monkeypatch.setenv("TEST_MARK", str(place))
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


def processes_of(place: Path) -> list[int]:
    return numbers_of(f"TEST_MARK={place}\0".encode())


def call(name: str, request=None, ours: bool = False, **limits):
    arrays = {"x": np.arange(3.0)} if name in ("double", "sums") else None
    given = Limits(**{"seconds": 60.0, **limits})
    return run_isolated(
        f"isolated_functions:{name}", request, arrays, limits=given, what="model.fmu", ours=ours
    )


@pytest.fixture
def forking(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A process that may be forked, whatever else runs in this one, that has imported what its child is to do, and that tells no crash of it."""
    monkeypatch.setattr(isolated, "can_fork", lambda: True)
    monkeypatch.setattr(isolated, "Child", None)
    monkeypatch.syspath_prepend(str(FAKES_FOLDER))
    importlib.import_module("isolated_functions")
    told = faulthandler.is_enabled()
    faulthandler.disable()
    yield
    if told:
        faulthandler.enable(sys.__stderr__)


@pytest.mark.skipif(sys.platform == "win32", reason="no limits there")
def test_a_narrow_limit_of_files_leaves_no_bytecode_cut_off(
    own_place: Path, monkeypatch: pytest.MonkeyPatch
):
    """Python writes as much of a module's bytecode as it may, and takes that for the whole in the next process."""
    package = own_place / "package"
    package.mkdir()
    (package / "long_module.py").write_text(
        f"text = {'x' * 100_000!r}\ndef length(request, arrays):\n    return len(text)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(package))
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    for limit in (8_000, 512 * 1024**2, 8_000):
        done = run_isolated(
            "long_module:length", None, limits=Limits(seconds=60.0, file=limit), what="it"
        )
        assert (done.ending, done.sentence, done.value) == (Ending.OK, "", 100_000)


def test_values_and_arrays_go_in_and_come_out():
    done = call("double", {"a": [1, None]})
    assert (done.ending, done.sentence, done.value) == (Ending.OK, "", {"given": {"a": [1, None]}})
    assert done.arrays["twice"].tolist() == [0.0, 2.0, 4.0]
    assert 0 < done.cpu < 60
    assert done.memory > 1024**2


MISBEHAVIOUR = pytest.mark.parametrize(("name", "request_", "limits", "ending", "words"), [
    ("refuses", None, {}, Ending.ERROR, "there is no such thing; choose another."),
    ("lacks", None, {}, Ending.MACHINE, "there is no compiler."),
    ("finds_no_room", errno.ENOSPC, {}, Ending.MACHINE, "the disk is full"),
    ("finds_no_room", errno.ENOENT, {}, Ending.EXCEPTION, "FileNotFoundError"),
    ("stumbles", None, {}, Ending.EXCEPTION, "KeyError: 'lost'"),
    ("nan_value", None, {}, Ending.EXCEPTION, "not JSON compliant"),
    ("hangs", None, {"seconds": 1.0}, Ending.TIME_LIMIT, "time limit of 1 s"),
    ("burns", None, {"seconds": 1.0}, Ending.TIME_LIMIT, "time limit of 1 s"),
    ("crashes", None, {}, Ending.SIGNAL, "SIGSEGV"),
    ("aborts", None, {}, Ending.ABORT, "SIGABRT"),
    ("leaves", 0, {}, Ending.NO_RESULT, "without a result (exit code 0)"),
    ("leaves", 7, {}, Ending.NO_RESULT, "exit code 7"),
    ("fills", None, {"memory": 1024**3}, Ending.MEMORY_LIMIT, "memory limit of 1 GiB"),
    ("fatal", None, {}, Ending.FATAL, "fmi2DoStep failed with status 4"),
    ("nan", None, {}, Ending.NOT_A_NUMBER, "x is nan"),
])  # fmt: skip


@pytest.mark.slow
@MISBEHAVIOUR
def test_each_misbehaviour_has_its_own_ending(
    name, request_, limits, ending, words, own_place: Path
):
    done = call(name, request_, **limits)
    assert (done.ending, done.value, dict(done.arrays)) == (ending, None, {})
    assert words in done.sentence
    assert processes_of(own_place) == []
    assert list(own_place.iterdir()) == []
    assert call("sums").value == 3.0


@pytest.mark.slow
@pytest.mark.usefixtures("forking")
@MISBEHAVIOUR
def test_a_fork_that_misbehaves_ends_like_a_process_of_its_own(
    name, request_, limits, ending, words, own_place: Path
):
    if "memory" in limits:  # of which this process has some already
        limits = {
            "memory": limits["memory"]
            + int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        }
        words = "memory limit of"
    done = call(name, request_, ours=True, **limits)
    assert (done.ending, done.value, dict(done.arrays)) == (ending, None, {})
    assert words in done.sentence
    assert list(own_place.iterdir()) == []
    assert call("sums", ours=True).value == 3.0


@pytest.mark.skipif(sys.platform != "linux", reason="forks are Linux's")
@pytest.mark.usefixtures("forking")
def test_a_fork_answers_for_a_call_of_our_own(own_place: Path, capsys: pytest.CaptureFixture[str]):
    done = call("double", {"a": [1, None]}, ours=True)
    assert (done.ending, done.value, done.arrays["twice"].tolist()) == (
        Ending.OK,
        {"given": {"a": [1, None]}},
        [0.0, 2.0, 4.0],
    )
    assert 0 < done.cpu < 60
    assert done.memory > 1024**2
    told = call("where", ours=True)
    assert told.ok, told.sentence
    parent, leads, temporary, folder, read, imported = told.value
    assert (parent, leads, read, imported) == (os.getpid(), True, "", True)
    assert temporary == folder
    assert Path(folder).is_relative_to(own_place)
    assert tempfile.gettempdir() == str(own_place)
    assert "not UTF-8" in call("says", ours=True).output
    assert capsys.readouterr() == ("", "")
    assert list(own_place.iterdir()) == []


def test_what_is_foreign_or_has_threads_gets_a_process_of_its_own(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(isolated, "Fork", None)
    assert call("sums").value == 3.0
    monkeypatch.setattr(isolated, "can_fork", lambda: False)
    assert call("sums", ours=True).value == 3.0
    started, ended = threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: (started.set(), ended.wait()))
    thread.start()
    started.wait()
    assert not process.can_fork()
    ended.set()
    thread.join()


def test_no_result_on_a_full_disk_is_not_put_down_to_the_model(
    monkeypatch: pytest.MonkeyPatch, own_place: Path
):
    def refused(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", refused)
    with pytest.raises(MachineError, match="the disk is full"):
        call("leaves", 0)
    assert list(own_place.iterdir()) == []


def test_what_it_prints_is_kept_and_not_believed():
    done = call("says", output=100)
    assert (done.ending, done.value) == (Ending.OK, "said")
    assert len(done.output) <= 100
    assert "not UTF-8" in done.output


def test_a_print_that_never_ends_stops_at_the_file_limit():
    assert call("says", file=4096).value == "said"


def test_a_process_it_leaves_behind_is_counted_and_ended(own_place: Path):
    done = call("forks")
    assert (done.ending, done.value, done.strays) == (Ending.OK, "forked", 1)
    assert processes_of(own_place) == []


def test_only_the_first_process_answers():
    done = call("comes_back_twice", 1)
    assert done.ending is Ending.OK
    assert done.value > 0


def test_a_crash_while_everything_is_unloaded_spoils_nothing():
    assert call("crashes_after").value == "done"


def test_temporary_files_go_with_the_child(own_place: Path):
    done = call("writes_temporary_files")
    assert Path(done.value).is_relative_to(own_place)
    assert list(own_place.iterdir()) == []


@pytest.mark.slow
def test_an_outer_limit_ends_the_inner_run_too(tmp_path: Path, own_place: Path):
    marker = tmp_path / "marker"
    for seconds in (3.0, 12.0, 120.0):  # as a loaded machine needs until the inner one runs
        done = call("nested", str(marker), seconds=seconds)
        if marker.exists():
            break
    assert done.ending is Ending.TIME_LIMIT
    assert marker.read_text() == "inner"
    assert processes_of(own_place) == []
    assert list(own_place.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(("name", "more"), [
    ("starts_and_hangs", ""), ("nested", ""),
    pytest.param("waits", ", ours=True",
                 marks=pytest.mark.skipif(sys.platform != "linux", reason="forks are Linux's")),
])  # fmt: skip
def test_nothing_is_left_when_the_parent_is_killed(
    name: str, more: str, tmp_path: Path, own_place: Path
):
    marker = tmp_path / "marker"
    code = f"from validate.processes.isolated import run_isolated; run_isolated('isolated_functions:{name}', {str(marker)!r}{more})"
    parent = subprocess.Popen(
        [sys.executable, "-c", code],
        env={**os.environ, "TMPDIR": str(own_place)},
        cwd=FAKES_FOLDER.parents[2],
    )
    deadline = time.monotonic() + 300
    while not (marker.exists() and marker.read_text() not in ("", "started")):
        assert time.monotonic() < deadline
        assert parent.poll() is None
        time.sleep(0.02)
    if more:  # a fork: it tells its number
        assert f"PPid:\t{parent.pid}\n" in Path("/proc", marker.read_text(), "status").read_text()
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    while (
        processes_of(own_place) or list(own_place.glob(f"{FOLDER_PREFIX}*"))
    ) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert processes_of(own_place) == []
    assert list(own_place.iterdir()) == []


@pytest.mark.slow
def test_one_child_answers_many_calls_until_one_ends_it(own_place: Path):
    with closing(IsolatedCalls(Limits(seconds=1.0), "model.fmu")) as calls:

        def said(request: str):
            done = calls("isolated_functions:counts", request, {"x": np.arange(3.0)})
            return done.value if done.ok else done.ending

        assert [said(text) for text in ("a", "b", "c")] == [1, 2, 3]
        assert calls("isolated_functions:counts", "d", {"x": np.arange(3.0)}).arrays[
            "x"
        ].tolist() == [0.0, 1.0, 2.0]
        assert said("crash if not first") == 1  # once more, in a new process
        assert said("crash") is Ending.SIGNAL
        assert said("a") == 1
        assert said("hang") is Ending.TIME_LIMIT
        assert said("refuse") is Ending.ERROR
        assert [said("a"), said("b")] == [1, 2]
    assert list(own_place.iterdir()) == []
    assert processes_of(own_place) in ([], [os.getpid()])


_SLEEP = (
    600 + os.getpid()
)  # seconds of a daemon: by these it is known as ours, not that of a test in another process
THROWS = """
#include <new>
#include <stdexcept>
extern "C" void throw_out() { throw std::runtime_error("nobody catches this"); }
extern "C" void refused_by_new() { volatile char *p = new char[(unsigned long)1 << 44]; p[0] = 1; }
"""
_CALLS = (
    ("one_huge_allocation", Ending.MEMORY_LIMIT, "memory limit of 4 GiB"),
    ("null_pointer", Ending.SIGNAL, "SIGSEGV"),
    ("endless_recursion", Ending.SIGNAL, "SIGSEGV"),
    ("exit_in_a_thread", Ending.NO_RESULT, "exit code 0"), ("change_folder", Ending.OK, ""),
    ("close_files", Ending.OK, ""), ("ignore_signals", Ending.TIME_LIMIT, "time limit of 2 s"),
    ("start_daemon", Ending.OK, ""),
    ("start_daemon_and_crash", Ending.SIGNAL, "SIGSEGV"), ("remove_what_is_there", Ending.OK, ""),
    ("take_all_limits", Ending.NO_RESULT, "without a result"),
    ("jump_out", Ending.SIGNAL, "it crashed"), ("break_the_heap", Ending.ABORT, "SIGABRT"),
    ("crash_when_unloaded", Ending.OK, ""),
    ("stop_the_group", Ending.SIGNAL, "SIGTERM"),
)  # fmt: skip


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    library = tmp_path_factory.mktemp("calls") / "calls.so"
    command = [
        *find_compiler().command, "-O0", "-w", f"-DSLEEP={_SLEEP}", "-shared", "-fPIC", "-pthread",
        "-o", str(library),
        str(FAKES_FOLDER / "foreign_calls.c"),
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True)
    return library


def call_code(library: Path, name: str, seconds: float = 60.0):
    limits = Limits(
        seconds=seconds, memory=4 * 1024**3
    )  # far above what Python and numpy take for themselves
    return run_isolated(
        "isolated_functions:calls", [str(library), name], limits=limits, what="model.fmu"
    )


def sleepers() -> set[str]:
    """Numbers of the processes that sleep as the daemon does."""
    commands = ((item.pid, item.info["cmdline"] or []) for item in psutil.process_iter(["cmdline"]))
    return {str(number) for number, words in commands if words[:2] == ["sleep", str(_SLEEP)]}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ending", "words"), _CALLS)
def test_it_ends_as_it_should_and_leaves_nothing(
    name: str, ending: Ending, words: str, library: Path, own_place: Path
):
    before = sleepers()
    done = call_code(library, name, seconds=2.0 if ending is Ending.TIME_LIMIT else 60.0)
    assert done.ending is ending, done
    assert words in done.sentence
    assert done.strays == (1 if "daemon" in name else 0)
    assert sleepers() <= before
    assert list(own_place.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "ending"), [("throw_out", Ending.ABORT), ("refused_by_new", Ending.MEMORY_LIMIT)]
)
def test_exceptions_of_cplusplus(name: str, ending: Ending, tmp_path: Path):
    source, library = tmp_path / "throws.cpp", tmp_path / "throws.so"
    source.write_text(THROWS, encoding="utf-8")
    try:
        subprocess.run(
            ["c++", "-shared", "-fPIC", "-o", str(library), str(source)],
            check=True,
            capture_output=True,
        )
    except FileNotFoundError:
        pytest.skip("no C++ compiler")
    assert call_code(library, name).ending is ending

"""Cells that are forked from one clean process: the same session, limits, token, log and end as if each had been started alone."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import threading
import time
import uuid
from pathlib import Path

import psutil
import pytest

from validate.execution import fork_server as module
from validate.execution import reaper
from validate.execution.fork_server import ForkServer, start_fork_server
from validate.execution.process import ROOT, ForkServerError

pytestmark = [pytest.mark.process, pytest.mark.skipif(sys.platform != "linux", reason="fork servers are for Linux")]

# A cell without a request: it tells what it is in its log, and does what the folder says.
_CELL = """
import json, os, resource, signal, subprocess, sys, tempfile, time
from pathlib import Path
from validate.execution.reaper import TOKEN_VARIABLE

def main(folder):
    from validate.execution.isolated_child import die_with_parent, limit_resources
    die_with_parent()
    limit_resources(file_bytes=12345)
    told = {
        "session": os.getsid(0) == os.getpid(), "cwd": os.getcwd(), "temporary": tempfile.gettempdir(), "token": os.environ[TOKEN_VARIABLE],
        "limit": resource.getrlimit(resource.RLIMIT_FSIZE)[0], "core": resource.getrlimit(resource.RLIMIT_CORE)[0],
        "stdin": sys.stdin.fileno() == 0 and os.read(0, 1) == b"", "cpu": time.process_time(), "sympy": "sympy" in sys.modules, "torch": "torch" in sys.modules,
        "open": sorted(os.listdir("/proc/self/fd")), "hash": hash("a"),
    }
    print(json.dumps(told))
    print("to the log", file=sys.stderr)
    act = folder.name
    if act.startswith("family"):
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"], start_new_session=True)
        time.sleep(1000)
    if act.startswith("crash"):
        os.kill(os.getpid(), signal.SIGSEGV)
    if act.startswith("busy"):
        while time.process_time() < told["cpu"] + 0.4:
            pass
    if act.startswith("busy crash"):
        os.kill(os.getpid(), signal.SIGSEGV)
    if act.startswith("daemon") and os.fork() == 0:
        os.setsid()
        time.sleep(1000)
    return 7 if act.startswith("seven") else 0
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A server whose cells are _CELL."""
    package = tmp_path_factory.mktemp("package")
    (package / "told_cell.py").write_text(_CELL)
    patch = pytest.MonkeyPatch()
    patch.setenv("PYTHONPATH", str(package))
    patch.delenv(reaper.TOKEN_VARIABLE, raising=False)
    started = ForkServer(modules=(*module.MODULES, "told_cell"), task="told_cell:main")
    yield started
    started.close()
    patch.undo()


def _start(server: ForkServer, tmp_path: Path, name: str):
    folder = tmp_path / name
    (folder / "tmp").mkdir(parents=True)
    token = uuid.uuid4().hex
    return server.start(folder, token=token, temporary=folder / "tmp", log=folder / "log.txt"), folder, token


def _wait(child) -> None:
    assert child.wait(300.0)


def _told(folder: Path) -> dict:
    import json

    return json.loads((folder / "log.txt").read_text().splitlines()[0])


@pytest.mark.slow
def test_a_child_is_a_process_of_its_own(server, tmp_path):
    child, folder, token = _start(server, tmp_path, "seven")
    _wait(child)
    assert child.has_ended()
    ended = child.end()
    told = _told(folder)
    assert (ended.code, ended.strays) == (7, 0)
    assert told["session"]
    assert told["cwd"] == told["temporary"] == str(folder / "tmp")
    assert told["token"] == token
    assert (told["limit"], told["core"]) == (12345, 0)
    assert told["stdin"]
    assert told["sympy"]
    assert not told["torch"]
    assert told["cpu"] < 0.5 * ended.cpu + 0.5
    assert "to the log" in (folder / "log.txt").read_text()
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 12345


def test_children_share_nothing_but_what_was_imported(server, tmp_path):
    told = []
    for number in range(2):
        child, folder, _ = _start(server, tmp_path, f"calm{number}")
        _wait(child)
        assert child.end().code == 0
        told.append(_told(folder))
    assert told[0]["hash"] == told[1]["hash"]
    # No descriptor of one reaches the next; their numbers depend on whether the server has reaped the child before.
    assert len(told[0]["open"]) == len(told[1]["open"])
    assert told[0]["token"] != told[1]["token"]


@pytest.mark.slow
@pytest.mark.parametrize(("act", "code"), [("crash", -signal.SIGSEGV), ("busy", 0), ("busy crash", -signal.SIGSEGV)])
def test_how_it_ended_and_what_it_cost_are_told(server, tmp_path, act, code):
    """The cost as of the last look, which a worker takes 20 times a second."""
    child, folder, _ = _start(server, tmp_path, act)
    while not child.wait(0.05):
        child.look()
    ended = child.end()
    assert ended.code == code
    assert ended.memory > 10_000_000
    if "busy" in act:
        assert ended.cpu >= 0.3
    if "crash" in act:
        assert "Segmentation fault" in (folder / "log.txt").read_text()


def test_a_child_is_found_by_its_token_and_ended_with_its_family(server, tmp_path):
    child, _, token = _start(server, tmp_path, "family")
    while len(reaper.processes_with(token)) < 2:
        time.sleep(0.05)
    assert not child.has_ended()
    ended = child.end()
    assert ended.code == -signal.SIGKILL
    assert ended.strays >= 1
    assert reaper.processes_with(token) == []


def test_what_it_forks_without_starting_a_program_is_found_and_ended_though_it_has_ended(server, tmp_path):
    """A daemon that leaves its session, and whose parent nobody looked at in between."""
    child, _, token = _start(server, tmp_path, "daemon")
    _wait(child)
    assert len(reaper.processes_with(token)) == 1
    assert child.end().strays == 1
    assert reaper.processes_with(token) == []


@pytest.mark.slow
def test_a_child_ends_at_once_however_early_it_is_ended(server, tmp_path):
    """Before it has a session, or shows its token."""
    for number in range(5):
        child, _, token = _start(server, tmp_path, f"family{number}")
        assert child.end().code == -signal.SIGKILL
        assert not Path(f"/proc/{child.pid}").exists()
        assert reaper.processes_with(token) == []


def test_the_group_of_a_number_that_is_another_s_by_now_is_left_alone(server, tmp_path):
    """The server has reaped the child, and the system has given its number to somebody else."""
    child, _, _ = _start(server, tmp_path, "calm")
    _wait(child)
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"], start_new_session=True) as other:
        child.pid = other.pid
        child.end()
        assert other.poll() is None
        other.kill()


def test_nobody_s_main_module_is_run_in_a_child(tmp_path, cli_environment):
    """The script of a user who has never heard of `if __name__ == "__main__"`."""
    script = tmp_path / "script.py"
    script.write_text(_SCRIPT)
    (tmp_path / "told_cell.py").write_text(_CELL)
    environment = {**cli_environment, "PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"}
    done = subprocess.run([sys.executable, str(script)], env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("once\n7\n", 0), done.stderr


_SCRIPT = """
import pathlib, tempfile, uuid
from validate.execution.fork_server import ForkServer
print("once", flush=True)
server = ForkServer(modules=("told_cell",), task="told_cell:main")
with tempfile.TemporaryDirectory() as folder:
    folder = pathlib.Path(folder) / "seven"
    (folder / "tmp").mkdir(parents=True)
    child = server.start(folder, token=uuid.uuid4().hex, temporary=folder / "tmp", log=folder / "log.txt")
    child.wait(100.0)
    print(child.end().code, flush=True)
server.close()
"""


def test_what_starts_a_thread_makes_no_server(tmp_path, monkeypatch):
    (tmp_path / "threaded.py").write_text(
        "import threading, time\nthreading.Thread(target=time.sleep, args=(1000,), daemon=True).start()\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delenv(reaper.TOKEN_VARIABLE, raising=False)
    with pytest.raises(ForkServerError, match="a library has started threads"):
        ForkServer(modules=("threaded",))


@pytest.mark.slow
def test_ctrl_c_while_a_server_imports_is_heard_at_once(tmp_path, monkeypatch):
    (tmp_path / "slow.py").write_text("import time\ntime.sleep(1000)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delenv(reaper.TOKEN_VARIABLE, raising=False)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    known = {child.pid for child in psutil.Process().children()}
    timer = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            ForkServer(modules=("slow",))
    finally:
        timer.join()
        signal.signal(signal.SIGINT, before)
    left = [child for child in psutil.Process().children() if child.pid not in known]
    assert [child for child in left if "forkserver" in " ".join(child.cmdline())] == []


def test_children_die_with_the_server_and_the_server_with_us(tmp_path, monkeypatch):
    package = tmp_path / "package"
    package.mkdir()
    (package / "told_cell.py").write_text(_CELL)
    monkeypatch.setenv("PYTHONPATH", str(package))
    monkeypatch.delenv(reaper.TOKEN_VARIABLE, raising=False)
    server = ForkServer(modules=("validate.execution.child", "told_cell"), task="told_cell:main")
    child, _, token = _start(server, tmp_path, "family")
    os.kill(psutil.Process(child.pid).ppid(), signal.SIGKILL)
    _wait(child)
    assert child.end().code == -signal.SIGKILL
    assert reaper.processes_with(token) == []
    with pytest.raises(ForkServerError):
        _start(server, tmp_path, "calm")
    server.close()


def test_where_there_can_be_no_server_there_is_none(monkeypatch):
    assert start_fork_server(1) is None  # it would cost more than it saves
    monkeypatch.setenv(reaper.TOKEN_VARIABLE, "x" * 32)
    assert start_fork_server(100) is None  # a campaign in a task: its children carry two tokens
    monkeypatch.delenv(reaper.TOKEN_VARIABLE)
    monkeypatch.setattr(module.sys, "platform", "win32")
    assert start_fork_server(100) is None


def test_a_child_that_was_ended_says_the_same_once_more(server, tmp_path):
    child, _, _ = _start(server, tmp_path, "seven")
    _wait(child)
    assert child.end() == child.end()
    assert child.end().code == 7
    assert child.has_ended()

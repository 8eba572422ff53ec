"""Children under supervisors, forked or started alone: their session, limits, output and end, and that nothing is left of them, whoever is killed."""

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

import psutil
import pytest
from killed_campaigns import numbers_of
from standing_cluster import come

from models.errors import MachineError
from validate.campaign.engine import MODULES, preloaded_for
from validate.processes.process import Child, KeptFolder, Preloaded

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(
        sys.platform != "linux", reason="supervisors see all of their families on Linux only"
    ),
]

Start: TypeAlias = Callable[[Preloaded | None, str], tuple[Child, Path]]

_SECONDS = (
    1000 + os.getpid()
)  # that what is left sleeps: by these it is known as ours, not that of a test in another process
# A child's function: it tells what it is in its log, and does what the folder says.
_TOLD = """
import json, os, resource, signal, subprocess, sys, tempfile, time
SLEEPER = [sys.executable, "-S", "-c", "import time; time.sleep(SECONDS)"]

def main(folder):
    from validate.processes.isolated import limit_resources
    limit_resources(file_bytes=12345)
    told = {
        "number": os.getpid(), "session": os.getsid(0) == os.getpid(), "cwd": os.getcwd(), "temporary": tempfile.gettempdir(),
        "limit": resource.getrlimit(resource.RLIMIT_FSIZE)[0], "core": resource.getrlimit(resource.RLIMIT_CORE)[0],
        "stdin": sys.stdin.fileno() == 0 and os.read(0, 1) == b"", "cpu": time.process_time(), "sympy": "sympy" in sys.modules, "torch": "torch" in sys.modules,
        "open": sorted(os.listdir("/proc/self/fd")), "hash": hash("a"), "main": sys.modules["__main__"].__spec__.name,
        "blocked": sorted(signal.pthread_sigmask(signal.SIG_BLOCK, ())), "term": signal.getsignal(signal.SIGTERM) is signal.SIG_DFL,
    }
    print(json.dumps(told))
    print("to the log", file=sys.stderr)
    act = folder.name.removeprefix(".partial-")
    if act.startswith("family"):
        subprocess.Popen(SLEEPER)
        subprocess.Popen(SLEEPER, start_new_session=True)
        print("begun")
        time.sleep(1000)
    if act.startswith("busy"):
        while time.process_time() < told["cpu"] + 0.4:
            pass
    if "crash" in act:
        os.kill(os.getpid(), signal.SIGSEGV)
    if act.startswith("daemon"):  # it leaves the group, shows no environment of ours, and nobody waits for it
        between = os.fork()
        if between == 0:
            os.setsid()
            if os.fork() == 0:
                os.execve(SLEEPER[0], SLEEPER, {})
            os._exit(0)
        os.waitpid(between, 0)
    if act.startswith("fork") and os.fork() == 0:
        os.setsid()
        print(os.getpid(), flush=True)
        time.sleep(1000)
    if act.startswith("orphan"):  # it ends while its maker goes on
        middle = subprocess.run([sys.executable, "-S", "-c", "import os; print(os.fork())"], capture_output=True, text=True)
        print(max(map(int, middle.stdout.split())), "is left", flush=True)
        time.sleep(1000)
    return 7 if act.startswith("seven") else 0
""".replace("SECONDS", str(_SECONDS))


@pytest.fixture(scope="module")
def preloaded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Preloaded]:
    package = tmp_path_factory.mktemp("package")
    (package / "told_cell.py").write_text(_TOLD)
    patch = pytest.MonkeyPatch()
    patch.setenv("PYTHONPATH", str(package))
    started = Preloaded((*MODULES, "told_cell"))
    yield started
    started.close()
    patch.undo()


@pytest.fixture(params=["forked", "alone"])
def way(request: pytest.FixtureRequest, preloaded: Preloaded) -> Preloaded | None:
    """What a child's supervisor is forked from: nothing, if it is started alone."""
    return preloaded if request.param == "forked" else None


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """start(way, name): a child at work, and its folder."""
    with contextlib.ExitStack() as started:

        def begin(way: Preloaded | None, name: str) -> tuple[Child, Path]:
            folder = tmp_path / f".partial-{name}"
            (folder / "tmp").mkdir(parents=True)
            child = Child("told_cell:main", folder, output=folder / "log.txt", preloaded=way)
            started.callback(child.close)
            return child, folder

        yield begin


def _told(folder: Path) -> dict:
    return json.loads((folder / "log.txt").read_text().splitlines()[0])


def _begun(folder: Path) -> bool:
    return (folder / "log.txt").exists() and "begun" in (folder / "log.txt").read_text()


def _sleepers() -> set[int]:
    """Processes that sleep as those of _TOLD do."""
    commands = (
        (item.pid, item.info["cmdline"] or ["", ""]) for item in psutil.process_iter(["cmdline"])
    )
    return {
        number
        for number, words in commands
        if words[-1:] == [f"import time; time.sleep({_SECONDS})"]
    }


@pytest.mark.slow
def test_a_child_is_a_process_of_its_own(start, way):
    child, folder = start(way, "seven")
    assert child.wait(300.0)
    ended, told = child.end(), _told(folder)
    assert (ended.code, ended.strays) == (7, 0)
    assert told["session"]
    assert told["cwd"] == told["temporary"] == str(folder / "tmp")
    assert (told["limit"], told["core"]) == (12345, 0)
    assert told["stdin"]
    assert told["sympy"] == (way is not None)
    assert not told["torch"]
    assert (told["blocked"], told["term"]) == ([], True)
    assert told["main"] == "validate.processes.supervisor", "nobody's own script is run in a child"
    assert told["cpu"] < 0.5 * ended.cpu + 0.5
    assert "to the log" in (folder / "log.txt").read_text()
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 12345
    assert child.end() == ended, "it says the same once more"
    child.close()
    assert not folder.exists()


def test_children_share_nothing_but_what_was_imported(start, preloaded):
    told = []
    for number in range(2):
        child, folder = start(preloaded, f"calm{number}")
        assert child.wait(300.0)
        assert child.end().code == 0
        told.append(_told(folder))
    assert told[0]["hash"] == told[1]["hash"]
    assert told[0]["open"] == told[1]["open"], "no descriptor of one reaches the next"
    assert told[0]["number"] != told[1]["number"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("act", "code"), [("crash", -signal.SIGSEGV), ("busy", 0), ("busy crash", -signal.SIGSEGV)]
)
def test_how_it_ended_and_what_it_cost_are_told(start, way, act, code):
    child, folder = start(way, act)
    assert child.wait(300.0)
    ended = child.end()
    assert ended.code == code
    assert 5_000_000 < ended.memory < 1_000_000_000
    assert ended.space > ended.memory or "busy" not in act, "as of the last look"
    assert (0.4 if "busy" in act else 0.0) <= ended.cpu < 10.0
    assert ("Segmentation fault" in (folder / "log.txt").read_text()) == ("crash" in act)


def test_a_child_is_ended_with_its_family(start, way):
    before = _sleepers()
    child, folder = start(way, "family")
    come(lambda: _begun(folder))
    assert len(_sleepers() - before) == 2
    assert not child.wait(0.0)
    ended = child.end()
    assert (ended.code, ended.strays) == (-signal.SIGKILL, 2)
    assert _sleepers() <= before
    assert not psutil.pid_exists(_told(folder)["number"])


@pytest.mark.parametrize("act", ["daemon", "fork"])
def test_what_it_leaves_behind_is_found_wherever_it_went(start, way, act):
    before = _sleepers()
    child, folder = start(way, act)
    assert child.wait(300.0)
    ended = child.end()
    assert (ended.code, ended.strays) == (0, 1)
    assert _sleepers() <= before
    assert not any(
        psutil.pid_exists(int(line))
        for line in (folder / "log.txt").read_text().splitlines()
        if line.isdigit()
    )


def test_what_was_left_and_has_ended_is_not_kept_as_a_zombie(start, way):
    """A child may leave thousands, and go on: the system counts them all."""
    child, folder = start(way, "orphan")
    come(
        lambda: (
            "is left" in (folder / "log.txt").read_text()
            if (folder / "log.txt").exists()
            else False
        )
    )
    left = next(
        int(line.split()[0])
        for line in (folder / "log.txt").read_text().splitlines()
        if "is left" in line
    )
    come(lambda: not psutil.pid_exists(left))
    assert not child.wait(0.0)
    ended = child.end()
    assert (ended.code, ended.strays) == (-signal.SIGKILL, 0)


@pytest.mark.slow
def test_a_child_ends_at_once_however_early_it_is_ended(start, way):
    for number in range(5):
        child, folder = start(way, f"family{number}")
        assert child.end().code == -signal.SIGKILL
        child.close()
        assert not folder.exists()


@pytest.mark.slow
def test_a_killed_supervisor_takes_its_child_with_it(start, way):
    """Of what the child has started, what shows where its temporary files are is found."""
    before = _sleepers()
    child, folder = start(way, "family")
    come(lambda: _begun(folder))
    supervisor = psutil.Process(_told(folder)["number"]).ppid()
    assert supervisor != os.getpid()
    os.kill(supervisor, signal.SIGKILL)
    assert child.wait(300.0)
    ended = child.end()
    assert ended.code == -signal.SIGKILL
    assert ended.strays >= 2
    come(lambda: _sleepers() <= before)
    come(lambda: not psutil.pid_exists(_told(folder)["number"]))
    child.close()
    assert not folder.exists()


_PARENT = """
import sys, time
from pathlib import Path
from validate.processes.process import Child, KeptFolder, Preloaded
kind, folder = sys.argv[1], Path(sys.argv[2])
preloaded = Preloaded(("told_cell",)) if kind == "forked" else None
kept = KeptFolder(Path(sys.argv[3]))
child = Child("told_cell:main", folder, output=folder / "log.txt", preloaded=preloaded)
time.sleep(1000)
"""


@pytest.mark.parametrize("kind", ["forked", "alone"])
def test_nothing_is_left_when_we_are_killed(tmp_path, cli_environment, kind):
    (tmp_path / "told_cell.py").write_text(_TOLD)
    folder, kept, other = (
        tmp_path / ".partial-family",
        tmp_path / ".partial-kept",
        tmp_path / "other",
    )
    for made in (folder, kept, other, folder / "tmp"):
        made.mkdir()
    before, mark = _sleepers(), f"test={tmp_path}"
    environment = {
        **cli_environment,
        "PYTHONPATH": f"{Path(__file__).parents[3]}{os.pathsep}{tmp_path}",
        "TEST_MARK": mark,
    }
    with subprocess.Popen(
        [sys.executable, "-c", _PARENT, kind, str(folder), str(kept)], env=environment
    ) as parent:
        come(lambda: _begun(folder))
        parent.kill()
    come(
        lambda: (
            not numbers_of(mark.encode())
            and _sleepers() <= before
            and not folder.exists()
            and not kept.exists()
        )
    )
    assert other.exists()


def test_a_folder_whose_name_says_that_it_is_finished_is_not_removed_by_a_supervisor(tmp_path):
    """Whatever is asked of it."""
    kept = KeptFolder(tmp_path)
    kept._channel.close()
    kept._supervisor.wait()
    assert tmp_path.exists()


def test_children_outlive_what_they_were_forked_from_and_others_are_started_alone(
    start, tmp_path, monkeypatch
):
    (tmp_path / "told_cell.py").write_text(_TOLD)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    preloaded = Preloaded(("told_cell",))
    first, folder = start(preloaded, "family")
    come(lambda: _begun(folder))
    preloaded.close()
    assert not first.wait(0.2)
    first.end()
    second, _ = start(preloaded, "seven")
    assert second.wait(300.0)
    assert second.end().code == 7


def test_what_starts_a_thread_is_forked_from_by_nobody(tmp_path, monkeypatch):
    (tmp_path / "threaded.py").write_text(
        "import threading, time\nthreading.Thread(target=time.sleep, args=(1000,), daemon=True).start()\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(MachineError, match="a library has started threads"):
        Preloaded(("threaded",))


@pytest.mark.slow
def test_ctrl_c_while_modules_are_imported_is_heard_at_once(tmp_path, monkeypatch):
    (tmp_path / "slow.py").write_text("import time\ntime.sleep(1000)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    known = {child.pid for child in psutil.Process().children()}
    timer = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    began = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            Preloaded(("slow",))
    finally:
        timer.join()
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - began < 500.0
    assert [child for child in psutil.Process().children() if child.pid not in known] == []


def test_where_it_would_cost_more_than_it_saves_nothing_is_preloaded(monkeypatch):
    assert preloaded_for(1) is None
    monkeypatch.setattr(sys, "platform", "darwin")
    assert preloaded_for(100) is None

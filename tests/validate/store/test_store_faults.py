"""Disks that refuse: at each thing the store asks of the system, one after the other, what is said of it, and of which errors; and campaigns that write into one folder at once."""

import builtins
import errno
import itertools
import json
import os
import shutil
import socket
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from models.errors import MachineError
from models.results.run import RunRecord
from models.results.stored import to_json
from tests.reports import record_factory as factory
from validate.campaign.campaign import run_campaign
from validate.campaign.runs import CampaignSettings
from validate.cli.narrator import PlainNarrator
from validate.processes import disk as disk_module
from validate.processes.disk import (
    aside_name,
    disk_error,
    disk_refuses,
    make_folder,
    no_temporary_folder,
    raise_if_disk_ended,
    remove,
    write_durably,
)
from validate.store import store as store_module
from validate.store.store import RECORD, Store

FAKES = {
    "plugin": "campaign_fakes:PLUGIN",
    "scenes": ("three_cart",),
    "expression": "only_good or only_refuses",
}
RUN = factory.runs()[0]
_ASKED = ("rename", "replace", "fsync", "mkdir", "open", "unlink")


class Disk:
    """Counts what is asked of the system, and refuses the request of one number."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, below: Path) -> None:
        self._below, self._open = str(below), builtins.open
        self.asked, self.refused_at, self.error = 0, -1, errno.ENOSPC
        for name in _ASKED:
            monkeypatch.setattr(os, name, self._refusing(name, getattr(os, name)))
        monkeypatch.setattr(disk_module, "open", self._file, raising=False)

    def refuse(self, number: int, error: int) -> None:
        self.asked, self.refused_at, self.error = 0, number, error

    def _count(self, what: str) -> None:
        self.asked += 1
        if self.asked == self.refused_at:
            raise OSError(self.error, os.strerror(self.error), what)

    def _refusing(self, name: str, function: Callable) -> Callable:
        def asked(first, *rest, **named):
            if name == "fsync" or str(first).startswith(self._below):
                self._count(name)
            return function(first, *rest, **named)

        return asked

    def _file(self, path, *arguments, **named):
        """A file whose writing is refused, half done."""
        file = self._open(path, *arguments, **named)
        write = file.write

        def refusing(text: str) -> int:
            try:
                self._count("write")
            except OSError:
                write(text[: len(text) // 2])
                raise
            return write(text)

        file.write = refusing
        return file


@pytest.fixture
def disk(monkeypatch, tmp_path) -> Disk:
    return Disk(monkeypatch, tmp_path)


def record(message: str) -> RunRecord:
    return replace(RUN, message=message)


def _put(store: Store, record: RunRecord) -> None:
    """As a Worker does it."""
    partial = store.open_partial(record.key, uuid.uuid4().hex)
    try:
        write_durably(partial / RECORD, to_json(record))
        write_durably(partial / "log.txt", "")
        store.commit(partial, record.key)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _refusals(disk: Disk, act: Callable[[], object]) -> Iterator[int]:
    """Do it with each of its requests refused in turn, by a full disk and by one that can only be read; the last time nothing is refused."""
    for error in (errno.ENOSPC, errno.EROFS):
        for number in itertools.count(1):
            disk.refuse(number, error)
            refused = _refused(act)
            if disk.asked < number:
                assert refused is None
                break
            if refused is not None:  # else it could do without
                assert refused.exit_code == 3
                assert "\n" not in str(refused)
                assert ("the disk is full" if error == errno.ENOSPC else "read-only") in str(
                    refused
                )
            yield number


def _refused(act: Callable[[], object]) -> MachineError | None:
    try:
        act()
    except MachineError as error:
        return error
    return None


@pytest.mark.slow
def test_an_older_run_outlives_every_refusal(tmp_path, disk):
    store, old, new = Store(tmp_path), record("old"), record("new")
    store.prepare()
    _put(store, old)
    requests = 0
    for _ in _refusals(disk, lambda: _put(store, new)):
        requests += 1
        assert store.read(old.key) in (old, new)
        disk.refuse(-1, 0)
        _put(store, old)
        names = [path.name for path in (tmp_path / "runs").iterdir()]
        assert [name for name in names if not name.endswith("-old")] == [
            old.key
        ]  # that removing was refused is left to the next campaign
    assert requests >= 2 * 10
    assert store.read(old.key) == new


def test_a_text_is_the_old_one_or_the_new_one_whatever_is_refused(tmp_path, disk):
    path = tmp_path / "results.csv"
    write_durably(path, "old")
    for _ in _refusals(disk, lambda: write_durably(path, "new")):
        assert path.read_text() in ("old", "new")
        disk.refuse(-1, 0)
        write_durably(path, "old")
        assert [item.name for item in tmp_path.iterdir()] == ["results.csv"]


@pytest.mark.slow
def test_a_campaign_that_is_refused_anything_loses_nothing(cli, tmp_path, disk):
    """Everything is stored; each request of writing the campaign's own files is refused in turn."""
    settings = CampaignSettings(out=tmp_path / "out", **FAKES)
    words = ("--plugin", settings.plugin, "--scene", *settings.scenes, "-k", settings.expression)
    assert cli("all", *words, "--out", str(settings.out)).returncode == 0
    results = (settings.out / "results.csv").read_bytes()
    records = {path: path.read_bytes() for path in settings.out.glob("runs/*/record.json")}
    assert len(records) == 2
    (settings.out / "checks.csv").write_text("of an earlier campaign")  # is to be removed
    for _ in _refusals(disk, lambda: run_campaign(settings, PlainNarrator())):
        assert (settings.out / "results.csv").read_bytes() == results
        assert {
            path: path.read_bytes() for path in settings.out.glob("runs/*/record.json")
        } == records
        assert [path for path in settings.out.rglob(".*") if path.is_file()] == []


def test_a_run_that_was_to_be_replaced_when_the_campaign_was_killed_is_put_back(tmp_path):
    store, old = Store(tmp_path), record("old")
    store.prepare()
    _put(store, old)
    gone = f".partial-{old.key[:12]}-token-{2**22 + 1}-{store_module.socket.gethostname()}"
    (tmp_path / "runs" / old.key).rename(tmp_path / "runs" / f"{gone}-old")
    (tmp_path / "runs" / gone).mkdir()
    assert store.read(old.key) is None
    store.prepare()
    assert store.read(old.key) == old
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [old.key]


@pytest.mark.parametrize("key", ["../escaped", "..", ".partial-x", 7, None])
def test_what_is_put_back_stays_in_the_store(tmp_path, key):
    runs = tmp_path / "out" / "runs"
    left = runs / f".partial-k-t-{2**22 + 1}-{store_module.socket.gethostname()}-old"
    left.mkdir(parents=True)
    (left / RECORD).write_text(json.dumps({"key": key}))
    Store(tmp_path / "out").prepare()
    assert list(runs.iterdir()) == []
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_many_may_store_the_same_cell_at_once(tmp_path):
    """Four threads stand for four campaigns; a fifth reads what is there."""
    store, runs = Store(tmp_path), [record(f"of campaign {number}") for number in range(4)]
    store.prepare()
    problems: list[BaseException] = []
    ready = threading.Barrier(len(runs))

    def campaign(number: int) -> None:
        ready.wait()
        try:
            for turn in range(25):
                partial = store.open_partial(runs[number].key, f"token{number}x{turn}")
                (partial / RECORD).write_text(to_json(runs[number]))
                store.commit(partial, runs[number].key)
        except BaseException as error:  # noqa: BLE001 - told below, in the thread of the test
            problems.append(error)

    threads = [threading.Thread(target=campaign, args=(number,)) for number in range(len(runs))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert problems == []
    assert store.read(runs[0].key) in runs
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [runs[0].key]


REFUSE = {
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EIO,
    errno.EFBIG,
    errno.ENOTDIR,
}
END = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO}
ALL = {*REFUSE, errno.ENOENT, errno.EEXIST, errno.EINVAL}


def problem(number: int, name: str | None = None) -> OSError:
    return OSError(number, os.strerror(number), name)


@pytest.mark.parametrize("number", sorted(ALL))
def test_which_errors_are_of_the_disk(number: int, tmp_path: Path):
    assert disk_refuses(problem(number)) is (number in REFUSE)
    if number in END:
        with pytest.raises(MachineError):
            raise_if_disk_ended(tmp_path, problem(number))
    else:
        raise_if_disk_ended(tmp_path, problem(number))


@pytest.mark.parametrize("number", sorted(ALL))
def test_a_full_disk_is_called_full_and_any_other_by_its_own_words(number: int, tmp_path: Path):
    said = str(disk_error(tmp_path / "file", problem(number)))
    full = number in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
    assert f"{tmp_path / 'file'} (" in said
    assert ("the disk is full" in said) is full
    assert (os.strerror(number).lower() in said) is not full
    assert "is gone" not in said
    assert disk_error(tmp_path, problem(number)).exit_code == 3


def test_words_of_an_error_without_a_number_are_its_text(tmp_path: Path):
    assert "(broken pipe of mine)" in str(disk_error(tmp_path, OSError("Broken pipe of mine")))


def test_a_folder_that_is_gone_is_said_so(tmp_path: Path):
    gone = tmp_path / "gone" / "file"
    assert "its folder is gone" in str(disk_error(gone, problem(errno.ENOENT)))
    assert "its folder is gone" not in str(disk_error(gone, problem(errno.EACCES)))


def test_what_an_error_came_of_counts_too(tmp_path: Path):
    """The cause that was stated, else what was handled at the time.

    The file that it names, else that of the task.
    """
    inner = problem(errno.ENOSPC, "/full/inner")
    for link in ("__cause__", "__context__"):
        outer = ValueError("a plan")
        setattr(outer, link, RuntimeError("between"))
        setattr(getattr(outer, link), link, inner)
        with pytest.raises(MachineError, match="/full/inner") as caught:
            raise_if_disk_ended(tmp_path, outer)
        assert caught.value.__cause__ is outer
    raise_if_disk_ended(tmp_path, ValueError("a plan"))
    with pytest.raises(MachineError, match=str(tmp_path)):
        raise_if_disk_ended(tmp_path, problem(errno.EIO))


@pytest.mark.parametrize(
    ("file", "named"), [("/tmp/there", ": /tmp/there)"), (None, f"({os.strerror(errno.ENOSPC)})")]
)
def test_no_temporary_folder_names_what_it_knows(
    file: str | None, named: str, monkeypatch: pytest.MonkeyPatch
):
    said = str(no_temporary_folder(problem(errno.ENOSPC, file)))
    assert named in said
    assert "TMPDIR" in said
    assert "no word of the system" in str(no_temporary_folder(OSError("no word of the system")))

    def refuse(**_: object) -> None:
        raise problem(errno.ENOSPC, file)

    monkeypatch.setattr(tempfile, "TemporaryDirectory", refuse)
    with pytest.raises(MachineError) as caught, disk_module.temporary_folder("x"):
        pass
    assert str(caught.value) == said


def test_what_cannot_be_tidied_spoils_no_answer(monkeypatch: pytest.MonkeyPatch):
    tidy = tempfile.TemporaryDirectory.cleanup

    def refuse(folder: tempfile.TemporaryDirectory) -> None:
        tidy(folder)
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(tempfile.TemporaryDirectory, "cleanup", refuse)
    with disk_module.temporary_folder("x") as folder:
        answer = folder.exists()
    assert answer


def test_a_temporary_folder_is_gone_afterwards():
    with disk_module.temporary_folder("named-") as folder:
        assert folder.is_dir()
        assert folder.name.startswith("named-")
    assert not folder.exists()


def test_a_refusal_names_the_file_it_was_about(tmp_path: Path):
    file = tmp_path / "file"
    file.write_text("old")
    for refused in (
        lambda: make_folder(file / "below"),
        lambda: write_durably(file / "below", "x"),
        lambda: remove(tmp_path),
    ):
        with pytest.raises(MachineError, match=str(tmp_path)) as caught:
            refused()
        assert isinstance(caught.value.__cause__, OSError)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_texts_and_bytes_are_written_and_removed(tmp_path: Path):
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    for content in ("naïve", "naïve".encode()):
        write_durably(tmp_path / "a" / "file", content)
        assert (tmp_path / "a" / "file").read_bytes() == "naïve".encode()
    remove(tmp_path / "a" / "file")
    remove(tmp_path / "a" / "file")
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b"]


def test_what_is_aside_says_whose_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    replaced: list[Path] = []
    monkeypatch.setattr(os, "replace", lambda unfinished, path: replaced.append(unfinished))
    write_durably(tmp_path / "file", "x")
    assert replaced[0].parent == tmp_path
    assert replaced[0].name.startswith(".partial-file-")
    assert (
        aside_name("what", "token") == f".partial-what-token-{os.getpid()}-{socket.gethostname()}"
    )


def test_ctrl_c_in_the_middle_of_a_write_leaves_the_old_text_and_nothing_else(
    tmp_path, monkeypatch
):
    write_durably(tmp_path / "file", "old")

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    for stage in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(disk_module.os, stage, interrupted)
            with pytest.raises(KeyboardInterrupt):
                write_durably(tmp_path / "file", "new")
        assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]

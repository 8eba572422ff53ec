"""What is said of a disk that refuses, and of which errors it is said."""

import errno
import os
import socket
import tempfile
from pathlib import Path

import pytest

from models.errors import MachineError
from validate.store import disk
from validate.store.disk import (
    aside_name,
    disk_error,
    disk_refuses,
    make_folder,
    no_temporary_folder,
    raise_if_disk_ended,
    remove,
    write_durably,
)

REFUSE = {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG, errno.ENOTDIR}
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
    """The cause that was stated, else what was handled at the time; the file that it names, else that of the task."""
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


@pytest.mark.parametrize(("file", "named"), [("/tmp/there", ": /tmp/there)"), (None, f"({os.strerror(errno.ENOSPC)})")])
def test_no_temporary_folder_names_what_it_knows(file: str | None, named: str, monkeypatch: pytest.MonkeyPatch):
    said = str(no_temporary_folder(problem(errno.ENOSPC, file)))
    assert named in said
    assert "TMPDIR" in said
    assert "no word of the system" in str(no_temporary_folder(OSError("no word of the system")))

    def refuse(**_: object) -> None:
        raise problem(errno.ENOSPC, file)

    monkeypatch.setattr(tempfile, "TemporaryDirectory", refuse)
    with pytest.raises(MachineError) as caught, disk.temporary_folder("x"):
        pass
    assert str(caught.value) == said


def test_a_temporary_folder_is_gone_afterwards():
    with disk.temporary_folder("named-") as folder:
        assert folder.is_dir()
        assert folder.name.startswith("named-")
    assert not folder.exists()


def test_a_refusal_names_the_file_it_was_about(tmp_path: Path):
    file = tmp_path / "file"
    file.write_text("old")
    for refused in (lambda: make_folder(file / "below"), lambda: write_durably(file / "below", "x"), lambda: remove(tmp_path)):
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
    assert aside_name("what", "token") == f".partial-what-token-{os.getpid()}-{socket.gethostname()}"

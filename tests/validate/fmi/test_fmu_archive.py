"""What is let in as an FMU: every other file is refused by its own sentence, before anything is unpacked."""

from __future__ import annotations

import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from models.catalog import load_scene
from models.fmu import build_fmu
from validate.fmi.archive import CHECKS, DESCRIPTION, ArchiveError, ArchiveLimits, check_archive, problems, unpack

GOOD = '<fmiModelDescription fmiVersion="2.0"><CoSimulation modelIdentifier="m"/></fmiModelDescription>'
LIBRARY = "binaries/linux64/m.so"


def write(path: Path, entries: dict[str, bytes | str], change: Callable[[zipfile.ZipInfo], None] | None = None) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            item = zipfile.ZipInfo("entry")
            item.filename = item.orig_filename = name  # as it is: the constructor tidies names
            item.compress_type = zipfile.ZIP_DEFLATED
            if change is not None and name not in (DESCRIPTION, LIBRARY):
                change(item)
            archive.writestr(item, data)
    return path


def link(item: zipfile.ZipInfo) -> None:
    item.create_system, item.external_attr = 3, (stat.S_IFLNK | 0o777) << 16


def pipe(item: zipfile.ZipInfo) -> None:
    item.create_system, item.external_attr = 3, (stat.S_IFIFO | 0o644) << 16


def test_ours_is_let_in_and_unpacked(tmp_path: Path):
    archive = check_archive(build_fmu(load_scene("three_cart")))
    identifiers = {kind: interface["modelIdentifier"] for kind, interface in archive.kinds.items()}
    assert (archive.version, identifiers) == ("2.0", {"ModelExchange": "three_cart", "CoSimulation": "three_cart"})
    assert archive.platforms == ("linux64",)
    unpack(archive, tmp_path)
    assert sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file()) == archive.unpacked
    assert problems(archive.path) == ()


@pytest.mark.parametrize("version", ["3.0", "3.0.1", "3.0-rc.1"])
def test_fmi_3_has_other_names_for_platforms(tmp_path: Path, version: str):
    text = GOOD.replace('"2.0"', f'"{version}"')
    assert (
        check_archive(write(tmp_path / "m.fmu", {DESCRIPTION: text, "binaries/x86_64-linux/m.so": b"x"})).kinds["CoSimulation"][
            "modelIdentifier"
        ]
        == "m"
    )
    with pytest.raises(ArchiveError, match=r"no binary for this machine .*m\.so\).*linux64"):
        check_archive(write(tmp_path / "old.fmu", {DESCRIPTION: text, LIBRARY: b"x"}))


@pytest.mark.parametrize(
    ("extra", "change", "check", "words"),
    [
        ({"../evil": ""}, None, "names", "leads out of its folder"),
        ({"a/../../evil": ""}, None, "names", "leads out of its folder"),
        ({"/etc/evil": ""}, None, "names", "absolute path"),
        ({"C:/evil": ""}, None, "names", "absolute path"),
        ({"a\\b": ""}, None, "names", "backslash"),
        ({"link": "/etc/passwd"}, link, "links", "symbolic link"),
        ({"pipe": ""}, pipe, "links", "neither a file nor a folder"),
        ({"a": "", "a/b": ""}, None, "duplicates", "both a file and the folder"),
        ({"resources/zero": bytes(64 * 1024**2)}, None, "ratio", "zip bomb"),
        ({"x.xml": '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><x>&e;</x>'}, None, "xml", "x.xml has a DOCTYPE"),
        ({"terminalsAndIcons/terminalsAndIcons.xml": '<!DOCTYPE x><x/>'.encode("utf-16")}, None, "xml", "DOCTYPE"),
    ],
)  # fmt: skip
def test_unsafe_entries_are_refused(tmp_path: Path, extra, change, check: str, words: str):
    path = write(tmp_path / "m.fmu", {DESCRIPTION: GOOD, LIBRARY: b"x", **extra}, change)
    with pytest.raises(ArchiveError, match=words) as caught:
        check_archive(path)
    assert (caught.value.check, check in CHECKS) == (check, True)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("entries", "check", "words"),
    [
        ({LIBRARY: b"x"}, "description", "it has no modelDescription.xml, so it is no FMU"),
        ({f"m/{DESCRIPTION}": GOOD}, "description", "must lie at the top"),
        ({DESCRIPTION: "<fmiModelDescription", LIBRARY: b"x"}, "description", "not well-formed"),
        ({DESCRIPTION: "", LIBRARY: b"x"}, "description", "not well-formed"),
        ({DESCRIPTION: "<html/>", LIBRARY: b"x"}, "description", "begins with <html>"),
        ({DESCRIPTION: GOOD.replace("2.0", "1.0"), LIBRARY: b"x"}, "version", "FMI version '1.0'; 2.0 and 3.0"),
        ({DESCRIPTION: GOOD.replace("2.0", "2.1"), LIBRARY: b"x"}, "version", "'2.1'"),
        ({DESCRIPTION: GOOD.replace("CoSimulation", "Simulation"), LIBRARY: b"x"}, "kind", "neither Model Exchange nor Co-Simulation"),
        ({DESCRIPTION: GOOD}, "binary", "it has none at all"),
        ({DESCRIPTION: GOOD, "binaries/win64/m.dll": b"x"}, "binary", "it has win64"),
        ({DESCRIPTION: GOOD, "binaries/linux64/other.so": b"x"}, "binary", r"binaries/linux64/m\.so"),
    ],
)
def test_what_is_no_fmu_for_this_machine_is_refused(tmp_path: Path, entries, check: str, words: str):
    with pytest.raises(ArchiveError, match=words) as caught:
        check_archive(write(tmp_path / "m.fmu", entries))
    assert caught.value.check == check


def test_files_that_are_no_zip(tmp_path: Path):
    good = write(tmp_path / "good.fmu", {DESCRIPTION: GOOD, LIBRARY: b"x" * 5000})
    cases = {"text": b"no zip", "empty": b"", "cut": good.read_bytes()[:-40]}
    for name, data in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ArchiveError, match="not a zip file"):
            check_archive(tmp_path / name)
    with pytest.raises(ArchiveError, match="no such file"):
        check_archive(tmp_path / "absent.fmu")
    with pytest.raises(ArchiveError, match="it is a folder"):
        check_archive(tmp_path)


def test_a_damaged_entry_is_a_sentence(tmp_path: Path):
    path = write(tmp_path / "m.fmu", {DESCRIPTION: GOOD, LIBRARY: bytes(range(256)) * 40})
    data = bytearray(path.read_bytes())
    at = data.index(LIBRARY.encode()) + len(LIBRARY) + 20
    data[at : at + 30] = bytes(30)
    path.write_bytes(data)
    with pytest.raises(ArchiveError, match="damaged"):
        unpack(check_archive(path), tmp_path / "out")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_duplicates_and_counts(tmp_path: Path):
    path = tmp_path / "m.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for name in (DESCRIPTION, LIBRARY, LIBRARY):
            archive.writestr(name, GOOD)
    with pytest.raises(ArchiveError, match="is there 2 times"):
        check_archive(path)
    many = write(tmp_path / "many.fmu", {DESCRIPTION: GOOD, LIBRARY: b"x", **{f"f{n}": "" for n in range(20)}})
    with pytest.raises(ArchiveError, match="22 files, more than the 10"):
        check_archive(many, ArchiveLimits(entries=10))
    with pytest.raises(ArchiveError, match="unpacked it has"):
        check_archive(many, ArchiveLimits(unpacked=10))


def test_all_problems_of_a_file_are_listed(tmp_path: Path):
    path = write(tmp_path / "m.fmu", {DESCRIPTION: GOOD, LIBRARY: b"x", "../a": "", "b\\c": "", "/d": ""})
    assert [problem.check for problem in problems(path)] == ["names", "names", "names"]

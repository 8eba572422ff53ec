"""What is let in as an FMU: every other file is refused by its own sentence, before anything is unpacked."""

import hashlib
import stat
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from models.catalog import load_scene
from models.errors import MachineError
from models.fmu import build_fmu
from validate.fmi import archive as module
from validate.fmi.archive import (
    DESCRIPTION,
    ArchiveError,
    FmuArchive,
    FmuError,
    binary_name,
    check_archive,
    interfaces,
    problems,
    unpack,
)
from validate.fmi.description import read_package, unpacked

GOOD = '<fmiModelDescription fmiVersion="2.0"><CoSimulation modelIdentifier="m"/></fmiModelDescription>'
LIBRARY = "binaries/linux64/m.so"


def write(
    path: Path,
    entries: dict[str, bytes | str],
    change: Callable[[zipfile.ZipInfo], None] | None = None,
) -> Path:
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
    assert (archive.version, identifiers) == (
        "2.0",
        {"ModelExchange": "three_cart", "CoSimulation": "three_cart"},
    )
    unpack(archive, tmp_path)
    assert (
        sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
        == archive.unpacked
    )
    assert problems(archive.path) == ()


@pytest.mark.parametrize("version", ["3.0", "3.0.1"])
def test_fmi_3_has_other_names_for_platforms(tmp_path: Path, version: str):
    text = GOOD.replace('"2.0"', f'"{version}"')
    assert (
        check_archive(
            write(tmp_path / "m.fmu", {DESCRIPTION: text, "binaries/x86_64-linux/m.so": b"x"})
        ).kinds["CoSimulation"]["modelIdentifier"]
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
        ({"a": "", "a/b": ""}, None, "names", "both a file and the folder"),
        ({"resources/zero": bytes(64 * 1024**2)}, None, "ratio", "zip bomb"),
        (
            {
                "x.xml": '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><x>&e;</x>'
            },
            None,
            "xml",
            "x.xml has a DOCTYPE",
        ),
        (
            {"terminalsAndIcons/terminalsAndIcons.xml": "<!DOCTYPE x><x/>".encode("utf-16")},
            None,
            "xml",
            "DOCTYPE",
        ),
    ],
)
def test_unsafe_entries_are_refused(tmp_path: Path, extra, change, check: str, words: str):
    path = write(tmp_path / "m.fmu", {DESCRIPTION: GOOD, LIBRARY: b"x", **extra}, change)
    with pytest.raises(ArchiveError, match=words) as caught:
        check_archive(path)
    assert caught.value.check == check
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("entries", "check", "words"),
    [
        ({LIBRARY: b"x"}, "description", "no modelDescription.xml"),
        ({f"m/{DESCRIPTION}": GOOD}, "description", "must lie at the top"),
        ({DESCRIPTION: "<fmiModelDescription", LIBRARY: b"x"}, "description", "not well-formed"),
        ({DESCRIPTION: "", LIBRARY: b"x"}, "description", "not well-formed"),
        ({DESCRIPTION: "<html/>", LIBRARY: b"x"}, "description", "begins with <html>"),
        ({DESCRIPTION: GOOD.replace("2.0", "1.0"), LIBRARY: b"x"}, "version",
         "FMI version '1.0'; 2.0 and 3.0"),
        ({DESCRIPTION: GOOD.replace("2.0", "2.1"), LIBRARY: b"x"}, "version", "'2.1'"),
        ({DESCRIPTION: GOOD.replace("CoSimulation", "Simulation"), LIBRARY: b"x"}, "kind",
         "neither Model Exchange nor Co-Simulation"),
        ({DESCRIPTION: GOOD}, "binary", "it has none at all"),
        ({DESCRIPTION: GOOD, "binaries/win64/m.dll": b"x"}, "binary", "it has win64"),
        ({DESCRIPTION: GOOD, "binaries/linux64/other.so": b"x"}, "binary",
         r"binaries/linux64/m\.so"),
    ],
)  # fmt: skip
def test_what_is_no_fmu_for_this_machine_is_refused(
    tmp_path: Path, entries, check: str, words: str
):
    with pytest.raises(ArchiveError, match=words) as caught:
        check_archive(write(tmp_path / "m.fmu", entries))
    assert caught.value.check == check


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize(
    "identifier", ["", "x.y", "a b;touch X", "../../../x", "1st", "m\u00fc", "m" * 250, "m/m", None]
)
def test_an_identifier_that_is_none_of_c_is_refused_before_a_path_is_made_of_it(
    tmp_path: Path, version: str, identifier: str | None
):
    good = GOOD.replace('"2.0"', f'"{version}"').replace("</fmi", "<ModelVariables/></fmi")
    other = "" if identifier is None else f' modelIdentifier="{identifier}"'
    alone = good.replace(' modelIdentifier="m"', other)
    library = {binary_name(version, "m"): b"x"}
    with pytest.raises(
        ArchiveError,
        match=r"modelIdentifier is .*; expected a C identifier .*\(FMI 2.0.4, 2.3; 3.0.2, 2.5.1\)",
    ) as caught:
        read_package(write(tmp_path / "alone.fmu", {DESCRIPTION: alone, **library}))
    assert caught.value.check == "identifier"
    assert len(str(caught.value)) < 400
    for hidden in (
        good.replace("<Model", f"<CoSimulation{other}/><Model"),
        good.replace("</fmi", f"<CoSimulation{other}/></fmi"),
    ):
        with pytest.raises(FmuError, match="modelIdentifier is "):
            read_package(write(tmp_path / "hidden.fmu", {DESCRIPTION: hidden, **library}))


def test_the_longest_identifier_is_that_of_the_longest_name_of_a_file(tmp_path: Path):
    name = "_" + "m1" * 124
    text = GOOD.replace('"m"', f'"{name}"').replace("</fmi", "<ModelVariables/></fmi")
    package = read_package(
        write(tmp_path / "m.fmu", {DESCRIPTION: text, binary_name("2.0", name): b"x"})
    )
    with unpacked(package) as ready:
        assert ready.folder is not None
        assert (ready.folder / binary_name("2.0", name)).is_file()


@pytest.mark.parametrize(
    ("version", "inside", "words"),
    [
        (
            "3.0",
            '<ModelVariables/><ModelStructure><Output valueReference="7"/></ModelStructure>',
            "names the value reference 7, which no variable has",
        ),
        (
            "2.0",
            '<ModelVariables/><ModelStructure><Outputs><Unknown index="1"/></Outputs></ModelStructure>',
            "names a variable by an index that is none",
        ),
        (
            "3.0",
            '<ModelVariables><Float64 name="x" valueReference="abc"/></ModelVariables>',
            "has 'abc' where a number must be",
        ),
        (
            "3.0",
            '<ModelVariables><Float64 name="x" valueReference="4294967296"/></ModelVariables>',
            "'x' has the value reference 4294967296; expected",
        ),
        (
            "3.0",
            '<ModelVariables><Float64 name="x" valueReference="-1"/></ModelVariables>',
            "'x' has the value reference -1; expected",
        ),
        (
            "3.0",
            '<ModelVariables><Float64 name="x"/></ModelVariables>',
            "lacks an element or attribute that must be there",
        ),
        (
            "2.0",
            '<ModelVariables><ScalarVariable name="x" valueReference="0"/></ModelVariables>',
            "lacks an element or attribute",
        ),
        ("3.0", "", "lacks an element or attribute"),
        (
            "3.0",
            '<ModelVariables><Odd name="x" valueReference="0"/></ModelVariables>',
            "has 'Odd', which FMI does not know",
        ),
        (
            "3.0",
            '<ModelVariables><Float64 name="x" valueReference="0" declaredType="no"/></ModelVariables>',
            'cannot be understood: Variable "x"',
        ),
    ],
)
def test_a_description_that_is_not_understood_is_told_without_the_words_of_python(
    tmp_path: Path, version: str, inside: str, words: str
):
    text = GOOD.replace('"2.0"', f'"{version}"').replace("</fmi", f"{inside}</fmi")
    with pytest.raises(FmuError, match=f"modelDescription.xml:? {words}") as caught:
        read_package(
            write(tmp_path / "m.fmu", {DESCRIPTION: text, binary_name(version, "m"): b"x"})
        )
    assert "Error" not in str(caught.value)


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


def test_what_is_dangerous_is_told_before_what_is_damaged_behind_it(tmp_path: Path):
    path = write(
        tmp_path / "m.fmu",
        {
            DESCRIPTION: GOOD,
            LIBRARY: b"x",
            "a.xml": "<!DOCTYPE x><x/>",
            "b.xml": bytes(range(256)) * 40,
        },
    )
    data = bytearray(path.read_bytes())
    at = data.index(b"b.xml") + len("b.xml") + 20
    data[at : at + 30] = bytes(30)
    path.write_bytes(data)
    with pytest.raises(ArchiveError, match=r"a\.xml has a DOCTYPE") as refused:
        check_archive(path)
    assert refused.value.check == "xml", "its report has rows"


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_duplicates_and_counts(tmp_path: Path):
    path = tmp_path / "m.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for name in (DESCRIPTION, LIBRARY, LIBRARY):
            archive.writestr(name, GOOD)
    with pytest.raises(ArchiveError, match="is there 2 times"):
        check_archive(path)
    many = write(
        tmp_path / "many.fmu",
        {DESCRIPTION: GOOD, LIBRARY: b"x", **{f"f{n}": "" for n in range(20)}},
    )
    with pytest.raises(ArchiveError, match="22 files, more than the 10"), limited(MOST_ENTRIES=10):
        check_archive(many)
    with pytest.raises(ArchiveError, match="unpacked it has"), limited(MOST_UNPACKED=10):
        check_archive(many)


def test_all_problems_of_a_file_are_listed(tmp_path: Path):
    path = write(
        tmp_path / "m.fmu", {DESCRIPTION: GOOD, LIBRARY: b"x", "../a": "", "b\\c": "", "/d": ""}
    )
    assert [problem.check for problem in problems(path)] == ["names", "names", "names"]


# Limits, at them and just beside


def sized(path: Path, count: int) -> Path:
    """Description and library, and one entry of so many bytes that cannot be packed well."""
    return write(
        path,
        {
            DESCRIPTION: GOOD,
            LIBRARY: b"x",
            "data": hashlib.sha256(b"").digest() * (count // 32) + b"\0" * (count % 32),
        },
    )


@contextmanager
def limited(**limits: float) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in limits.items():
            patch.setattr(module, name, value)
        yield


def checks(path: Path, **limits: float) -> list[str]:
    with limited(**limits):
        return [problem.check for problem in problems(path)]


def test_what_is_as_large_as_is_let_in_is_let_in(tmp_path: Path):
    path = sized(tmp_path / "m.fmu", 10_000)
    unpacked, packed = 10_000 + len(GOOD) + 1, path.stat().st_size
    assert check_archive(path).unpacked == unpacked
    assert (checks(path, MOST_UNPACKED=unpacked), checks(path, MOST_UNPACKED=unpacked - 1)) == (
        [],
        ["size"],
    )
    assert (checks(path, MOST_ENTRIES=3), checks(path, MOST_ENTRIES=2)) == ([], ["entries"])
    assert (checks(path, MOST_XML=len(GOOD)), checks(path, MOST_XML=len(GOOD) - 1)) == (
        [],
        ["size"],
    )
    ratio = unpacked / packed
    assert ratio > 5.0
    assert checks(path, MOST_RATIO=ratio * 0.99, RATIO_MATTERS_FROM=unpacked) == []
    assert checks(path, MOST_RATIO=ratio * 1.01, RATIO_MATTERS_FROM=unpacked - 1) == []
    with limited(MOST_RATIO=5.0, RATIO_MATTERS_FROM=unpacked - 1):
        (bomb,) = problems(path)
    assert bomb.check == "ratio"
    assert f"{ratio:.0f} times as much; from 5 times on" in str(bomb)
    limits = (
        module.MOST_UNPACKED,
        module.MOST_ENTRIES,
        module.MOST_RATIO,
        module.RATIO_MATTERS_FROM,
        module.MOST_XML,
    )
    assert limits == (2_147_483_648, 20_000, 100.0, 33_554_432, 67_108_864)


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (1_073_741_824, "1 GB"),
        (1_073_741_823, "1.02e+03 MB"),
        (3 * 1024**3 // 2, "1.5 GB"),
        (524_288, "0.5 MB"),
    ],
)
def test_sizes_are_told_in_megabytes_and_gigabytes(count: int, said: str):
    assert module._size(count) == said


def test_encrypted_entries_and_names_that_are_none_are_refused(tmp_path: Path):
    path = tmp_path / "m.fmu"
    write(path, {DESCRIPTION: GOOD, LIBRARY: b"x", "secret": "a"})
    data = bytearray(path.read_bytes())
    data[data.rindex(b"PK\x01\x02") + 8] |= 1  # of the last entry in the table of contents
    path.write_bytes(data)
    (problem,) = problems(path)
    assert (problem.check, "'secret' is encrypted" in str(problem)) == ("encryption", True)
    for name in ("", "a\0b"):
        item: Any = SimpleNamespace(orig_filename=name, external_attr=0, flag_bits=0)
        (found,) = module._ArchiveCheck(path)._of_entry(item)
        assert (found.check, "has no proper name" in str(found)) == ("names", True)
    for kind, expected in (
        (stat.S_IFREG, []),
        (stat.S_IFDIR, []),
        (0, []),
        (stat.S_IFLNK, ["links"]),
        (stat.S_IFIFO, ["links"]),
    ):
        item = SimpleNamespace(orig_filename="a", external_attr=kind << 16, flag_bits=0x2)
        assert [found.check for found in module._ArchiveCheck(path)._of_entry(item)] == expected


def test_a_check_may_be_let_pass(tmp_path: Path):
    path = write(tmp_path / "m.fmu", {DESCRIPTION: GOOD})
    found = check_archive(path, but_for=("binary",))
    assert (found.kinds, found.path) == ({}, path)
    assert found.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    with pytest.raises(ArchiveError):
        check_archive(path, but_for=("kind",))


def test_interfaces_without_a_binary_are_not_offered(tmp_path: Path):
    both = GOOD.replace("<CoSimulation", '<ModelExchange modelIdentifier="other"/><CoSimulation')
    path = write(
        tmp_path / "m.fmu",
        {DESCRIPTION: both, LIBRARY: b"x", "binaries/win64/m.dll": b"x", "binaries/": ""},
    )
    found = check_archive(path)
    assert found.kinds == {"CoSimulation": {"modelIdentifier": "m"}}
    with pytest.raises(ArchiveError, match=r"nor Co-Simulation\.$"):
        check_archive(
            write(
                path,
                {
                    DESCRIPTION: '<fmiModelDescription fmiVersion="2.0"><Unit/></fmiModelDescription>',
                    LIBRARY: b"x",
                },
            )
        )
    assert set(interfaces(both.encode())) == {"ModelExchange", "CoSimulation"}


def test_other_texts_may_be_anything_that_is_no_doctype(tmp_path: Path):
    """Only the description must be XML.

    What else ends in .xml is looked at for a DOCTYPE alone, whatever its letters.
    """
    others: dict[str, bytes | str] = {
        "a.xml": "<broken", "b.ssd": '<?xml version="1.0" encoding="nobody"?><x/>',
        "c.XML": "<html/>", "d.txt": "<!DOCTYPE x><x/>",
    }  # fmt: skip
    path = write(tmp_path / "m.fmu", {DESCRIPTION: GOOD, LIBRARY: b"x", **others})
    assert problems(path) == ()
    for name in ("a.ssv", "a.ssm", "a.ssb", "A.SSD"):
        assert checks(
            write(path, {DESCRIPTION: GOOD, LIBRARY: b"x", name: "<!DOCTYPE x><x/>"})
        ) == ["xml"]
    nested = write(path, {f"m/{DESCRIPTION}": GOOD, "a.xml": "<!DOCTYPE x><x/>"})
    assert checks(nested) == ["xml"], "what is dangerous ends it"


@pytest.mark.parametrize("version", ["3.0.1-beta", "3.0-rc.1", "3.1", "3.0.", "4.0", "2.0.4", ""])
def test_versions(version: str, tmp_path: Path):
    text = GOOD.replace('"2.0"', f'"{version}"')
    path = write(
        tmp_path / "m.fmu", {DESCRIPTION: text, "binaries/x86_64-linux/m.so": b"x", LIBRARY: b"x"}
    )
    assert checks(path) == ["version"], "signatures of functions changed between pre-releases"


@pytest.mark.parametrize(
    ("system", "machine", "two", "three"),
    [
        ("Linux", "x86_64", "binaries/linux64/m.so", "binaries/x86_64-linux/m.so"),
        ("Linux", "ARM64", "binaries/linux64/m.so", "binaries/aarch64-linux/m.so"),
        ("Darwin", "arm64", "binaries/darwin64/m.dylib", "binaries/aarch64-darwin/m.dylib"),
        ("Windows", "AMD64", "binaries/win64/m.dll", "binaries/x86_64-windows/m.dll"),
        ("Plan9", "mips", "binaries/plan964/m.so", "binaries/mips-plan9/m.so"),
    ],
)  # fmt: skip
def test_where_a_binary_lies_on_each_machine(
    system: str, machine: str, two: str, three: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(module.platform, "system", lambda: system)
    monkeypatch.setattr(module.platform, "machine", lambda: machine)
    assert (binary_name("2.0", "m"), binary_name("3.0", "m")) == (two, three)


def test_only_what_is_wanted_is_unpacked_and_only_what_was_checked(tmp_path: Path):
    path = write(
        tmp_path / "m.fmu",
        {
            DESCRIPTION: GOOD,
            LIBRARY: b"x",
            "sources/a.c": "int a;",
            "documentation/b": "b",
            "sourcesc": "c",
        },
    )
    archive = check_archive(path)
    unpack(archive, tmp_path / "out", leave_out=("sources/", "documentation/"))
    assert sorted(item.name for item in (tmp_path / "out").rglob("*") if item.is_file()) == [
        "m.so",
        DESCRIPTION,
        "sourcesc",
    ]
    write(
        path,
        {
            DESCRIPTION: GOOD,
            LIBRARY: b"xy",
            "sources/a.c": "int a;",
            "documentation/b": "b",
            "sourcesc": "c",
        },
    )
    with pytest.raises(ArchiveError, match="changed while it was read"):
        unpack(archive, tmp_path / "again")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(MachineError, match=r"cannot be unpacked to .*file \(.+\); make room there"):
        unpack(check_archive(path), tmp_path / "file")
    gone = FmuArchive(path=tmp_path / "gone", digest="", version="2.0", kinds={}, unpacked=0)
    with pytest.raises(MachineError, match=r"\(No such file or directory\)"):
        unpack(gone, tmp_path / "out")


@pytest.mark.parametrize(
    "error", [NotImplementedError("strong encryption\nand more"), EOFError(), RuntimeError("odd")]
)
def test_what_python_cannot_read_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
):
    path = write(tmp_path / "m.fmu", {DESCRIPTION: GOOD, LIBRARY: b"x"})

    def fails(self: Any, name: Any) -> bytes:
        raise error

    monkeypatch.setattr(zipfile.ZipFile, "read", fails)
    (problem,) = problems(path)
    first = str(error).partition("\n")[0] or "EOFError"
    assert (problem.check, str(problem)) == (
        "zip",
        f"FMU {path}: it is a zip file that cannot be read ({first}).",
    )
    monkeypatch.setattr(
        zipfile.ZipFile,
        "read",
        lambda self, name: (_ for _ in ()).throw(PermissionError(13, "Permission denied")),
    )
    with pytest.raises(MachineError, match=r"it cannot be read \(Permission denied\)"):
        problems(path)

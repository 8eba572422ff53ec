"""What is found in the file itself, what is refused before it is opened, and the command's exit codes and forms."""

import json
import re
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from wording import unsaid

from models.errors import MachineError, UnknownNameError
from validate.fmi import cvode
from validate.fmi.archive import ArchiveError
from validate.fmu_check import Status, check_fmu
from validate.fmu_check.host import NAMES, run_checks

_OTHER_START = ("modelDescription.xml", 'start="30.0"', 'start="31.0"')
_STATIC = ["archive", "description is valid", "exported functions"]


def _pack(path: Path, content: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def _sentence(path: Path, check: str = "archive") -> str:
    report = check_fmu(path, names=_STATIC)
    return " ".join(
        row.sentence for row in report.rows if row.name == check and row.status is Status.FAILED
    )


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("../outside.txt", "leads out"),
        ("/tmp/outside.txt", "absolute path"),
        ("sources\\model.h", "backslash"),
    ],
)
def test_entry_with_a_name_that_is_not_unpacked(
    tmp_path: Path, sound_content, name: str, words: str
):
    content = sound_content("2.0") | {name: b"x"}
    report = check_fmu(_pack(tmp_path / "bad.fmu", content))
    assert [
        (row.name, words in row.sentence) for row in report.rows if row.status is Status.FAILED
    ] == [("archive", True)]
    assert all(row.status is Status.NOT_OFFERED for row in report.rows[1:]), (
        "what is unsafe is not unpacked"
    )


def test_link(tmp_path: Path, sound_content):
    path = tmp_path / "bad.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in sound_content("2.0").items():
            archive.writestr(name, data)
        link = zipfile.ZipInfo("resources/link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc/passwd")
    assert "symbolic link" in _sentence(path)


@pytest.mark.slow
def test_compression_method(tmp_path: Path, sound_content):
    assert "other than deflate" in _sentence(
        _pack(tmp_path / "bad.fmu", sound_content("2.0"), method=zipfile.ZIP_LZMA)
    )


def test_no_schema(defective: Callable[..., Path]):
    path = defective([("modelDescription.xml", "<ModelVariables>", "<ModelVariables><Odd/>")])
    assert "Odd" in _sentence(path, "description is valid")


@pytest.mark.parametrize(
    ("begin", "words"),
    [
        (lambda data: b"MZ not what it should be", "the binary cannot be loaded"),
        (lambda data: data[:18] + b"\x16\0" + data[20:], "for another processor"),  # S/390
        (lambda data: data[:4] + b"\1" + data[5:], "wrong ELF class"),
    ],
)
def test_binary_that_cannot_be_loaded_fails(
    tmp_path: Path, sound_content, begin: Callable[[bytes], bytes], words: str
):
    content = sound_content("2.0")
    binary = next(name for name in content if name.startswith("binaries/"))
    content[binary] = begin(content[binary])
    report = check_fmu(_pack(tmp_path / "bad.fmu", content), names=["exported functions"])
    rows = {row.title: row for row in report.rows}
    assert rows["exported functions (ME)"].status is Status.NOT_OFFERED
    assert rows["starts and ends (ME)"].status is Status.FAILED
    assert words in rows["starts and ends (ME)"].sentence


@pytest.mark.slow
def test_other_platform_only(tmp_path: Path, sound_content, cli):
    content = {
        name: data for name, data in sound_content("2.0").items() if not name.startswith("sources/")
    }
    content["modelDescription.xml"] = re.sub(
        rb"<SourceFiles>.*?</SourceFiles>", b"", content["modelDescription.xml"], flags=re.DOTALL
    )
    binary = next(name for name in content if name.startswith("binaries/"))
    content["binaries/win64/three_cart.dll"] = content.pop(binary)
    path = _pack(tmp_path / "other.fmu", content)
    report = check_fmu(path)
    assert report.ok
    assert report.unrunnable
    assert "0 problems" in " ".join(row.sentence for row in report.rows)
    done = cli("check", str(path))
    assert done.returncode == 3
    assert "no binary for this machine" in done.stdout


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [("text.fmu", b"hello", "not a zip file"), ("missing.fmu", None, "no such file")],
)
def test_no_fmu(tmp_path: Path, cli, name: str, data: bytes | None, words: str):
    path = tmp_path / name
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(ArchiveError, match=words):
        check_fmu(path)
    done = cli("check", str(path))
    assert done.returncode == 2
    assert done.stderr.startswith("error: FMU ")
    assert len(done.stderr.strip().splitlines()) == 1


def test_no_description(tmp_path: Path):
    with pytest.raises(ArchiveError, match=r"no modelDescription.xml"):
        check_fmu(_pack(tmp_path / "empty.fmu", {"readme.txt": b""}))


def test_unknown_check(tmp_path: Path):
    with pytest.raises(
        UnknownNameError,
        match=r"there is no check 'Stop time'; did you mean stop time is respected\?",
    ):
        check_fmu(_pack(tmp_path / "any.fmu", {}), names=["Stop time"])
    with pytest.raises(UnknownNameError, match="there is no check 'time'; there are: archive, "):
        check_fmu(_pack(tmp_path / "any.fmu", {}), names=["time"])
    with pytest.raises(UnknownNameError, match="there is no check 'speed'; there are: archive, "):
        check_fmu(tmp_path / "any.fmu", names=["speed"])


@pytest.mark.slow
def test_command_in_json_and_plain(
    tmp_path: Path, sound_content, defective: Callable[..., Path], cli
):
    path = _pack(tmp_path / "sound.fmu", sound_content("2.0"))
    done = cli("check", str(path), "--only", "start values are the XML's", "--json")
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["ok"]
    assert data["fmi"] == "2.0"
    assert [row["check"] for row in data["rows"] if row["status"] == "passed"].count(
        "start values are the XML's"
    ) == 2
    done = cli("check", str(defective([_OTHER_START])), "--only", "start values are the XML's")
    assert done.returncode == 1
    assert not unsaid(done.stdout, "k is 30 in the binary, 31")
    assert "2 failed" in done.stdout


@pytest.mark.slow
def test_command_writes_a_page_and_junit_of_several(
    tmp_path: Path, sound_content, defective: Callable[..., Path], cli
):
    sound, bad = (
        _pack(tmp_path / "sound.fmu", sound_content("2.0")),
        defective([_OTHER_START]).rename(tmp_path / "b<a>d.fmu"),
    )
    page, junit = tmp_path / "new" / "check.html", tmp_path / "new" / "check.xml"
    only = ("--only", "start values are the XML's", "--only", "adjoint derivatives")
    done = cli("check", str(sound), str(bad), *only, "--html", str(page), "--junit", str(junit))
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout.count("(FMI 2.0, ME and CS): ") == 2

    text = page.read_text(encoding="utf-8")
    assert "2 FMUs in FMI 2.0: 1 of them does not pass." in text
    assert not unsaid(text, "k is 30 in the binary, 31")
    assert "b&lt;a&gt;d.fmu" in text
    assert "b<a>d.fmu" not in text
    assert "--junit" in text, "it says how it was made"
    assert "Export s" not in text

    suites = ElementTree.parse(junit).getroot()
    assert [suite.get("name") for suite in suites] == [str(sound), str(bad)]
    assert [(suite.get("failures"), suite.get("skipped")) for suite in suites] == [
        ("0", "2"),
        ("2", "2"),
    ]
    for suite in suites:
        cases = suite.findall("testcase")
        assert len(cases) == int(suite.get("tests", "")) == 6
        assert all(float(case.get("time", "nan")) >= 0.0 for case in cases)
    failure = suites[1].find("testcase/failure")
    assert not unsaid(failure.get("message", ""), "k is 30 in the binary, 31")
    assert [case.get("name") for case in suites[1] if case.find("skipped") is not None] == [
        "adjoint derivatives (ME)",
        "adjoint derivatives (CS)",
    ]


@pytest.mark.slow
def test_a_page_that_cannot_be_written_is_one_sentence(tmp_path: Path, sound_content, cli):
    path = _pack(tmp_path / "sound.fmu", sound_content("2.0"))
    (tmp_path / "taken").write_text("")
    for option in ("--html", "--junit"):
        done = cli("check", str(path), "--only", "archive", option, str(tmp_path / "taken" / "x"))
        assert done.returncode in (2, 3)
        assert len(done.stderr.strip().splitlines()) == 1
        assert str(tmp_path / "taken") in done.stderr


@pytest.mark.slow
def test_command_needs_neither_solver_nor_torch(cli_environment):
    import subprocess
    import sys

    code = "import sys, validate.cli.check, validate.fmu_check; print([name for name in ('pyomo', 'torch', 'formulations') if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=cli_environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]", done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_fmu_of_sources_is_compiled_and_then_checked(
    version: str, sound_content: Callable[[str], dict[str, bytes]], tmp_path: Path
):
    content = {
        name: data
        for name, data in sound_content(version).items()
        if not name.startswith("binaries/")
    }
    report = check_fmu(
        _pack(tmp_path / "sources.fmu", content), names=["sources compile", "values stay finite"]
    )
    found = {(row.name, row.type): row.status for row in report.rows}
    assert found["sources compile", "ME"] is Status.PASSED
    assert found["values stay finite", "CS"] is Status.PASSED
    assert not report.unrunnable
    name = "sources/equations.h"
    report = check_fmu(
        _pack(tmp_path / "broken.fmu", content | {name: content[name] + b"\n#error no\n"}),
        names=["sources compile"],
    )
    (row,) = [row for row in report.rows if (row.name, row.type) == ("sources compile", "ME")]
    assert row.status is Status.FAILED
    assert "sources/equations.h" in row.sentence
    assert "#error no" in row.sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "legal"),
    [("a.b[1,2].c", True), ("der(a.b)", True), ("'x y'.z", True), ("a..b", False), ("1a", False),
     ("der(a", False), ("a[b]", False), ("a b", False)],
)  # fmt: skip
def test_a_structured_name_is_legal_or_told_however_it_is_found_out(
    name: str, legal: bool, defective: Callable[..., Path]
):
    """FMPy's parser takes a millisecond a name, and is asked about those alone that are not plain."""
    path = defective([("modelDescription.xml", 'name="kinetic_energy"', f'name="{name}"')], "3.0")
    (row,) = [
        row
        for row in check_fmu(path, names=["description is valid"]).rows
        if row.name == "description is valid"
    ]
    assert ("is not a legal variable name" in row.sentence) is not legal, row.sentence


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_nothing_is_compiled_or_loaded_outside_the_folder(
    version: str, sound_content: Callable[[str], dict[str, bytes]], tmp_path: Path
):
    outside = f"../../../../../../../..{tmp_path}/escaped"
    content = {
        name: data
        for name, data in sound_content(version).items()
        if not name.startswith("binaries/")
    }
    for name in ("modelDescription.xml", "sources/buildDescription.xml"):
        content |= (
            {
                name: content[name].replace(
                    b'modelIdentifier="three_cart"', f'modelIdentifier="{outside}"'.encode()
                )
            }
            if name in content
            else {}
        )
    path = _pack(tmp_path / "sources.fmu", content)
    report = check_fmu(path)
    found = {row.name: row for row in report.rows}
    assert found["description is valid"].status is Status.FAILED
    assert not unsaid(
        found["description is valid"].sentence,
        f"modelIdentifier is '{outside[:40]}",
        "expected a C identifier",
    )
    assert {
        row.status for row in report.rows if row.name not in ("archive", "description is valid")
    } == {Status.NOT_OFFERED}
    assert [item.name for item in tmp_path.iterdir()] == ["sources.fmu"]


def test_a_check_of_files_needs_no_integrator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def missing() -> None:
        raise MachineError("CVODE is missing.")

    monkeypatch.setattr(cvode, "functions", missing)
    (tmp_path / "told").touch()
    request = {"path": str(tmp_path / "m.fmu"), "folder": str(tmp_path),
               "rows": str(tmp_path / "told"), "version": "2.0", "seconds": 1.0, "runnable": False}  # fmt: skip
    assert run_checks({**request, "names": _STATIC[:1]}, {})["types"] == []
    with pytest.raises(MachineError, match="CVODE"):
        run_checks({**request, "names": list(NAMES)}, {})

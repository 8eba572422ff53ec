"""What `check` writes for other tools, from a report whose every figure is different, read back by a reader of JUnit XML."""

import json
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
from junitparser import JUnitXml

from models.catalog import load_scene
from models.fmu import build_fmu
from validate.cli.check import data, junit
from validate.fmu_check import CheckReport, FmuCheckRow, Status, check_fmu

_ROWS = (
    FmuCheckRow(name="archive", type="", claim="a zip", status=Status.PASSED, sentence="3 entries.",
                seconds=0.1, clause="FMI 3.0.2, 2.5.1"),
    FmuCheckRow(name="start values are the XML's", type="ME", claim="same", status=Status.FAILED,
                sentence="a|b is 2 <3>.", seconds=0.2, clause="FMI 3.0.2, 2.4.7.5"),
    FmuCheckRow(name="runs repeat", type="CS", claim="bits", status=Status.FAILED,
                sentence="x\ndiffers.\x07", seconds=0.3),
    FmuCheckRow(name="set state restores", type="CS", claim="all", status=Status.WAIVED,
                sentence="off. Waived: ours.", seconds=0.4, clause="FMI 3.0.2, 2.2.7.4"),
    FmuCheckRow(name="time after a step", type="CS", claim="time", status=Status.ADVICE,
                sentence="say it.", seconds=0.5, clause="FMI 3.0.2, 4.2.1"),
    FmuCheckRow(name="adjoint derivatives", type="ME", claim="adjoint", status=Status.NOT_OFFERED,
                sentence="none.", seconds=0.6),
)  # fmt: skip


@pytest.fixture
def report() -> CheckReport:
    return CheckReport(path="a b.fmu", version="3.0", types=("ME", "CS"), rows=_ROWS)


def test_severity_is_that_of_the_standard_where_a_section_demands_it():
    assert [row.severity for row in _ROWS] == [
        "error",
        "error",
        "behaviour",
        "error",
        "advice",
        "behaviour",
    ]


def test_waived_and_advice_do_not_fail(report: CheckReport):
    assert (report.ok, report.exit_code) == (False, 1)
    rest = CheckReport(
        path="x",
        version="3.0",
        types=(),
        rows=tuple(row for row in _ROWS if row.status is not Status.FAILED),
    )
    assert (rest.ok, rest.exit_code, rest.counts) == (
        True,
        0,
        "1 passed, 0 failed, 1 not offered, 1 advice, 1 waived",
    )


def test_json_has_every_figure_of_a_row(report: CheckReport):
    rows = data(report)["rows"]
    assert [row["seconds"] for row in rows] == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    assert rows[3] == {
        "check": "set state restores", "type": "CS", "claim": "all", "status": "waived",
        "severity": "error",
        "clause": "FMI 3.0.2, 2.2.7.4", "sentence": "off. Waived: ours.", "seconds": 0.4,
    }  # fmt: skip


def test_junit_skips_what_is_waived_and_fails_what_failed(report: CheckReport):
    suite = ElementTree.fromstring(junit([(report, 2.5)]))[0]
    ends = {case.get("name"): [part.tag for part in case] for case in suite}
    assert ends == {
        "archive": [], "start values are the XML's (ME)": ["failure"],
        "runs repeat (CS)": ["failure"],
        "set state restores (CS)": ["skipped"], "time after a step (CS)": ["system-out"],
        "adjoint derivatives (ME)": ["skipped"],
    }  # fmt: skip
    failures = [case.find("failure") for case in suite if case.find("failure") is not None]
    assert [(item.get("type"), item.get("message")) for item in failures] == [
        ("error", "a|b is 2 <3>."),
        ("behaviour", "x differs."),
    ]
    assert "FMI 3.0.2, 2.4.7.5" in (failures[0].text or "")


@pytest.mark.slow
def test_a_waiver_turns_a_failure_and_nothing_else(tmp_path: Path, cli):
    path = _doubled(tmp_path)
    alone = ("--only", "archive", "--only", "description is valid")
    assert cli("check", str(path), *alone).returncode == 1
    done = cli("check", str(path), *alone, "--waive", "archive=the packer's own way", "--json")
    rows = {row["check"]: row for row in json.loads(done.stdout)["rows"]}
    assert done.returncode == 0
    assert rows["archive"]["status"] == "waived"
    assert "the packer's own way" in rows["archive"]["sentence"]
    assert rows["description is valid"]["status"] == "passed"


@pytest.mark.parametrize(
    ("waiver", "words"),
    [
        ("archive", "NAME=REASON"),
        ("archive= ", "NAME=REASON"),
        ("archiv=why", "did you mean archive?"),
    ],
)
def test_a_waiver_that_is_none_is_one_sentence(tmp_path: Path, cli, waiver: str, words: str):
    done = cli("check", str(_doubled(tmp_path)), "--waive", waiver)
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_an_entry_that_is_there_twice_stops_no_other_check(tmp_path: Path):
    rows = []
    report = check_fmu(
        _doubled(tmp_path), names=["archive", "values stay finite"], on_row=rows.append
    )
    assert tuple(rows) == report.rows, "each row is told once, in order"
    assert {row.title: row.status for row in rows} == {
        "archive": Status.FAILED,
        "starts and ends (ME)": Status.PASSED,
        "starts and ends (CS)": Status.PASSED,
        "values stay finite (ME)": Status.PASSED,
        "values stay finite (CS)": Status.PASSED,
    }
    assert "2 times" in rows[0].sentence


@pytest.mark.slow
def test_rows_are_as_wide_as_the_terminal_or_as_they_like(tmp_path: Path, cli):
    alone = ("check", str(_doubled(tmp_path)), "--only", "archive")
    narrow, wide = (
        cli(*alone, *more, COLUMNS="40").stdout.splitlines()[0] for more in ((), ("--wide",))
    )
    assert len(narrow) <= 40 < len(wide)


def _doubled(folder: Path) -> Path:
    """A sound FMU with an entry that is there twice."""
    path = folder / "twice.fmu"
    path.write_bytes(build_fmu(load_scene("bouncing_mass"), "2.0").read_bytes())
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("modelDescription.xml", archive.read("modelDescription.xml"))
    return path


def test_junitparser_reads_the_same(report: CheckReport, tmp_path: Path):
    (tmp_path / "check.xml").write_bytes(junit([(report, 2.5)]))
    (suite,) = JUnitXml.fromfile(str(tmp_path / "check.xml"))
    assert (suite.tests, suite.failures, suite.skipped, suite.errors, suite.time) == (
        6,
        2,
        2,
        0,
        2.5,
    )
    assert [case.name for case in suite if case.is_failure] == [
        "start values are the XML's (ME)",
        "runs repeat (CS)",
    ]

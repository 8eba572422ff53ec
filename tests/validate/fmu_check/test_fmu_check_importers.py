"""Other people's importers in the check: whose numbers are ours pass, others are advice, and one that is not installed is a row that says so."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from models.catalog import load_scene
from models.fmu import build_fmu
from validate.cli.check import command, markdown
from validate.fmu_check import CheckReport, Status, check_fmu
from validate.fmu_check.importers import IMPORTERS

_NAMES = [f"importer {name}" for name in IMPORTERS]


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_each_importer_is_a_row_of_each_interface(version: str):
    """FMPy is always there.

    The others where they are installed, and CasADi goes as far as the first event.
    """
    report = check_fmu(build_fmu(load_scene("three_cart"), version), names=_NAMES)
    rows = {(row.name, row.type): row for row in report.rows if row.name in _NAMES}
    assert set(rows) == {(name, kind) for name in _NAMES[:-1] for kind in ("ME", "CS")} | {
        ("importer fmutool", "")
    }
    for (name, kind), row in rows.items():
        importer = IMPORTERS[name.removeprefix("importer ")]
        if importlib.util.find_spec(importer.module) is None:
            assert (row.status, "not installed" in row.sentence) == (Status.NOT_OFFERED, True)
        elif importer.takes and (int(version[0]), kind) not in importer.takes:
            assert (row.status, f"no FMI {version}" in row.sentence) == (Status.NOT_OFFERED, True)
        else:
            assert row.status is Status.PASSED, row.sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        # Only an importer that tells the stop time meets these.
        (
            "    self->model.stop_defined = stop_defined != 0;\n",
            "    self->model.stop_defined = stop_defined != 0;\n    if (stop_defined) self->model.q[0] += 0.125;\n",
            "and 0",
        ),
        (
            "    self->model.stop_defined = stop_defined != 0;\n",
            "    self->model.stop_defined = stop_defined != 0;\n    if (stop_defined) *(volatile int *)0 = 1;\n",
            "crashed",
        ),
        (
            "    self->model.stop_defined = stop_defined != 0;\n",
            "    if (stop_defined) return STATUS_ERROR;\n    self->model.stop_defined = 0;\n",
            "exception",
        ),
    ],
)
def test_other_numbers_a_crash_and_a_refusal_are_advice(
    old: str, new: str, words: str, defective: Callable[..., Path]
):
    report = check_fmu(defective([("sources/instance.h", old, new)]), names=["importer FMPy"])
    found = {row.type: row for row in report.rows if row.name == "importer FMPy"}
    assert found["CS"].status is Status.ADVICE, found["CS"].sentence
    for part in ("FMPy 0.", words):
        assert part in found["CS"].sentence
    assert report.ok


def test_they_are_asked_only_on_demand(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    asked: list[bool] = []

    def noted(path: Path, **how: bool) -> CheckReport:
        asked.append(how["importers"])
        return CheckReport(path=str(path), version="2.0", types=("CS",), rows=())

    monkeypatch.setattr("validate.cli.check.check_fmu", noted)
    for words in ([], ["--importers"]):
        assert (
            CliRunner()
            .invoke(command, [str(tmp_path / "any.fmu"), *words], standalone_mode=False)
            .exception
            is None
        )
    assert asked == [False, True]


@pytest.mark.slow
def test_the_table_of_importers_stands_below_the_checks_in_markdown():
    report = check_fmu(
        build_fmu(load_scene("three_cart"), "2.0"), names=["importer FMPy", "importer fmuloader"]
    )
    text = markdown([report], "python -m validate check")
    above, _, table = text.partition("| importer | Model Exchange | Co-Simulation | file |")
    assert "importer FMPy" not in above
    assert table.count("| FMPy | passed: FMPy") == 1
    assert "| fmuloader | not offered: " in table

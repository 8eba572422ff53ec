"""The page of FMUs, from records: sound ones, failing ones, and checks that ended without an answer."""

import html
import re
from pathlib import Path

from wording import unsaid

from models.results.check import CheckRecord, FmuCheckRow, FmuRecord, Status
from models.results.stored import from_data
from reports.load import load
from reports.render import PAGES, write_report
from reports.rule import failures


def _words(folder: Path) -> str:
    """The words of report.html and of the page of FMUs."""
    report = write_report(folder)
    texts = [path.read_text(encoding="utf-8") for path in (report, folder / PAGES / "fmus.html")]
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", " ".join(texts))).split())


def _fmu(
    factory, scene: str, version: str, statuses: tuple[str, ...], **changes: object
) -> CheckRecord:
    rows = tuple(
        FmuCheckRow(
            name=f"check {place}",
            type="ME",
            claim=f"claim <{place}>",
            status=Status(status),
            sentence=f"found {place}.",
            seconds=0.25,
        )
        for place, status in enumerate(statuses)
    )
    fmu = FmuRecord(
        version=version,
        types=("ME", "CS"),
        bytes=79867,
        sha256="ab" * 32,
        export_seconds=2.5,
        check_seconds=4.25,
        rows=rows,
    )
    values = {
        "key": f"{scene}-{version}-0123456789", "kind": "FMU", "name": f"{scene}, FMI {version}",
        "expected": "it passes every check of what it offers.", "scene": scene,
        "outcome": "answered", "passed": "failed" not in statuses,
        "found": "counts.", "fmu": fmu, "wall_seconds": 7.0, "cpu_seconds": 6.0,
        "provenance": factory.provenance(),
    }  # fmt: skip
    return from_data(CheckRecord, values | changes)


def _campaign(factory, folder: Path, checks: list[CheckRecord]) -> Path:
    return factory.store(folder, [factory.run("strict", None, "strict_lcp"), *checks])


def test_each_fmu_has_a_row_and_all_of_its_checks(factory, tmp_path):
    sound = _fmu(factory, "three_cart", "2.0", ("passed", "passed", "not offered"))
    other = _fmu(factory, "three_cart", "3.0", ("passed", "passed", "passed"))
    words = _words(_campaign(factory, tmp_path, [sound, other]))
    assert not unsaid(
        words,
        "2 FMUs of 1 scene … 2.0 and 3.0: every one passes. … 5 passed, 0 failed, 1 not offered; 12 CPU",
    )
    assert "three_cart 2.0 ME, CS 2 0 1 79.9 2.50 4.25 ✓ none" in words
    assert "check 2 ME ○ not offered Found 2." in words
    assert not unsaid(words, "check 0 Claim <0>. check 1 Claim <1>. check 2 Claim <2>.")
    assert "All required checks passed" in words


def test_a_failed_check_fails_the_campaign_and_is_named(factory, tmp_path):
    bad = _fmu(
        factory,
        "three_cart",
        "2.0",
        ("passed", "failed", "failed"),
        found="check 1 (ME): found 1; check 2 (ME): found 2.",
    )
    words = _words(_campaign(factory, tmp_path, [bad]))
    assert failures(factory.runs(), [bad]) == (
        "FMU: three_cart, FMI 2.0: failed - check 1 (ME): found 1; check 2 (ME): found 2.",
    )
    assert not unsaid(
        words, "FMU: three_cart, FMI 2.0: failed - check 1 (ME): found 1; check 2 (ME): found 2."
    )
    assert "✗ failed check 1 (ME), check 2 (ME)" in words
    assert not unsaid(words, "1 FMU of 1 scene … 1 of them does not pass.")
    assert "Claim <2>. Found 2." in words


def test_an_end_without_an_answer_fails_too(factory, tmp_path):
    lost = _fmu(
        factory, "hopper", "3.0", (), outcome="time_limit", passed=False, found="", fmu=None,
        message="ended at its time limit of 120 s, during the check.", log_tail="last <line>",
    )  # fmt: skip
    words = _words(_campaign(factory, tmp_path, [lost]))
    assert not unsaid(words, "hopper 3.0 ✗ failed time limit: … 120 s, during the check.")
    assert "last <line>" in words
    assert failures([], [lost]) == (
        "FMU: hopper, FMI 3.0: time limit - ended at its time limit of 120 s, during the check.",
    )


def test_a_folder_with_nothing_but_examinations(factory, tmp_path):
    sound = _fmu(factory, "three_cart", "2.0", ("passed",))
    words = _words(factory.store(tmp_path, [sound]))
    assert "every one passes" in words
    assert "No run is stored here yet" not in words
    stored = load(tmp_path)
    assert (stored.runs, stored.checks, stored.unreadable) == ((), (sound,), ())

"""Checks, which are no scene by pipeline: selected, run in children, stored, resumed and told as runs are; our own FMUs among them."""

import csv
import json
import re
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from wording import unsaid

import models.fmu
import validate.tasks.fmu_checks
from models.catalog import load_scene, scene_names
from models.results.check import CheckRecord
from models.results.stored import from_json, record_of
from models.scene.text import scene_text
from validate.campaign.runs import CampaignSettings, scene_cost, select
from validate.campaign.stored import CampaignError
from validate.fmu_check import DECISIVE
from validate.tasks.check import Course, check_key
from validate.tasks.fmu_checks import check
from validate.tasks.plugins import DEFAULT
from validate.tasks.task import CheckTask, SceneReference, task_from_json, task_to_json

pytestmark = pytest.mark.slow

# The time limit is for the one that hangs, beside which the others run.
FAKES = (
    "--plugin",
    "check_fakes:PLUGIN",
    "--scene",
    "three_cart",
    "-k",
    "only_good or asked",
    "--time-limit",
    "12",
)


def _records(out: Path) -> dict[str, CheckRecord]:
    texts = [path.read_bytes() for path in out.glob("runs/*/record.json")]
    records = [from_json(CheckRecord, text) for text in texts if b'"pipeline"' not in text]
    return {record.name.partition(" ")[0]: record for record in records}


def _noted(path: Path) -> list[str]:
    return sorted(path.read_text().split()) if path.exists() else []


@pytest.fixture(scope="module")
def asked(cli, tmp_path_factory):
    """One campaign with every kind of answer, and a good cell beside them: (out, notes, what the command said)."""
    out = tmp_path_factory.mktemp("asked")
    notes = out / "noted.txt"
    return out, notes, cli("all", *FAKES, "--out", str(out), "-j", "2", NOTED=str(notes))


@pytest.mark.parametrize(("says", "outcome", "passed", "words"), [
    ("yes", "answered", True, "it says yes."), ("no", "answered", False, "it says no."),
    ("maybe", "answered", False, "it says maybe."),
    ("refuse", "failed", False, "the check says why it cannot."),
    ("raise", "crashed", False, "ValueError: its own mistake"),
    ("segfault", "crashed", False, r"signal 11 \(SIGSEGV\) during the question segfault"),
    ("hang", "time_limit", False, "time limit of 12 s, during the question hang"),
])  # fmt: skip
def test_each_answer_is_the_right_record(asked, says: str, outcome: str, passed: bool, words: str):
    record = _records(asked[0])[says]
    assert (record.outcome, record.passed) == (outcome, passed)
    assert re.search(words, record.found + record.message)
    assert record.scene == "three_cart"
    assert record.wall_seconds > 0
    if outcome == "answered":
        assert 0 < record.figures[0].value < 12.0


def test_what_fails_is_told_and_the_rest_is_not_disturbed(asked):
    out, _, done = asked
    assert done.returncode == 1
    failing = [line for line in done.stdout.splitlines() if line.startswith("fails: ")]
    assert len(failing) == 6
    assert not unsaid(failing, "no of three_cart: failed - it says no.")
    assert [
        line
        for line in failing
        if not unsaid(line, "question: refuse of three_cart", "says why it cannot")
    ]
    assert re.search(r"\[\d/8\] question: yes of three_cart: passed, .*it says yes", done.stderr)
    assert "only_good" in (out / "results.csv").read_text()
    assert "question" not in (out / "results.csv").read_text()
    assert not list(out.glob("runs/.partial-*"))


def test_what_answered_is_stored_and_what_crashed_is_asked_again(asked, cli):
    out, notes, _ = asked
    before = _noted(notes)
    assert before == ["hang", "maybe", "no", "raise", "refuse", "segfault", "yes"]
    done = cli(
        "all", *FAKES, "--time-limit", "11", "--out", str(out), NOTED=str(notes)
    )  # the last one counts: what hung for longer is known
    assert done.returncode == 1
    assert "6 stored, 2 to run" in done.stderr
    assert sorted(_noted(notes)) == sorted([*before, "raise", "segfault"])


def test_selection_by_words_and_scenes_and_quick():
    settings = CampaignSettings(
        out=Path(), plugin="check_fakes:PLUGIN", scenes=("three_cart",), expression="asked"
    )
    entries, left_out = select(settings)
    assert [entry.task.title for entry in entries][:2] == [
        "question: yes of three_cart",
        "question: no of three_cart",
    ]
    assert len(entries) == 7, "the one about no scene is not meant where scenes are named"
    assert left_out == ()
    quick, left_out = select(replace(settings, quick=True))
    assert len(quick) == 6
    assert left_out == ("question: maybe of three_cart",)
    everywhere, left_out = select(replace(settings, quick=True, scenes=()))
    assert [entry.task.title for entry in everywhere][-1] == "question: yes of nothing"
    assert re.fullmatch(r"question: \d+ checks", left_out[0])
    with pytest.raises(CampaignError, match="-k 'asked' selects no run and no check"):
        select(replace(settings, plugin="campaign_fakes:PLUGIN"))


def _check(**changes) -> CheckTask:
    whole = {
        "kind": "k",
        "name": "n",
        "expected": "e",
        "function": "f:g",
        "arguments": {"a": 1},
        "sources": ("validate/fmu_check/",),
    }
    return CheckTask(**{**whole, **changes})


def test_equal_content_has_equal_keys_and_other_content_another():
    key = check_key(_check())
    assert key == check_key(_check(time_limit=3.0, words=("w",), quick=False, scene="s"))
    others = [
        _check(name="m"), _check(arguments={"a": 2}),
        _check(content=scene_text(load_scene("three_cart"))),
        _check(sources=("validate/judge/replay/",)), _check(sources=()), _check(function="f:h"),
    ]  # fmt: skip
    keys = {key, *(check_key(other) for other in others)}
    assert len(keys) == len(others) + 1


def test_a_request_survives_its_file():
    check = _check(key="k", time_limit=4.0, methods=("relu_gd",), words=("w",), scene="s")
    assert task_from_json(json.loads(json.dumps(task_to_json(check)))) == check


def test_checks_of_our_own_are_told_apart_by_their_names():
    scenes = [SceneReference(name, load_scene(name)) for name in ("three_cart", "bouncing_mass")]
    titles = [item.title for item in DEFAULT.checks(scenes)]
    assert len(set(titles)) == len(titles)


def test_every_scene_is_checked_and_a_quick_campaign_checks_its_own():
    entries, _ = select(CampaignSettings(out=Path(), expression="fmu_check"))
    assert [entry.task.scene for entry in entries] == sorted(
        scene_names(), key=lambda name: (name != "three_cart", scene_cost(load_scene(name)))
    )
    assert len({entry.task.key for entry in entries}) == len(entries)
    quick, _ = select(CampaignSettings(out=Path(), expression="fmu_check", quick=True))
    assert {entry.task.scene for entry in quick} == {
        name for name in scene_names() if load_scene(name).quick
    }


def test_a_campaign_checks_an_fmu_stores_it_and_tells_of_it(cli, tmp_path):
    command = ("all", "--scene", "bouncing_mass", "-k", "fmu_check", "--out", str(tmp_path))
    done = cli(*command)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FMU: 1 of 1 checks passed" in done.stdout
    assert "[1/1] FMU: bouncing_mass, FMI 2.0: passed, " in done.stderr
    (record,) = (record_of(path.read_bytes()) for path in tmp_path.glob("runs/*/record.json"))
    assert record.fmu.count("failed") == 0
    assert {row.name for row in record.fmu.rows} == set(DECISIVE) | {"starts and ends"}
    assert record.fmu.count("passed") > 10
    assert len({(row.name, row.type) for row in record.fmu.rows}) == len(record.fmu.rows)
    (row,) = csv.DictReader((tmp_path / "checks.csv").read_text(encoding="utf-8").splitlines())
    assert (row["kind"], row["scene"], row["outcome"], row["passed"]) == (
        "FMU",
        "bouncing_mass",
        "answered",
        "True",
    )
    assert json.loads((tmp_path / "campaign.json").read_text())["violation"] == [], (
        "nothing was planned for"
    )
    assert "bouncing_mass" in (tmp_path / "pages" / "fmus.html").read_text(encoding="utf-8")
    again = cli(*command, "--json")
    assert "1 stored, 0 to run" in again.stderr
    assert [item["passed"] for item in json.loads(again.stdout)["checks"]] == [True]


def test_a_failed_check_of_our_own_is_found_and_named(monkeypatch, tmp_path):
    sound = models.fmu.build_fmu(load_scene("bouncing_mass"), "2.0")

    def defective(scene, _version):
        """A description that gives another stiffness than the binary has."""
        path = tmp_path / "defective.fmu"
        with zipfile.ZipFile(sound) as source, zipfile.ZipFile(path, "w") as target:
            for name in source.namelist():
                data = source.read(name)
                if name == "modelDescription.xml":
                    place = data.index(b'start="', data.index(b'causality="parameter"'))
                    data = data[: place + 7] + b"1" + data[place + 7 :]
                target.writestr(name, data)
        return path

    monkeypatch.setattr(validate.tasks.fmu_checks, "build_fmu", defective)
    found = check({"scene": "bouncing_mass"}, Course(tmp_path, time.monotonic() + 100.0))
    assert not found.passed
    assert "start values are the XML's (CS)" in found.sentence
    assert found.details["fmu"].failed
    assert (tmp_path / "progress.txt").read_text() == "the check"


def test_the_key_is_that_of_the_scene_and_its_sources():
    def key(scene: str) -> str:
        (entry,), _ = select(CampaignSettings(out=Path(), scenes=(scene,), expression="fmu_check"))
        return entry.task.key

    assert key("bouncing_mass") == key("bouncing_mass")
    assert key("bouncing_mass") != key("two_body_collision")

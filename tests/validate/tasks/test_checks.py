"""Cells that are no scene x pipeline: selected, run in children, stored, resumed and judged as other cells are."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from wording import unsaid

from models.catalog import load_scene
from models.scene.text import scene_text
from reports.records.check_record import CheckRecord
from validate.execution.campaign import CampaignError, CampaignSettings, select
from validate.store.provenance import check_key
from validate.tasks.plugins import DEFAULT
from validate.tasks.task import CheckTask, SceneReference, task_from_json, task_to_json

# The time limit is for the one that hangs, beside which the others run.
FAKES = ("--plugin", "check_fakes:PLUGIN", "--scene", "three_cart", "-k", "only_good or asked", "--time-limit", "12")


def _records(out: Path) -> dict[str, CheckRecord]:
    texts = [path.read_bytes() for path in out.glob("runs/*/record.json")]
    records = [CheckRecord.model_validate_json(text) for text in texts if b'"pipeline"' not in text]
    return {record.name.partition(" ")[0]: record for record in records}


def _noted(path: Path) -> list[str]:
    return sorted(path.read_text().split()) if path.exists() else []


@pytest.fixture(scope="module")
def asked(cli, tmp_path_factory):
    """One campaign with every kind of answer, and a good cell beside them: (out, notes, what the command said)."""
    out = tmp_path_factory.mktemp("asked")
    notes = out / "noted.txt"
    return out, notes, cli("all", *FAKES, "--out", str(out), "-j", "2", NOTED=str(notes))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("says", "outcome", "passed", "words"),
    [
        ("yes", "answered", True, "it says yes."),
        ("no", "answered", False, "it says no."),
        ("maybe", "answered", False, "it says maybe."),
        ("refuse", "failed", False, "the check says why it cannot."),
        ("raise", "crashed", False, "ValueError: its own mistake"),
        ("segfault", "crashed", False, r"signal 11 \(SIGSEGV\) during the question segfault"),
        ("hang", "time_limit", False, "time limit of 12 s, during the question hang"),
    ],
)
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
    assert [line for line in failing if not unsaid(line, "question: refuse of three_cart", "says why it cannot")]
    assert re.search(r"\[\d/8\] question: yes of three_cart: passed, .*it says yes", done.stderr)
    assert "only_good" in (out / "results.csv").read_text()
    assert "question" not in (out / "results.csv").read_text()
    assert not list(out.glob("runs/.partial-*"))


@pytest.mark.slow
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
    settings = CampaignSettings(out=Path(), plugin="check_fakes:PLUGIN", scenes=("three_cart",), expression="asked")
    entries, left_out = select(settings)
    assert [entry.task.title for entry in entries][:2] == ["question: yes of three_cart", "question: no of three_cart"]
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
    whole = {"kind": "k", "name": "n", "expected": "e", "function": "f:g", "arguments": {"a": 1}, "sources": ("validate/fmu_check/",)}
    return CheckTask(**{**whole, **changes})


def test_equal_content_has_equal_keys_and_other_content_another():
    key = check_key(_check())
    assert key == check_key(_check(time_limit=3.0, words=("w",), quick=False, scene="s"))
    others = [
        _check(name="m"), _check(arguments={"a": 2}), _check(content=scene_text(load_scene("three_cart"))),
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

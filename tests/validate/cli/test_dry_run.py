"""`--dry-run` prints what `all` would do, and `all` does it."""

import json
from pathlib import Path

import pytest
from wording import unsaid

from validate.cli.dry_run import _duration, _Line, _listed

pytestmark = pytest.mark.slow

FAKES = ("--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart")


def told(dry_run, out: Path, *words: str) -> dict:
    done = dry_run(*FAKES, "--out", str(out), *words, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def ran(cli, tmp_path_factory):
    """A campaign of a good cell and one that crashes."""
    out = tmp_path_factory.mktemp("ran")
    cli("all", *FAKES, "--out", str(out), "-k", "only_good or only_segfault")
    return out


def test_nothing_is_written(dry_run, tmp_path):
    out = tmp_path / "never"
    plan = told(dry_run, out, "-k", "only_good")
    assert plan["stored"] == 0
    assert plan["to_run"] == len(plan["runs"]) > 0
    assert {run["why"] for run in plan["runs"]} == {"nothing is stored of it"}
    assert not out.exists()


def test_what_is_stored_is_told_and_why_the_rest_is_run(dry_run, ran):
    plan = told(dry_run, ran, "-k", "only_good or only_segfault")
    why = {run["name"]: run["why"] for run in plan["runs"]}
    crashed = [cell for cell, reason in why.items() if reason == "stored, but it crashed"]
    assert len(crashed) == 1
    assert "segfault" in crashed[0]
    assert plan["to_run"] == 1
    assert plan["stored"] == len(why) - 1
    assert told(dry_run, ran, "-k", "only_good or only_segfault", "--fresh")["stored"] == 0


def test_another_version_is_recognised(dry_run, ran):
    """The same cells under another content, as after a change of the sources."""
    for request in ran.glob("runs/*/task.json"):
        data = json.loads(request.read_text())
        if "good" in json.dumps(data["task"]["pipeline"]):
            moved = request.parent.with_name("f" * 64)
            request.parent.rename(moved)
            break
    else:
        pytest.fail("the campaign left no good cell")
    try:
        plan = told(dry_run, ran, "-k", "only_good")
        assert not unsaid(
            {run["why"] for run in plan["runs"]}, "stored for other code", "another scene file"
        )
    finally:
        moved.rename(request.parent)


def test_damaged_requests_are_passed_over(dry_run, ran):
    bad = ran / "runs" / ("0" * 64)
    bad.mkdir()
    (bad / "task.json").write_text('{"task": [1, 2')
    (ran / "runs" / ("1" * 64)).mkdir()
    (ran / "runs" / ("1" * 64) / "task.json").write_text('"text"')
    assert told(dry_run, ran, "-k", "only_good")["stored"] >= 1


def test_the_table_ends_with_the_counts(dry_run, tmp_path):
    done = dry_run(*FAKES, "--out", str(tmp_path), "-k", "only_good or only_segfault")
    why, counts = done.stdout.splitlines()[-2:]
    assert why == "2 to run: only_good, only_segfault: nothing is stored of it"
    assert not unsaid(counts, "0 stored, 2 to run", "this folder", "at most", "after 240 s")


def test_what_no_method_applies_to_is_counted_apart(dry_run, tmp_path):
    plan = told(dry_run, tmp_path, "-k", "only_refuses or only_good")
    assert [(run["name"], run["state"], run["why"]) for run in plan["runs"]] == [
        ("three_cart x only_good", "to run", "nothing is stored of it"),
        ("three_cart x only_refuses", "not applicable", "it wants friction."),
    ]
    assert [plan[name] for name in ("stored", "not_applicable", "to_run")] == [0, 1, 1]
    words = (*FAKES, "--out", str(tmp_path), "-k", "only_refuses or only_good")
    lines = dry_run(*words).stdout.splitlines()
    assert "1 not applicable: only_refuses: it wants friction." in lines
    assert lines[-1].startswith("0 stored, 1 to run, 1 not applicable; ")
    table = dry_run(*words, "--table").stdout.splitlines()
    (row,) = [line for line in table if line.startswith("three_cart x only_refuses")]
    assert not unsaid(row, "three_cart x only_refuses", "not applicable", "it wants friction.")


def test_a_store_of_another_version_is_refused_by_every_command(cli, tmp_path):
    out = tmp_path / "old"
    out.mkdir()
    (out / "campaign.json").write_text('{"schema_version": 2}')
    work = (*FAKES, "--out", str(out), "-k", "only_good")
    for command in (("all", "--dry-run", *work), ("all", *work), ("report", str(out))):
        done = cli(*command)
        assert done.returncode == 2
        assert not unsaid(
            " ".join(done.stderr.split()),
            f"error: {out}: this store was written by another version of touchstone",
            "use another --out folder or delete it.",
        )
    assert [path.name for path in out.iterdir()] == ["campaign.json"]


def test_what_ran_before_says_how_long_it_takes(dry_run, ran):
    plan = told(dry_run, ran, "-k", "only_good or only_segfault", "--fresh")
    assert all(run["past_cpu_seconds"] > 0 for run in plan["runs"])
    words = (*FAKES, "--out", str(ran), "--fresh")
    known = dry_run(*words, "-k", "only_good or only_segfault", "-j", "2").stdout.splitlines()[-1]
    assert known.startswith("0 stored, 2 to run; 2 of them took ")
    assert "of CPU time when they ran last, about " in known
    assert known.endswith(" on 2 cores")
    partly = dry_run(*words, "-k", "only_good or only_raises", "-j", "1").stdout.splitlines()[-1]
    assert not unsaid(partly, "1 never ran here")


@pytest.mark.parametrize(
    ("scene", "jobs", "words"),
    [
        ("three_cart", 1, "at most 8 min on 1 core, as each is ended after 240 s"),
        ("three_cart", 2, "at most 4 min on 2 cores, as each is ended after 240 s"),
    ],
)
def test_duration_new_runs_is_bounded_by_their_limit(scene: str, jobs: int, words: str):
    line = _Line(f"{scene} x strict", scene, "k", "to run", "nothing is stored of it", None)
    assert _duration([line, line], jobs, 240.0).endswith(words)


def test_names_of_runs_of_several_scenes_are_cut_short():
    lines = [_Line(f"s{n} x strict", f"s{n}", "k", "to run", "why", None) for n in range(9)]
    assert _listed(lines) == "s0 x strict, s1 x strict, s2 x strict and 6 more"
    assert _listed(lines[:1]) == "strict"

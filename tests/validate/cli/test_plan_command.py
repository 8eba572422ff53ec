"""`plan` tells what `all` would do, and `all` does it."""

import json
from pathlib import Path

import pytest
from wording import unsaid

pytestmark = pytest.mark.slow

FAKES = ("--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart")


def told(cli, out: Path, *words: str) -> dict:
    done = cli("plan", *FAKES, "--out", str(out), *words, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def ran(cli, tmp_path_factory):
    """A campaign of a good cell and one that crashes."""
    out = tmp_path_factory.mktemp("ran")
    cli("all", *FAKES, "--out", str(out), "-k", "only_good or only_segfault")
    return out


def test_nothing_is_written(cli, tmp_path):
    out = tmp_path / "never"
    plan = told(cli, out, "-k", "only_good")
    assert plan["stored"] == 0
    assert plan["to_run"] == len(plan["runs"]) > 0
    assert {run["why"] for run in plan["runs"]} == {"nothing is stored of it"}
    assert not out.exists()


def test_what_is_stored_is_told_and_why_the_rest_is_run(cli, ran):
    plan = told(cli, ran, "-k", "only_good or only_segfault")
    why = {run["name"]: run["why"] for run in plan["runs"]}
    crashed = [cell for cell, reason in why.items() if reason == "stored, but it crashed"]
    assert len(crashed) == 1
    assert "segfault" in crashed[0]
    assert plan["to_run"] == 1
    assert plan["stored"] == len(why) - 1
    assert told(cli, ran, "-k", "only_good or only_segfault", "--fresh")["stored"] == 0


def test_another_version_is_recognised(cli, ran):
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
        plan = told(cli, ran, "-k", "only_good")
        assert not unsaid(
            {run["why"] for run in plan["runs"]}, "stored for other code", "another scene file"
        )
    finally:
        moved.rename(request.parent)


def test_damaged_requests_are_passed_over(cli, ran):
    bad = ran / "runs" / ("0" * 64)
    bad.mkdir()
    (bad / "task.json").write_text('{"task": [1, 2')
    (ran / "runs" / ("1" * 64)).mkdir()
    (ran / "runs" / ("1" * 64) / "task.json").write_text('"text"')
    assert told(cli, ran, "-k", "only_good")["stored"] >= 1


def test_the_table_ends_with_the_counts(cli, tmp_path):
    done = cli("plan", *FAKES, "--out", str(tmp_path), "-k", "only_good or only_segfault")
    why, counts = done.stdout.splitlines()[-2:]
    assert not unsaid(why, "2 to run: nothing is stored")
    assert not unsaid(counts, "0 stored, 2 to run", "not known", "this folder")


def test_what_a_scene_waives_and_that_it_is_unstable_is_told(cli, tmp_path):
    path = tmp_path / "waiving.py"
    path.write_text(
        "from dataclasses import replace\nfrom models.catalog import load_scene\nfrom models.scene import Limit\n"
        "CARTS = load_scene('three_cart')\n"
        "SCENE = replace(CARTS, name='waiving', unstable='It falls over.', limits=(\n"
        "    *CARTS.limits, Limit(metric='missed_impulse', value=None, reason='nothing is touched twice')))\n",
        encoding="utf-8",
    )
    words = (
        "--plugin",
        "campaign_fakes:PLUGIN",
        "--scene",
        str(path),
        "-k",
        "only_good",
        "--out",
        str(tmp_path / "out"),
    )
    told = json.loads(cli("plan", *words, "--json").stdout)
    assert told["waived"] == {"waiving": ["missed_impulse: nothing is touched twice"]}
    assert told["unstable"] == {"waiving": "It falls over."}
    lines = cli("plan", *words, "--table").stdout.splitlines()
    assert "waived by waiving: missed_impulse: nothing is touched twice" in lines
    assert [
        line
        for line in lines
        if not unsaid(line, "waiving is unstable", "feedback is enough", ": It falls over.")
    ]


def test_a_store_of_another_version_is_refused_by_every_command(cli, tmp_path):
    out = tmp_path / "old"
    out.mkdir()
    (out / "campaign.json").write_text('{"schema_version": 2}')
    work = (*FAKES, "--out", str(out), "-k", "only_good")
    for command in (("plan", *work), ("all", *work), ("report", str(out))):
        done = cli(*command)
        assert done.returncode == 2
        assert not unsaid(
            " ".join(done.stderr.split()),
            f"error: {out}: this store was written by another version of touchstone",
            "use another --out folder or delete it.",
        )
    assert [path.name for path in out.iterdir()] == ["campaign.json"]


def test_what_ran_before_says_how_long_it_takes(cli, ran):
    plan = told(cli, ran, "-k", "only_good or only_segfault", "--fresh")
    assert all(run["past_cpu_seconds"] > 0 for run in plan["runs"])
    words = ("plan", *FAKES, "--out", str(ran), "--fresh")
    known = cli(*words, "-k", "only_good or only_segfault", "-j", "2").stdout.splitlines()[-1]
    assert known.startswith("0 stored, 2 to run; 2 of them took ")
    assert "of CPU time when they ran last, about " in known
    assert known.endswith(" on 2 cores")
    partly = cli(*words, "-k", "only_good or only_raises", "-j", "1").stdout.splitlines()[-1]
    assert not unsaid(partly, "1 never ran here")

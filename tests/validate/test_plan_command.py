"""`plan` tells what `all` would do, and `all` does it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

FAKES = ("--tools", "campaign_fakes:TOOLS", "--scene", "three_cart")


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
    assert plan["to_run"] == len(plan["cells"]) > 0
    assert {cell["why"] for cell in plan["cells"]} == {"nothing is stored of it"}
    assert not out.exists()


def test_what_is_stored_is_told_and_why_the_rest_is_run(cli, ran):
    plan = told(cli, ran, "-k", "only_good or only_segfault")
    why = {cell["cell"]: cell["why"] for cell in plan["cells"]}
    crashed = [cell for cell, reason in why.items() if reason == "stored, but it crashed"]
    assert len(crashed) == 1
    assert "segfault" in crashed[0]
    assert plan["to_run"] == 1
    assert plan["stored"] == len(why) - 1
    assert told(cli, ran, "-k", "only_good or only_segfault", "--fresh")["stored"] == 0


def test_another_version_is_recognised(cli, ran):
    """The same cells under another content, as after a change of the sources."""
    for request in ran.glob("runs/*/cell.json"):
        data = json.loads(request.read_text())
        if "good" in json.dumps(data["cell"]["pipeline"]):
            moved = request.parent.with_name("f" * 64)
            request.parent.rename(moved)
            break
    else:
        pytest.fail("the campaign left no good cell")
    try:
        plan = told(cli, ran, "-k", "only_good")
        assert "stored for other code, options, libraries or another scene file" in {cell["why"] for cell in plan["cells"]}
    finally:
        moved.rename(request.parent)


def test_damaged_requests_are_passed_over(cli, ran):
    bad = ran / "runs" / ("0" * 64)
    bad.mkdir()
    (bad / "cell.json").write_text('{"cell": [1, 2')
    (ran / "runs" / ("1" * 64)).mkdir()
    (ran / "runs" / ("1" * 64) / "cell.json").write_text('"text"')
    assert told(cli, ran, "-k", "only_good")["stored"] >= 1


def test_bad_words_are_one_sentence(cli, tmp_path):
    for words in (("--time-limit", "nan"), ("-k", "nosuchpipeline"), ("--scene", "nosuchscene")):
        done = cli("plan", "--out", str(tmp_path), *words)
        assert done.returncode == 2
        assert len(done.stderr.strip().splitlines()) == 1


def test_the_table_ends_with_the_counts(cli, tmp_path):
    done = cli("plan", *FAKES, "--out", str(tmp_path), "-k", "only_good or only_segfault")
    assert done.stdout.splitlines()[-2:] == ["2 to run: nothing is stored of it", "0 stored, 2 to run"]

"""What is run again: --lf, -x, --retry, and the command that `show` prints."""

import json
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from killed_campaigns import FAKES_FOLDER
from wording import unsaid

from validate.campaign.campaign import run_campaign
from validate.campaign.runs import CampaignSettings, select, with_stored
from validate.cli.narrator import PlainNarrator
from validate.store.provenance import command_line
from validate.store.store import Store

pytestmark = pytest.mark.slow

FAKES = ("--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart")
CHOICE = "only_good or only_raises or only_exit_seven"


@pytest.fixture(scope="module")
def ran(cli, tmp_path_factory):
    """One cell that holds and two that fail."""
    out = tmp_path_factory.mktemp("ran")
    done = cli("all", *FAKES, "--out", str(out), "-k", CHOICE)
    assert done.returncode == 1
    return out


def names(out: Path) -> list[str]:
    return sorted(
        json.loads(path.read_text())["pipeline"] for path in out.glob("runs/*/record.json")
    )


def test_last_failed_runs_those_and_keeps_the_rest(cli, dry_run, ran):
    done = dry_run(*FAKES, "--out", str(ran), "--lf", "--json")
    plan = json.loads(done.stdout)
    why = {run["name"].split(" x ")[1]: run["why"] for run in plan["runs"]}
    assert why == {
        "only_good": "",
        "only_raises": "it failed the last time",
        "only_exit_seven": "it failed the last time",
    }
    again = cli("all", *FAKES, "--out", str(ran), "--lf", "--json")
    assert again.stderr.splitlines()[0] == "1 stored, 2 to run"
    assert {row["pipeline"] for row in json.loads(again.stdout)["results"]} == set(why)


def test_last_failed_of_what_did_not_fail(cli, ran):
    done = cli("all", *FAKES, "--out", str(ran), "--lf", "-k", "only_good")
    assert done.returncode == 2
    assert not unsaid(
        done.stderr,
        "nothing that is selected failed",
        "not selected (three_cart x ",
        "-k, --scene, --plugin",
    )


class _Stopped(PlainNarrator):
    """Ctrl-C comes when the first cell has finished."""

    def finished(self, record) -> None:
        super().finished(record)
        raise KeyboardInterrupt


def test_fresh_interrupted_goes_on(tmp_path, monkeypatch):
    """The same command without --fresh runs only the runs that --fresh did not reach."""
    monkeypatch.setenv("PYTHONPATH", str(FAKES_FOLDER))
    settings = CampaignSettings(
        out=tmp_path,
        plugin=FAKES[1],
        scenes=FAKES[3:],
        expression="only_good or only_infeasible",
        jobs=1,
        worlds=False,
    )
    whole = run_campaign(settings, PlainNarrator())
    before = {path: path.read_bytes() for path in tmp_path.glob("runs/*/record.json")}
    stopped = _Stopped()
    with pytest.raises(KeyboardInterrupt):
        run_campaign(replace(settings, fresh=True), stopped)
    assert (stopped.stored, stopped.done, stopped.total) == (0, 1, 2)
    assert stopped.so_far(tmp_path) == f"1 of 2 runs are stored in {tmp_path}"
    assert len(list(tmp_path.glob("runs/*/record.json"))) == 1
    resumed = PlainNarrator()
    again = run_campaign(settings, resumed)
    assert (resumed.stored, resumed.done) == (1, 1)
    assert [record.key for record in again.records] == [record.key for record in whole.records]
    assert all(path.read_bytes() != content for path, content in before.items())
    store, (chosen, _) = Store(tmp_path), select(settings)
    assert all(entry.stored for entry in with_stored(chosen, store, settings))


def test_what_a_stop_at_the_first_failure_leaves_stays_as_it_is(cli, dry_run, ran):
    done = cli("all", *FAKES, "--out", str(ran), "--lf", "-x", "-j", "1")
    assert done.stderr.splitlines()[0] == "1 stored, 2 to run"
    assert not unsaid(
        done.stderr,
        "first failure (-x)",
        f"2 of 3 runs are stored in {ran}",
    )
    plan = json.loads(dry_run(*FAKES, "--out", str(ran), "-k", CHOICE, "--json").stdout)
    assert {run["why"] for run in plan["runs"]} == {"", "stored, but it crashed"}


def test_stop_at_the_first_failure(cli, tmp_path):
    done = cli(
        "all",
        *FAKES,
        "--out",
        str(tmp_path),
        "-k",
        "only_exit_seven or only_slow or only_raises",
        "-x",
        "-j",
        "1",
    )
    assert done.returncode == 1
    assert not unsaid(done.stderr, "first failure (-x)", f"1 of 3 runs are stored in {tmp_path}")
    assert names(tmp_path) == ["only_exit_seven"]
    assert done.stdout.splitlines()[-1].endswith(" -x -j 1"), "the command as it was typed"


def test_show_tells_all_of_a_run_and_how_to_run_it_again(cli, ran, tmp_path):
    done = cli("show", "three_cart x only_good", "--in", str(ran))
    assert done.returncode == 0, done.stderr
    for word in (
        "holds: it is a fake",
        "three_cart x only_good: solved",
        "terminal_error",
        "options of stage 1 (good): iterations = 7",
        "log",
        str(ran),
    ):
        assert not unsaid(done.stdout, word)
    again = shlex.split(done.stdout.splitlines()[-1].removeprefix("again: "))
    assert again[again.index("-k") + 1] == '="three_cart x only_good"'
    repeated = cli(*again[3:-1], str(tmp_path))
    assert repeated.returncode == 0, repeated.stderr
    assert names(tmp_path) == ["only_good"]
    record = json.loads(cli("show", str(next(tmp_path.glob("runs/*"))), "--json").stdout)
    assert record["pipeline"] == "only_good"


def test_show_of_a_failure_ends_with_1_and_its_log(cli, ran):
    done = cli("show", "only_raises", "--in", str(ran))
    assert done.returncode == 1
    assert done.stdout.split("\nlog, ")[0].count("the method's own mistake") == 1


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("three_cart", "means 3 runs"),
        ("only_gud", "did you mean three_cart x only_good?"),
        ("\x1b[31m", "there is no run"),
    ],
)
def test_show_of_no_run_or_several(cli, ran, name, words):
    done = cli("show", name, "--in", str(ran))
    assert done.returncode == 2
    assert not unsaid(done.stderr, words)
    assert len(done.stderr.splitlines()) == 1


def test_the_command_can_be_typed_again_in_any_shell():
    """zsh takes =strict for the path of a program called strict."""
    told = command_line(
        ["all", "-k", "=strict", "--out", "my runs", "--scene", "it's.py", "-k", ""]
    )
    assert shlex.split(told) == [
        "python",
        "-m",
        "validate",
        "all",
        "-k",
        "=strict",
        "--out",
        "my runs",
        "--scene",
        "it's.py",
        "-k",
        "",
    ]
    assert "-k '=strict' --out 'my runs'" in told

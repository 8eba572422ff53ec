"""Cells that misbehave: each is the right row, disturbs nothing else, and leaves neither process nor file behind."""

import gzip
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from killed_campaigns import FAKES_FOLDER, processes, records, unfinished, untimed
from standing_cluster import come
from wording import unsaid

from validate.campaign.campaign import run_campaign
from validate.campaign.runs import CampaignSettings
from validate.cli.narrator import PlainNarrator
from validate.processes.process import interrupts_wait
from validate.store.store import Store

pytestmark = [pytest.mark.process, pytest.mark.slow]

FAKES = ("--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart")
KEPT = {"task.json", "log.txt", "record.json", "files.json"}


@pytest.fixture(scope="module")
def misbehaved(cli, tmp_path_factory):
    """One campaign over every kind of misbehaviour that ends by itself."""
    out = tmp_path_factory.mktemp("misbehaved")
    done = cli(
        "all", *FAKES, "--out", str(out), "-j", "2", "--no-worlds",
        "-k", "not hang and not family and not slow",
    )  # fmt: skip
    return out, done


@pytest.mark.parametrize(("pipeline", "outcome", "words"), [
    ("only_good", "solved", ""),
    ("only_segfault", "crashed", "signal 11 (SIGSEGV) during stage 1 (segfault)"),
    ("only_abort", "crashed", "signal 6 (SIGABRT)"),
    ("only_exit_zero", "crashed", "exit code 0 during stage 1 (exit_zero); … no result"),
    ("only_exit_seven", "crashed", "exit code 7"),
    ("only_spoiled", "crashed", "its result file cannot be read"),
    ("only_raises", "crashed", "ValueError in raises: the method's own mistake"),
    ("only_bad_soft", "crashed", "ValueError in bad_soft"),
    ("only_misfit", "failed", "q has 1 columns, but scene three_cart has 3 positions"),
    ("only_no_solution", "crashed", "Solution, not str"),
    ("only_quits", "crashed", "its last log line: SystemExit: 0"),
    ("only_refuses", "refused", "it wants friction"), ("only_infeasible", "infeasible", ""),
    ("only_garbage", "solved", ""), ("only_litter", "solved", ""),
])  # fmt: skip
def test_every_end_is_the_right_row(misbehaved, pipeline, outcome, words):
    record = records(misbehaved[0])[pipeline]
    assert record.outcome == outcome
    assert not unsaid(record.message, words)
    assert "\n" not in record.message
    assert [stage.outcome for stage in record.stages] == [outcome]
    without = {"solved": False, "refused": record.verdict == "not applicable"}.get(
        outcome, record.verdict == "no plan"
    )
    assert without == (outcome != "solved")
    assert (record.verdict == "not applicable") == (outcome == "refused"), (
        "never counted with failures"
    )


def test_the_traceback_is_in_the_log_and_not_on_the_screen(misbehaved):
    out, done = misbehaved
    record = records(out)["only_raises"]
    assert "Traceback" in (out / "runs" / record.key / "log.txt").read_text()
    assert "Traceback" in record.log_tail
    assert "Traceback" not in done.stdout + done.stderr


def test_stages_after_a_failed_one_are_rows_too(misbehaved):
    out, _ = misbehaved
    record = records(out)["broken_chain"]
    assert [stage.outcome for stage in record.stages] == ["solved", "crashed", "crashed"]
    assert (
        record.message
        == record.stages[1].message
        == "ValueError in bad_soft: the method's own mistake"
    )
    assert not unsaid(
        record.stages[2].message, "not begun", "stage 2 (bad_soft, eps 0.1)", "no answer"
    )
    assert record.stages[0].verdict == "holds"
    assert (out / "runs" / record.key / "trajectory_1.nc").exists()


def test_nothing_is_left_behind(misbehaved):
    out, _ = misbehaved
    assert processes(out) == []
    assert [path.name for path in (out / "runs").iterdir() if path.name.startswith(".")] == []
    for record in records(out).values():
        names = {path.name for path in (out / "runs" / record.key).iterdir()}
        assert names >= KEPT
        assert {Path(name).suffix for name in names - KEPT} <= {".nc"}
    told = {"campaign.json", "results.csv", "violation.csv", "report.html"}
    assert {path.name for path in out.iterdir()} == {"runs", "legs", *told}
    legs = [
        json.loads(gzip.decompress(path.read_bytes()))
        for path in (out / "legs").glob("*/leg.json.gz")
    ]
    assert len(list((out / "legs").iterdir())) == len(legs)
    assert len({leg["pipeline"] for leg in legs}) > 3
    ended = {"solved", "failed", "infeasible", "stalled", "iteration_limit", "unbounded"}
    assert {stage["outcome"] for leg in legs for stage in leg["stages"]} <= ended


def test_crashes_fail_the_campaign_and_honest_endings_do_not(misbehaved):
    _, done = misbehaved
    assert done.returncode == 1
    failed = {
        name
        for line in done.stdout.splitlines()
        if line.startswith("fails: ")
        for name in re.findall(r"three_cart x (\w+)", line)
    }
    crashed = {
        "only_segfault",
        "only_abort",
        "only_exit_zero",
        "only_exit_seven",
        "only_spoiled",
        "only_raises",
        "only_bad_soft",
        "broken_chain",
    }
    assert failed == {*crashed, "only_misfit", "only_no_solution", "only_quits"}


def test_progress_is_one_plain_line_a_cell(misbehaved):
    folder, done = misbehaved
    lines = [line for line in done.stderr.splitlines() if not line.startswith("report:")]
    assert lines[0] == "0 stored, 19 to run"
    refused = [line for line in lines if line.startswith("not applicable: ")]
    assert sum(line.startswith("[") for line in lines) == len(lines) - 2 - len(refused), (
        "and nothing else"
    )
    names = [name for line in refused for name in line.split(": ")[1].split(", ")]
    assert (
        set(names)
        == {name for name, record in records(folder).items() if record.verdict == "not applicable"}
        != set()
    )
    assert len(lines) - 2 - len(refused) == 19 - len(names)
    assert lines[-1].startswith("so far: three_cart: "), "all runs of the scene have ended"
    assert "\x1b" not in done.stderr + done.stdout


def test_a_chain_starts_each_stage_from_the_plan_before(misbehaved):
    record = records(misbehaved[0])["soft+good"]
    expected = [("soft", 0.1, 0.0), ("soft", 0.01, 1000.0), ("good", None, 4000.0)]
    assert [(stage.method, stage.eps, stage.cost) for stage in record.stages] == expected
    assert [stage.options["iterations"] for stage in record.stages] == [2, 7, 7]
    assert record.stages[2].seconds.total >= record.stages[2].seconds.wall
    assert record.must_hold
    assert not records(misbehaved[0])["soft_alone"].must_hold


def test_a_hanging_cell_ends_at_its_time_limit_with_its_family(cli, tmp_path):
    done = cli(
        "all",
        *FAKES,
        "--out",
        str(tmp_path),
        "-j",
        "2",
        "-k",
        "only_hang or only_family",
        "--time-limit",
        "4",
    )
    found = records(tmp_path)
    assert {record.outcome for record in found.values()} == {"time_limit"}
    assert all("time" in record.message for record in found.values())
    assert done.returncode == 1
    assert processes(tmp_path) == []
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == sorted(
        record.key for record in found.values()
    )


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_campaign_keeps_what_finished_and_resumes(cli, start_cli, tmp_path, ending):
    arguments = ("all", *FAKES, "--out", str(tmp_path), "-j", "1", "-k", "only_good or only_family")
    process = start_cli(*arguments)
    come(lambda: len(processes(tmp_path)) >= 4)  # the cell, its supervisor and both its children
    process.send_signal(ending)
    _, told = process.communicate()
    assert process.returncode == 130
    assert "interrupted: 1 of 2 runs are stored" in told
    assert (
        f"resume with: {sys.executable} -m validate all {' '.join(FAKES)} --out {tmp_path}" in told
    )
    assert processes(tmp_path) == []
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [
        records(tmp_path)["only_good"].key
    ]
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 2
    again = cli("all", *FAKES, "--out", str(tmp_path), "-k", "only_good")
    assert "1 stored, 0 to run" in again.stderr
    assert "Traceback" not in told


def test_what_is_stored_when_ctrl_c_comes_is_told_of(tmp_path, monkeypatch):
    """Nobody has heard of the cell by then."""
    commit, heard = Store.commit, PlainNarrator()

    def interrupted(store: Store, partial: Path, key: str) -> Path:
        commit(store, partial, key)
        raise KeyboardInterrupt

    monkeypatch.setattr(Store, "commit", interrupted)
    monkeypatch.setenv("PYTHONPATH", str(FAKES_FOLDER))
    settings = CampaignSettings(
        out=tmp_path,
        plugin=FAKES[1],
        scenes=FAKES[3:],
        expression="only_good or only_infeasible",
        jobs=1,
    )
    with pytest.raises(KeyboardInterrupt):
        run_campaign(settings, heard)
    (record,) = records(tmp_path).values()
    assert (heard.stored, heard.done, heard.total) == (0, 1, 2)
    assert [row["pipeline"] for row in untimed(tmp_path)] == [record.pipeline]
    assert unfinished(tmp_path) == []


def test_what_nohup_ignores_stays_ignored(cli_environment, tmp_path):
    command = [
        sys.executable,
        "-m",
        "validate",
        "all",
        *FAKES,
        "--out",
        str(tmp_path),
        "-k",
        "only_good",
    ]
    deaf = ["sh", "-c", "trap '' HUP; exec \"$@\"", "sh", *command]
    with subprocess.Popen(
        deaf, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=cli_environment
    ) as process:
        assert process.stderr.readline() == "0 stored, 1 to run\n"
        process.send_signal(signal.SIGHUP)
        process.communicate()
    assert process.returncode == 0


def test_a_cell_knows_how_it_was_run(misbehaved):
    out, _ = misbehaved
    record = records(out)["only_good"]
    request = json.loads((out / "runs" / record.key / "task.json").read_text())
    assert request["task"]["time_limit"] == 240.0
    assert record.provenance.threads == 1
    assert record.provenance.command.startswith("python -m validate all --plugin")
    assert record.provenance.packages["numpy"]


@pytest.fixture
def ctrl_c():
    """A function that is Ctrl-C, which what runs in the background of a shell would not hear."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield lambda: os.kill(os.getpid(), signal.SIGINT)
    signal.signal(signal.SIGINT, before)


class _Interrupting(PlainNarrator):
    """Ctrl-C comes when the last cell has finished and the tables are about to be written."""

    def __init__(self, ctrl_c) -> None:
        super().__init__()
        self._ctrl_c = ctrl_c

    def ends(self) -> None:
        self._ctrl_c()


def test_ctrl_c_while_the_tables_are_written_is_heard_when_they_are(tmp_path, monkeypatch, ctrl_c):
    monkeypatch.setenv("PYTHONPATH", str(FAKES_FOLDER))
    settings = CampaignSettings(
        out=tmp_path,
        plugin=FAKES[1],
        scenes=FAKES[3:],
        expression="only_good or only_infeasible",
        jobs=1,
    )
    with pytest.raises(KeyboardInterrupt):
        run_campaign(settings, _Interrupting(ctrl_c))
    assert sorted(row["pipeline"] for row in untimed(tmp_path)) == ["only_good", "only_infeasible"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_ctrl_c_is_not_held_back(ctrl_c):
    reached = []

    def twice() -> None:
        with interrupts_wait():
            ctrl_c()
            reached.append("the first waits")
            ctrl_c()
            reached.append("never")

    with pytest.raises(KeyboardInterrupt):
        twice()
    assert reached == ["the first waits"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler

"""Engines that lose what they run on: workers, the scheduler, the campaign itself.

What finished stays, and nothing goes on for nobody.
"""

import contextlib
import importlib.util
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest
from killed_campaigns import finished, processes, records, unfinished, untimed
from standing_cluster import come, standing_cluster
from wording import unsaid

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(
        importlib.util.find_spec("distributed") is None,
        reason="distributed is not installed (the extra `dask`)",
    ),
]
FAKES = ("--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart")
# One ends at once and one never does, with children that left its group.
HALF = (*FAKES, "-k", "only_good or only_family", "-j", "1")


@pytest.mark.slow
def test_a_lost_worker_is_replaced_as_often_as_dask_allows(cli, tmp_path):
    """After the first loss the cell runs again.

    Two are one more than is allowed here, and it has crashed. The other one waited on the worker
    both

    times, and is none the worse.
    """
    counts, out = tmp_path / "counts", tmp_path / "out"
    counts.mkdir()
    # A loaded machine takes longer than Dask's 15 s to start a worker anew: here every machine
    # takes longer than is told.
    dask = {
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
        "DASK_DISTRIBUTED__DEPLOY__LOST_WORKER_TIMEOUT": "100ms",
    }
    asked = {"COUNTS": str(counts), "KILL": "fatal", "KILLS": "2", **dask}
    done = cli(
        "all",
        "--plugin",
        "leg_fakes:LOSING",
        "--scene",
        "three_cart",
        "--engine",
        "dask",
        "-j",
        "1",
        "--out",
        str(out),
        **asked,
    )
    assert done.returncode == 1, done.stderr
    calm, fatal = (records(out)[name] for name in ("calm", "fatal"))
    assert calm.outcome == "solved", done.stderr
    assert (fatal.outcome, fatal.message) == (
        "crashed",
        "2 workers of the Dask cluster were lost while they ran it.",
    )
    assert len(list(counts.glob("fatal-*"))) == 2
    assert len(list(counts.glob("calm-*"))) == 1
    assert unfinished(out) == []
    assert processes(out) == []


@pytest.mark.slow
def test_a_killed_campaign_takes_its_dask_workers_with_it_and_is_resumed_by_another_engine(
    cli, start_cli, tmp_path, monkeypatch, cli_environment
):
    temporary, out, whole = tmp_path / "tmp", tmp_path / "out", tmp_path / "whole"
    temporary.mkdir()
    rest = (*FAKES, "-k", "only_good or only_infeasible")
    assert cli("all", *rest, "--out", str(whole)).returncode == 0
    with monkeypatch.context() as patch:
        patch.setitem(cli_environment, "TMPDIR", str(temporary))
        process = start_cli("all", *HALF, "--engine", "dask", "--out", str(out))
    come(lambda: len(processes(out)) >= 4 and len(finished(out)) == 1)
    kept = finished(out)
    process.kill()
    process.communicate()
    come(
        lambda: (
            processes(temporary) == [] and unfinished(out) == [] and list(temporary.iterdir()) == []
        )
    )
    assert processes(out) == []
    assert finished(out) == kept
    resumed = cli("all", *rest, "--out", str(out))
    assert "1 stored, 1 to run" in resumed.stderr
    assert untimed(out) == untimed(whole)
    assert set(finished(out)) == set(finished(whole))


@pytest.mark.slow
def test_a_lost_scheduler_is_one_sentence_and_what_finished_is_stored(
    start_cli, cli_environment, tmp_path
):
    out, logs = tmp_path / "out", tmp_path / "logs"
    logs.mkdir()
    with standing_cluster(logs, cli_environment, workers=1) as (file, lost):
        process = start_cli("all", *HALF, "--engine", f"dask:{file}", "--out", str(out))
        come(lambda: len(processes(out)) >= 4 and len(finished(out)) == 1)
        lost.send_signal(signal.SIGKILL)
        _, told = process.communicate()
        come(lambda: processes(out) == [])
    assert process.returncode == 3, told
    (sentence,) = [line for line in told.splitlines() if line.startswith("error:")]
    assert not unsaid(sentence, "Dask scheduler is gone", "is stored", "same command goes on")
    assert (
        f"stopped: 1 of 2 runs are stored in {out}; resume with: {sys.executable} -m validate all"
        in told
    )
    assert "Traceback" not in told
    assert [row["pipeline"] for row in untimed(out)] == ["only_good"]
    assert unfinished(out) == []


@contextlib.contextmanager
def _silent() -> Iterator[str]:
    """The address of something that takes every connection and never says a word."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken: list[socket.socket] = []

        def take() -> None:
            with contextlib.suppress(OSError):
                while True:
                    taken.append(server.accept()[0])

        thread = threading.Thread(target=take, daemon=True)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
        for connection in taken:
            connection.close()


_ASKED = """
import sys
from models.errors import MachineError
from validate.campaign.dask import engine as dask_cluster
dask_cluster._CONNECT = 1.0
for where in sys.argv[1:]:
    try:
        with dask_cluster.remote_cluster(where):
            print("it answered")
    except MachineError as error:
        print(error)
"""


@pytest.mark.slow
def test_an_address_where_no_scheduler_answers_is_one_sentence(cli_environment):
    wrong = [
        "nonsense://x",
        "127.0.0.1:notaport",
        "tcp://",
        "tls://127.0.0.1:9",
        "tcp://127.0.0.1:9",
        "tcp://no.such.host.invalid:8786",
    ]
    with _silent() as silent:
        asked = [*wrong, silent]
        done = subprocess.run(
            [sys.executable, "-c", _ASKED, *asked],
            capture_output=True,
            text=True,
            env=cli_environment,
            check=False,
        )
    told = done.stdout.splitlines()
    assert [line.partition(": no Dask scheduler answers there (")[0] for line in told] == [
        f"--engine dask:{where}" for where in asked
    ], done.stderr
    assert all(line.endswith("); start one, or correct the address.") for line in told)
    assert done.stderr == ""

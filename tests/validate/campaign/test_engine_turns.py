"""Whose turn it is in an engine, and whose fault what ends it: each engine beside workers and a cluster that only answer."""

import contextlib
import importlib
import importlib.util
import re
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from wording import unsaid

from formulations.method import Pipeline
from models.errors import MachineError
from touchstone_annexes import is_present
from validate.campaign import scheduler
from validate.campaign.engine import (
    EngineError,
    ExecutionContext,
    LocalEngine,
    check_engine,
    open_local,
)
from validate.campaign.runs import CampaignSettings, select
from validate.campaign.scheduler import dependencies, run_tasks
from validate.processes.process import usable_cores
from validate.store.provenance import gather
from validate.store.store import Store
from validate.tasks.task import ChildExit, PlannedLeg, RunTask
from validate.tasks.worker import record_for_crash

pytestmark = pytest.mark.process

NEEDS_DASK = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None or not is_present("validate.campaign.dask"),
    reason="distributed (the extra `dask`) or the annex is not installed",
)


class Campaign:
    """Three cells, of which `crashing` crash, each time they are begun.

    begun: their keys, in order; silent: how often no answer comes.
    """

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "fakes"))
        settings = CampaignSettings(
            out=folder,
            plugin="campaign_fakes:PLUGIN",
            scenes=("three_cart",),
            expression="only_good or only_segfault or only_hang",
        )
        self.entries = select(settings)[0]
        self.tasks = [entry.task for entry in self.entries]
        self.crashing: set[str] = set()
        self.begun: list[str] = []
        self.silent, self.tries = 0, 2
        self.watch: Any = lambda running: None
        self.dumb, self.told = False, list[str]()
        self.cluster: Any = None  # that of a Dask client: one of this machine, if it is one
        self._provenance, store = gather("a test"), Store(folder)
        store.prepare()
        self.context = ExecutionContext(store=store, provenance=self._provenance)

    def record(self, key: str):
        self.begun.append(key)
        (entry,) = [entry for entry in self.entries if entry.task.key == key]
        outcome = "crashed" if key in self.crashing else "time_limit"
        child = ChildExit(outcome=outcome, message="as told", wall=0.0, cpu=0.0, log="")
        return record_for_crash(
            entry.task, self._provenance, child, self.context.store.runs, entry.loaded
        )

    def run(self, engine: Any) -> list[str]:
        """Keys of the records, in order."""
        narrator: Any = SimpleNamespace(
            runs=lambda running: self.watch(running), warns=self.told.append
        )
        return [
            record.key
            for record in run_tasks(self.tasks, engine, self.context, self.tries - 1, narrator)
        ]

    def local(self) -> LocalEngine:
        engine = LocalEngine(1, self.context, None)
        engine._run = lambda task: self.record(task.key)
        return engine

    def dask(self) -> Any:
        client = SimpleNamespace(
            nthreads=lambda: {},
            get_executor=lambda pure: self,
            scheduler=SimpleNamespace(address="here"),
            cluster=self.cluster,
        )
        return importlib.import_module("validate.campaign.dask").DaskEngine(
            client, self.context, 1, self.context.store.runs / "mark", len(self.tasks)
        )

    def submit(self, _function: Any, task: Any, _name: str) -> Future[Any]:
        future: Future[Any] = Future()
        self.silent -= 1
        if not self.dumb:
            future.set_result(None if self.silent >= 0 else self.record(task.key))
        return future

    def shutdown(self, wait: bool) -> None:
        assert not wait


@pytest.fixture
def campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Campaign:
    return Campaign(tmp_path / "out", monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local", pytest.param("dask", marks=NEEDS_DASK)])
def test_who_crashed_is_tried_again_before_all_that_wait(campaign: Campaign, engine: str):
    """So that -x ends a campaign as soon as the tries are used up, however many cells wait."""
    one, two, three = (task.key for task in campaign.tasks)
    campaign.crashing, campaign.tries = {one}, 3
    done = campaign.run(getattr(campaign, engine)())
    assert campaign.begun == [one, one, one, two, three]
    assert done == [one, two, three]


class _Two:
    """An engine for two cells at a time, each of which ends at the second look; started: in order.

    beside: what ran at each look.
    """

    jobs = 2

    def __init__(self) -> None:
        self.started: list[str] = []
        self.beside: list[set[str]] = []
        self._looks: dict[Future[Any], list[Any]] = {}

    def submit(self, cell: RunTask) -> Future[Any]:
        future: Future[Any] = Future()
        self.started.append(cell.key)
        self._looks[future] = [cell, 2]
        return future

    def result(self, cell: RunTask, future: Future[Any]) -> Any:
        return future.result()

    def look(self, _running: Sequence[Any]) -> None:
        self.beside.append({cell.key for cell, _ in self._looks.values()})
        for future, told in tuple(self._looks.items()):
            told[1] -= 1
            if not told[1]:
                del self._looks[future]
                future.set_result(SimpleNamespace(key=told[0].key, outcome="solved"))


def _run_of(name: str, legs: str, uses: tuple[str, ...] = ()) -> RunTask:
    """A run whose legs are called by one letter each."""
    path = tuple(PlannedLeg(n, n + 1, leg, f"{leg} alone") for n, leg in enumerate(legs))
    pipeline = Pipeline(name=name, title=name, legs=())
    return RunTask(
        key=name, scene="s", scene_name="s", pipeline=pipeline, plugin="", time_limit=1.0,
        legs=path, uses=uses,
    )  # fmt: skip


def test_dependencies_first_run_makes_the_common_leg():
    tasks = [_run_of("one", "ab"), _run_of("two", "ac"), _run_of("three", "d")]
    assert dependencies(tasks) == {"one": set(), "two": {"one"}, "three": set()}


def test_dependencies_leg_that_may_begin_its_path():
    """The second run may leave its start; its leg is then the first run's."""
    tasks = [_run_of("one", "a"), _run_of("two", "b")]
    tasks[1] = replace(tasks[1], legs=(PlannedLeg(0, 1, "b", "a"),))
    assert dependencies(tasks)["two"] == {"one"}


def test_dependencies_run_that_reads_legs_of_later_runs():
    tasks = [_run_of("best", "x", uses=("a", "z")), _run_of("one", "a"), _run_of("two", "y")]
    assert dependencies(tasks) == {"best": {"one"}, "one": set(), "two": set()}


def test_dependencies_runs_that_read_each_other_do_not_wait():
    tasks = [_run_of("one", "a", uses=("b",)), _run_of("two", "b", uses=("a",))]
    assert dependencies(tasks) == {"one": set(), "two": set()}


def test_run_tasks_starts_a_task_after_its_dependencies(campaign: Campaign):
    engine: Any = _Two()
    tasks: list[Any] = [
        _run_of("best", "x", uses=("a", "b")),
        _run_of("a1", "a"),
        _run_of("a2", "ac"),
        _run_of("b1", "b"),
        _run_of("b2", "bd"),
    ]
    narrator: Any = SimpleNamespace(runs=engine.look)
    done = [record.key for record in run_tasks(tasks, engine, campaign.context, 0, narrator)]
    assert engine.started[:2] == ["a1", "b1"]
    assert sorted(engine.started[2:]) == ["a2", "b2", "best"]
    assert sorted(done) == sorted(engine.started)
    assert max(map(len, engine.beside)) == 2
    assert {"a1", "a2"} not in engine.beside


@pytest.mark.parametrize(("jobs", "expected"), [(None, usable_cores()), (1, 1), (3, 3)])
def test_without_a_number_of_jobs_a_campaign_takes_every_core(
    campaign: Campaign, jobs: int | None, expected: int
):
    with open_local(jobs, campaign.context, 1) as engine:
        assert engine.jobs == expected


@pytest.mark.parametrize("name", ["slurm", "local:", "local:2", ""])
def test_check_engine_unknown_name_lists_the_engines(name: str):
    check_engine("local")
    words = re.escape(f"--engine {name}: there is no such engine; the engines are local")
    with pytest.raises(EngineError, match=words):
        check_engine(name)


@NEEDS_DASK
def test_what_is_not_the_cluster_s_is_not_said_of_it(campaign: Campaign):
    """Whoever reads our progress may have had enough of it."""

    def closed(_running: Sequence[Any]) -> None:
        raise BrokenPipeError

    campaign.watch = closed
    with pytest.raises(BrokenPipeError):
        campaign.run(campaign.dask())


@pytest.mark.slow
@NEEDS_DASK
def test_a_cluster_without_workers_is_waited_for_and_told_of_once(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
):
    looks: list[Any] = []

    def watch(running: Sequence[Any]) -> None:
        looks.append(running)
        if len(looks) > 5:
            raise BrokenPipeError

    campaign.watch, campaign.dumb = watch, True
    monkeypatch.setattr(scheduler, "_IDLE_CHECK_S", 0.1)
    with pytest.raises(BrokenPipeError):
        campaign.run(campaign.dask())
    (said,) = campaign.told
    assert not unsaid(said, "Dask cluster at here", "no workers now", "1 tasks wait")


@NEEDS_DASK
def test_workers_of_this_machine_that_nobody_starts_anew_are_not_waited_for(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
):
    from distributed import Status  # pyright: ignore[reportMissingImports]

    nannies = [SimpleNamespace(status=Status.closed), SimpleNamespace(status=Status.failed)]
    campaign.cluster, campaign.dumb = SimpleNamespace(workers=dict(enumerate(nannies))), True
    monkeypatch.setattr(scheduler, "_IDLE_CHECK_S", 0.0)
    with pytest.raises(MachineError) as caught:
        campaign.run(campaign.dask())
    assert not unsaid(
        caught.value,
        "--engine dask",
        "workers ended",
        "1 tasks wait",
        "same command",
        "--engine local",
    )
    nannies[0].status = Status.running  # it starts one
    assert "no workers now" in campaign.dask().why_idle(1)


@NEEDS_DASK
def test_a_cell_that_a_worker_gave_up_is_given_out_anew(campaign: Campaign):
    campaign.silent = 5
    assert campaign.run(campaign.dask()) == [task.key for task in campaign.tasks]
    campaign.silent = 6
    with pytest.raises(
        MachineError, match=f"lost before they begin {campaign.tasks[0].title}; their logs"
    ):
        campaign.run(campaign.dask())


@NEEDS_DASK
def test_workers_that_cannot_be_started_here_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    import distributed  # pyright: ignore[reportMissingImports]

    def refuses(**_: Any) -> None:
        raise RuntimeError("Cluster failed to start: no more processes\nand much more")

    monkeypatch.setattr(distributed, "LocalCluster", refuses)
    for folder, why in (
        (tmp_path, "Cluster failed to start: no more processes"),
        (tmp_path / "none", r"\[Errno 2\] No such file or directory: .*"),
    ):
        monkeypatch.setattr(tempfile, "tempdir", str(folder))
        with pytest.raises(
            MachineError, match=rf"^--engine dask: .*cannot be started.*\({why}\); make room"
        ) as caught:
            _enter(importlib.import_module("validate.campaign.dask").local_cluster(1))
        assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def _enter(context: contextlib.AbstractContextManager[Iterator[Any]]) -> None:
    with context:
        raise AssertionError("it began")

"""Whose turn it is in an engine, and whose fault what ends it: each engine beside workers and a cluster that only answer."""

from __future__ import annotations

import contextlib
import importlib.util
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from models.errors import MachineError
from validate.execution.campaign import Settings, select
from validate.execution.dask import DaskEngine, local_cluster
from validate.execution.engine import LocalEngine, Site
from validate.execution.worker import Lost
from validate.plan.runs import Entry
from validate.store.provenance import gather
from validate.store.store import Store

NEEDS_DASK = pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="distributed is not installed (the extra `dask`)")


class Campaign:
    """Three cells, of which `crashing` crash, each time they are begun; begun: their keys, in order; silent: how often no answer comes."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.syspath_prepend(str(Path(__file__).parent))
        settings = Settings(
            out=folder, tools="campaign_fakes:TOOLS", scenes=("three_cart",), expression="only_good or only_segfault or only_hang"
        )
        self.entries = [entry for entry in select(settings)[0] if isinstance(entry, Entry)]
        self.cells = [entry.cell for entry in self.entries]
        self.crashing: set[str] = set()
        self.begun: list[str] = []
        self.silent, self.tries, self.crashes = 0, 2, Counter[str]()
        self.watch: Any = lambda running: None
        self._provenance, self._store = gather("a test"), Store(folder)
        self._store.prepare()

    def record(self, key: str):
        self.begun.append(key)
        (entry,) = [entry for entry in self.entries if entry.cell.key == key]
        outcome = "crashed" if key in self.crashing else "time_limit"
        return entry.lost(self._provenance)(Lost(outcome=outcome, message="as told", wall=0.0, cpu=0.0, log=""), self._store.runs)

    def again(self, record: Any) -> bool:
        self.crashes[record.key] += record.outcome == "crashed"
        return record.outcome == "crashed" and self.crashes[record.key] < self.tries

    def local(self) -> LocalEngine:
        def start(cell: Any) -> Any:
            return SimpleNamespace(cell=cell, poll=lambda: self.record(cell.key), stop=lambda: None)

        return LocalEngine(start, 1, again=self.again)

    def dask(self) -> DaskEngine:
        site = Site(
            store=self._store,
            provenance=self._provenance,
            lost=lambda cell: pytest.fail("no cell is lost here"),
            watch=lambda running: self.watch(running),
            must_wait=lambda cell, running: False,
            again=self.again,
            warn=lambda sentence: None,
        )
        client = SimpleNamespace(nthreads=lambda: {"a worker": 1}, get_executor=lambda pure: self)
        return DaskEngine(client, site, 1, "0" * 16, self._store.runs / "mark")

    def submit(self, _function: Any, request: dict[str, Any]) -> Future[dict[str, str]]:
        future: Future[dict[str, str]] = Future()
        self.silent -= 1
        future.set_result({} if self.silent >= 0 else {"record": self.record(request["cell"]["key"]).model_dump_json()})
        return future

    def shutdown(self, wait: bool) -> None:
        assert not wait


@pytest.fixture
def campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Campaign:
    return Campaign(tmp_path / "out", monkeypatch)


@pytest.mark.parametrize("engine", ["local", pytest.param("dask", marks=NEEDS_DASK)])
def test_who_crashed_is_tried_again_before_all_that_wait(campaign: Campaign, engine: str):
    """So that -x ends a campaign as soon as the tries are used up, however many cells wait."""
    one, two, three = (cell.key for cell in campaign.cells)
    campaign.crashing, campaign.tries = {one}, 3
    done = [cell.key for cell, _ in getattr(campaign, engine)().run(campaign.cells)]
    assert campaign.begun == [one, one, one, two, three]
    assert done == [one, two, three]


@NEEDS_DASK
def test_what_is_not_the_cluster_s_is_not_said_of_it(campaign: Campaign):
    """Whoever reads our progress may have had enough of it."""

    def closed(_running: Sequence[Any]) -> None:
        raise BrokenPipeError

    campaign.watch = closed
    with pytest.raises(BrokenPipeError):
        list(campaign.dask().run(campaign.cells))


@NEEDS_DASK
def test_a_cell_that_a_worker_gave_up_is_given_out_anew(campaign: Campaign):
    campaign.silent = 5
    assert [cell.key for cell, _ in campaign.dask().run(campaign.cells)] == [cell.key for cell in campaign.cells]
    campaign.silent = 6
    with pytest.raises(MachineError, match=f"lost before they begin {campaign.cells[0].title}; their logs say why"):
        list(campaign.dask().run(campaign.cells))


@NEEDS_DASK
def test_workers_that_cannot_be_started_here_are_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    import distributed  # pyright: ignore[reportMissingImports]

    def refuses(**_: Any) -> None:
        raise RuntimeError("Cluster failed to start: no more processes\nand much more")

    monkeypatch.setattr(distributed, "LocalCluster", refuses)
    watchdog: Any = SimpleNamespace(tell=lambda *words: None)
    for folder, why in (
        (tmp_path, "Cluster failed to start: no more processes"),
        (tmp_path / "none", r"\[Errno 2\] No such file or directory: .*"),
    ):
        monkeypatch.setattr(tempfile, "tempdir", str(folder))
        with pytest.raises(MachineError, match=rf"^--engine dask: its workers cannot be started here \({why}\); make room") as caught:
            _enter(local_cluster(1, watchdog))
        assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def _enter(context: contextlib.AbstractContextManager[Iterator[Any]]) -> None:
    with context:
        raise AssertionError("it began")

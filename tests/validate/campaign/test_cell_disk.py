"""A disk that refuses a cell: at each request that the child makes, one after the other.

Either the cell is what it would have been, or the campaign

ends with one sentence; never is a full disk told of as what a method or a judge did.
"""

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable

import pytest
from killed_campaigns import FAKES_FOLDER

from models.codegen.compiler import find_compiler
from models.errors import MachineError
from models.results.run import RunRecord
from validate.campaign.engine import MODULES
from validate.campaign.runs import CampaignSettings, select
from validate.processes.process import Preloaded
from validate.store.provenance import gather
from validate.store.store import Store
from validate.tasks import worker
from validate.tasks.worker import Worker

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(
        sys.platform != "linux", reason="LD_PRELOAD and forked supervisors are for Linux"
    ),
]
_FOR_EVER = 2**62


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Callable[..., tuple[RunRecord | MachineError, int]]:
    """run(store, first, last, error) runs the cell, with these requests of its child refused: what came of it, and how many requests there were."""
    folder = tmp_path_factory.mktemp("refusing")
    library, told = folder / "refusing_disk.so", folder / "refused.json"
    source = FAKES_FOLDER / "refusing_disk.c"
    subprocess.run(
        [
            *find_compiler().command,
            "-O1",
            "-shared",
            "-fPIC",
            "-o",
            str(library),
            str(source),
            "-ldl",
        ],
        check=True,
    )
    patch = pytest.MonkeyPatch()
    patch.setenv("PYTHONPATH", str(FAKES_FOLDER))
    patch.setenv("LD_PRELOAD", str(library))
    patch.setenv("REFUSED", str(told))
    (entry,), _ = select(
        CampaignSettings(
            out=folder,
            scenes=("three_cart",),
            expression="soft_alone",
            plugin="refused_cells:WRITING",
        )
    )
    provenance = gather("test")
    preloaded = Preloaded((*MODULES, "refused_cells"))
    patch.delenv("LD_PRELOAD")
    patch.setattr(worker, "_FUNCTION", "refused_cells:main")

    def cell(
        store: Store, first: int, last: int, error: int
    ) -> tuple[RunRecord | MachineError, int]:
        told.write_text(
            json.dumps({"below": str(store.folder), "first": first, "last": last, "error": error})
        )
        try:
            record = Worker(
                entry.task, provenance, store, loaded=entry.loaded, preloaded=preloaded
            ).run(lambda: True)
        except MachineError as refusal:
            record = refusal
        return record, int(told.with_suffix(".count").read_text())

    yield cell
    patch.undo()
    preloaded.close()


@pytest.fixture
def store(tmp_path) -> Store:
    store = Store(tmp_path / "out")
    store.prepare()
    other = store.runs / ("f" * 64)  # of another cell, finished long ago
    other.mkdir()
    (other / "record.json").write_text("{}")
    return store


def _told(record: RunRecord) -> tuple:
    stages = [
        (stage.outcome, stage.verdict, stage.cost, len(stage.metrics)) for stage in record.stages
    ]
    return record.outcome, record.verdict, record.message, stages


def _check(store: Store, came: RunRecord | MachineError, whole: tuple, error: int) -> bool:
    """Whether the cell was finished."""
    assert [path.name for path in store.runs.iterdir() if path.name.startswith(".")] == []
    assert (store.runs / ("f" * 64) / "record.json").read_text() == "{}"
    others = [path for path in store.runs.iterdir() if path.name != "f" * 64]
    if isinstance(came, MachineError):
        assert "\n" not in str(came)
        assert os.strerror(error).lower() in str(came).lower() or "the disk is full" in str(came)
        assert others == []
        return False
    assert _told(came) == whole
    assert [path.name for path in others] == [came.key]
    shutil.rmtree(others[0])
    return True


@pytest.mark.slow
def test_each_request_of_a_cell_is_refused_in_turn(run, store):
    undisturbed, requests = run(store, _FOR_EVER, _FOR_EVER, errno.ENOSPC)
    whole = _told(undisturbed)
    assert whole[:2] == ("solved", "holds")
    assert requests >= 15
    _check(store, undisturbed, whole, errno.ENOSPC)
    shutil.rmtree(store.legs, ignore_errors=True)
    finished = 0
    for number in range(1, requests + 1):
        error = (errno.ENOSPC, errno.EIO, errno.EROFS)[number % 3]
        came, _ = run(store, number, number, error)
        finished += _check(store, came, whole, error)
        shutil.rmtree(store.legs, ignore_errors=True)
    assert finished < requests / 2


@pytest.mark.slow
def test_a_disk_that_is_full_from_some_request_on_is_no_answer(run, store):
    """Nobody can say it then but the parent, whose disk is not full here: the cell has crashed, and is run again by the next campaign."""
    undisturbed, requests = run(store, _FOR_EVER, _FOR_EVER, errno.ENOSPC)
    shutil.rmtree(store.legs, ignore_errors=True)
    for number in range(1, requests + 1, requests // 4):
        came, _ = run(store, number, _FOR_EVER, errno.ENOSPC)
        if isinstance(came, RunRecord) and came.outcome != "crashed":
            assert _told(came) == _told(undisturbed)
        shutil.rmtree(store.legs, ignore_errors=True)

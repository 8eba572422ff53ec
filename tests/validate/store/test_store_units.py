"""The store piece by piece: whole folders only, who is at work on what is unfinished, marks, requests, names; what a folder says of its campaign."""

import errno
import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from models.errors import MachineError
from models.results.check import CheckRecord
from models.results.run import LegRecord, RunRecord
from models.results.stored import from_json, to_json
from tests.reports import record_factory as factory
from validate.campaign.runs import CampaignSettings, only_last_failed, reasons, select, with_stored
from validate.campaign.stored import (
    CAMPAIGN,
    CampaignError,
    campaign_of,
    found_campaign,
    identity,
    same_campaign,
    stored_names,
    title_of,
    with_others,
)
from validate.store import store as module
from validate.store.provenance import gather, machine
from validate.store.store import (
    FILES,
    PROGRESS,
    RECORD,
    REQUEST,
    Store,
    StoreError,
    _owner_lives,
    progress,
)
from validate.tasks.leg import place, write_leg
from validate.tasks.records import run_record, unfinished_stage
from validate.tasks.scene_record import scene_record
from validate.tasks.task import ChildExit
from validate.tasks.worker import record_for_crash

HOST = socket.gethostname()


@pytest.fixture(scope="module")
def dead() -> int:
    """The number of a process that has ended."""
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return child.pid


def test_who_is_at_work(dead: int):
    lives = {
        f".partial-a-token-{os.getpid()}-{HOST}": True,
        f".partial-a-token-{os.getpid()}-{HOST}-old": True,
        f".partial-a-token-{dead}-{HOST}": False,
        f".partial-a-token-{dead}-{HOST}-old": False, f".partial-a-token-{dead}-another-host": True,
        f".partial-a-token-{dead}": False,
        ".partial-a-token-x1-another-host": False, ".partial-": False,
    }  # fmt: skip
    assert {name: _owner_lives(name) for name in lives} == lives
    assert _owner_lives(f".partial-a-token-1-{HOST}"), "another user's process"


def test_a_machine_may_have_a_name_of_several_parts(dead: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(socket, "gethostname", lambda: "my-own-host")
    hosts = {"my-own-host": False, "my-own-host-old": False, "my-host": True}
    assert {host: _owner_lives(f".partial-a-token-{dead}-{host}") for host in hosts} == hosts


@pytest.fixture
def store(tmp_path: Path) -> Store:
    found = Store(tmp_path / "all")
    found.prepare()
    return found


def put(
    store: Store, name: str, record: object = None, cell: object = None, files: object = None
) -> Path:
    folder = store.runs / name
    folder.mkdir()
    if record is not None:
        (folder / RECORD).write_text(to_json(record))  # type: ignore[attr-defined]
    if cell is not None:
        (folder / REQUEST).write_text(json.dumps({"task": cell}))
    if files is not None:
        (folder / FILES).write_text(json.dumps(files))
    return folder


def test_a_file_of_another_size_is_damaged(store: Store):
    folder = put(store, "key", files={"first.nc": 3, "second.nc": 4})
    (folder / "first.nc").write_bytes(b"123")
    (folder / "second.nc").write_bytes(b"1234")
    assert store.damaged_file("key") == ""
    (folder / "second.nc").write_bytes(b"123")
    assert store.damaged_file("key") == "second.nc"
    (folder / "first.nc").unlink()
    assert store.damaged_file("key") == "first.nc"
    (folder / FILES).write_text("[]")
    assert store.damaged_file("key") == store.damaged_file("nowhere") == FILES


def test_a_list_of_files_names_none_outside_of_its_folder(store: Store, tmp_path: Path):
    (tmp_path / "outside.nc").write_bytes(b"123")
    put(store, "key", files={"../../../outside.nc": 3})
    assert store.damaged_file("key") == "../../../outside.nc"


def test_a_record_of_another_key_is_not_the_tasks(store: Store):
    run = factory.runs()[0]
    put(store, run.key, run)
    put(store, "other", run)
    assert store.read(run.key) == run
    record = put(store, "damaged", replace(run, key="damaged")) / RECORD
    record.write_text(record.read_text()[:-10])
    assert store.read("damaged") is None
    assert store.read("other") is store.read("nowhere") is store.read("\0") is None


def test_discard_deletes_the_named_runs_only(store: Store):
    kept, gone = factory.runs()[:2]
    for run in (kept, gone):
        put(store, run.key, run)
    store.discard([gone.key, "nowhere"])
    assert store.read(gone.key) is None
    assert store.read(kept.key) == kept


@pytest.mark.parametrize(("processor", "told"), [("Z80", "Z80"), ("", "vax")])
def test_a_machine_that_does_not_list_its_processors_is_told_by_what_it_is(
    monkeypatch: pytest.MonkeyPatch, processor: str, told: str
):
    def nowhere(path: Path, encoding: str) -> str:
        raise FileNotFoundError(errno.ENOENT, "No such file", str(path))

    monkeypatch.setattr(Path, "read_text", nowhere)
    monkeypatch.setattr("platform.processor", lambda: processor)
    monkeypatch.setattr("platform.machine", lambda: "vax")
    assert machine()["cpu"] == told


def test_what_was_asked_for_is_read_where_it_can_be(store: Store):
    put(store, "b", cell={"name": "second"})
    put(store, "a", cell={"name": "first"})
    put(store, "c", cell=[1])
    put(store, ".partial-d", cell={"name": "unfinished"})
    (put(store, "e") / REQUEST).write_text("[1]")
    assert list(store.requests()) == [{"name": "first"}, {"name": "second"}]
    assert (store.request("a"), store.request("c"), store.request("nowhere")) == (
        {"name": "first"},
        {},
        {},
    )


def test_a_task_is_stored_under_its_key_with_the_sizes_of_its_files(store: Store):
    for text in ("one", "another"):
        partial = store.open_partial("0123456789abcdef", "token")
        assert re.fullmatch(
            rf"\.partial-0123456789ab-token[0-9a-f]{{27}}-{os.getpid()}-{re.escape(HOST)}",
            partial.name,
        )
        assert Store(partial.parents[1]).folder == store.folder
        (partial / "plan.nc").write_text(text)
        progress(partial, "halfway")
        assert (partial / PROGRESS).read_text() == "halfway"
        target = store.commit(partial, "0123456789abcdef")
        assert target == store.runs / "0123456789abcdef"
        assert json.loads((target / FILES).read_text()) == {"plan.nc": len(text)}
        assert (target / "plan.nc").read_text() == text
        assert [path.name for path in store.runs.iterdir()] == ["0123456789abcdef"]


def test_an_older_run_that_cannot_be_put_back_stays_aside(
    store: Store, monkeypatch: pytest.MonkeyPatch
):
    """It is moved aside, its successor is refused its name, and so is its own way back: it is all there is, and is not removed."""
    key = "0123456789abcdef"
    older = store.open_partial(key, "older")
    (older / "plan.nc").write_text("the older one")
    target = store.commit(older, key)
    rename = os.rename

    def refused(source: Path, place: Path) -> None:
        if Path(place) == target and not target.exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        rename(source, place)

    monkeypatch.setattr(os, "rename", refused)
    newer = store.open_partial(key, "newer")
    with pytest.raises(MachineError):
        store.commit(newer, key)
    assert (newer.with_name(f"{newer.name}-old") / "plan.nc").read_text() == "the older one"


def test_preparing_removes_what_the_dead_left_and_nothing_else(store: Store, dead: int):
    """Unfinished runs, and files that were being written in the folder or its surveys.

    A run that was to be replaced is put back.
    """
    run = factory.runs()[0]
    mine = put(store, f".partial-a-token-{os.getpid()}-{HOST}")
    put(store, f".partial-b-token-{dead}-{HOST}")
    put(store, f".partial-c-token-{dead}-{HOST}-old", run)
    put(store, f".partial-d-token-{dead}-{HOST}", factory.runs()[1])
    (store.folder / "surveys").mkdir()
    kept = [
        store.folder / "results.csv",
        store.folder / "surveys" / f".partial-file-token-{os.getpid()}-{HOST}",
    ]
    gone = [
        store.folder / f".partial-file-token-{dead}-{HOST}",
        store.folder / "surveys" / f".partial-file-token-{dead}-{HOST}",
    ]
    for path in (*kept, *gone):
        path.write_text("x")
    store.prepare()
    assert sorted(path.name for path in store.runs.iterdir()) == sorted([mine.name, run.key])
    assert [path.exists() for path in (*kept, *gone)] == [True, True, False, False]


def test_a_file_is_no_folder_of_a_campaign(tmp_path: Path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError, match="a campaign needs a folder") as caught:
        Store(tmp_path / "file").prepare()
    assert str(tmp_path / "file") in str(caught.value)


RUN = {"scene_name": "three_cart", "pipeline": {"name": "mpcc"}}
CHECK = {"kind": "stress", "name": "h01", "scene": "push_box"}


def test_what_tasks_are_called():
    assert [title_of(task) for task in (RUN, CHECK)] == ["three_cart x mpcc", "stress: h01"]
    others = (
        {**CHECK, "scene": None},
        {**CHECK, "kind": "FMU"},
        {**CHECK, "name": "h02"},
        {**RUN, "scene_name": "x"},
        {**RUN, "pipeline": {"name": "x"}},
    )
    assert len({identity(task) for task in (RUN, CHECK, *others)}) == 7
    assert identity({**RUN, "key": "other"}) == identity(RUN)
    assert identity({"pipeline": "damaged", **CHECK}) == identity(CHECK)


def test_names_come_from_what_was_asked_or_from_the_record(
    store: Store, monkeypatch: pytest.MonkeyPatch
):
    first, second = factory.runs()[:2]
    put(store, first.key, first, cell=RUN)
    put(store, second.key, second, cell={"pipeline": "damaged"})
    put(store, "nothing")
    assert stored_names(store, [first.key, second.key, "nothing"]) == {
        first.key: "three_cart x mpcc",
        second.key: second.title,
    }
    monkeypatch.setattr(module, "record_of", None)
    assert stored_names(store, [first.key]) == {first.key: "three_cart x mpcc"}, (
        "the record was not read"
    )


def test_a_campaign_has_its_tasks_in_its_order(tmp_path: Path):
    runs = factory.runs()[:3]
    check = CheckRecord(
        key="check", kind="stress", name="h01", expected="", outcome="answered", passed=True,
        wall_seconds=1.0, cpu_seconds=1.0,
        provenance=factory.provenance(),
    )  # fmt: skip
    campaign = factory.campaign(runs, keys=(runs[2].key, "check", "lost", runs[0].key))
    store = Store(factory.store(tmp_path / "all", [*runs, check], campaign))  # type: ignore[list-item]
    assert campaign_of(store.folder) == campaign
    assert [record.key for key in campaign.keys if (record := store.read(key)) is not None] == [
        runs[2].key,
        "check",
        runs[0].key,
    ]
    assert check.title == "stress: h01"


@pytest.mark.parametrize(("text", "parts"), [
    (None, ("no campaign in this folder", "--out")), ("", ("damaged",)), ("[1]", ("damaged",)),
    ("{half", ("damaged",)),
    ("{}", ("damaged (5 fields do not fit)", "run the campaign again")),
    ('{"schema_version": 3}', ("another version of touchstone", "use another --out folder")),
])  # fmt: skip
def test_what_is_no_campaign_is_refused_with_its_place(
    tmp_path: Path, text: str | None, parts: tuple[str, ...]
):
    if text is not None:
        (tmp_path / CAMPAIGN).write_text(text)
    with pytest.raises(CampaignError) as caught:
        campaign_of(tmp_path)
    assert all(part in str(caught.value) for part in (str(tmp_path), *parts))
    assert found_campaign(tmp_path) is None


@pytest.fixture(scope="module")
def entry():
    """The cell three_cart x relu_gd of the real catalogs."""
    entries, _ = select(
        CampaignSettings(
            out=None,
            time_limit=600.0,
            scenes=("three_cart",),
            expression="relu_gd and not softplus and not relaxed",
        )
    )
    (found,) = entries
    return found


def _record(entry, outcome: str, message: str = "") -> RunRecord:
    from formulations.solution import Outcome

    stages = [
        unfinished_stage("three_cart", "relu_gd", planned, Outcome[outcome.upper()], message)
        for planned in entry.loaded.plan
    ]
    return run_record(
        entry.task,
        scene_record(entry.loaded.scene),
        stages,
        gather("test"),
        wall=1.0,
        cpu=1.0,
        log="a\nb",
    )


def _stored(
    store: Store, record: RunRecord, time_limit: float = 600.0, files: tuple[str, ...] = ()
) -> Path:
    store.prepare()
    partial = store.open_partial(record.key, "token")
    for name in files:
        (partial / name).write_text(name)
    (partial / "record.json").write_text(to_json(record))
    (partial / "task.json").write_text(json.dumps({"task": {"time_limit": time_limit}}))
    return store.commit(partial, record.key)


@pytest.mark.parametrize(("outcome", "time_limit", "used_again"), [
    ("solved", 600.0, True), ("infeasible", 600.0, True), ("refused", 600.0, True),
    ("crashed", 600.0, False), ("time_limit", 600.0, True),
    ("time_limit", 599.0, False),
])  # fmt: skip
def test_what_is_used_again(tmp_path, entry, outcome, time_limit, used_again):
    store = Store(tmp_path)
    _stored(store, _record(entry, outcome), time_limit)
    settings = CampaignSettings(out=tmp_path, time_limit=600.0)
    (found,) = with_stored([entry], store, settings)
    assert (found.stored is not None) is used_again
    (fresh,) = with_stored([entry], store, CampaignSettings(out=tmp_path, fresh=True))
    assert fresh.stored is None


@pytest.mark.parametrize(("time_limit", "used_again"), [(600.0, True), (599.0, False)])
def test_a_certificate_that_time_took_is_made_when_there_is_more(
    tmp_path, entry, time_limit, used_again
):
    """The plans were kept, and with them the outcome of the last stage: it does not say that time ran out."""
    store, record = Store(tmp_path), _record(entry, "solved")
    partial = tmp_path / "run"
    (leg,) = entry.task.legs
    place(partial, 1).mkdir(parents=True)
    stages = tuple(replace(stage, certificate_missing=True) for stage in record.stages)
    write_leg(
        place(partial, 1), LegRecord(key=leg.key, pipeline="relu_gd", stages=stages, files={})
    )
    child = ChildExit(
        outcome="time_limit",
        message=f"ended at its time limit of {time_limit:g} s.",
        wall=time_limit,
        cpu=1.0,
        log="",
    )
    kept = record_for_crash(entry.task, gather("test"), child, partial, entry.loaded)
    assert kept.outcome == "solved"
    _stored(store, kept, time_limit)
    (found,) = with_stored([entry], store, CampaignSettings(out=tmp_path, time_limit=600.0))
    assert (found.stored is not None) is used_again


HARMS = {
    "stored, but trajectory.nc is gone or cut off": lambda folder: (
        folder / "trajectory.nc"
    ).unlink(),
    "stored, but replay.nc is gone or cut off": lambda folder: (folder / "replay.nc").write_bytes(
        b""
    ),
    "stored, but files.json is gone or cut off": lambda folder: (folder / "files.json").write_text(
        "[1]"
    ),
    "stored, but its record cannot be read": lambda folder: (folder / "record.json").write_text(
        "{}"
    ),
    "": lambda folder: (folder / "log.txt").unlink(missing_ok=True),
}


@pytest.mark.parametrize("why", HARMS)
def test_a_run_whose_files_are_gone_is_run_again(tmp_path, entry, why):
    """A result whose plan and replay nobody can look at any more is none."""
    store = Store(tmp_path)
    HARMS[why](_stored(store, _record(entry, "solved"), files=("trajectory.nc", "replay.nc")))
    settings = CampaignSettings(out=tmp_path, time_limit=600.0)
    assert reasons(with_stored([entry], store, settings), store) == [why]


@pytest.mark.parametrize("failures", [0, 1, 3, 4, 6])
def test_what_failed_and_is_not_selected_is_named_three_at_most(failures: int, tmp_path: Path):
    runs = []
    for number in range(6):
        verdict = "violates" if number < failures else "holds"
        run = factory.run("strict", None, "strict_lcp", key=f"strict-{number}", verdict=verdict)
        stages = tuple(replace(stage, verdict=verdict) for stage in run.stages)
        runs.append(replace(run, pipeline=f"p{number}", stages=stages))
    store = _store_of(tmp_path, runs, [run.pipeline for run in runs])
    with pytest.raises(CampaignError, match="nothing that is selected failed") as error:
        only_last_failed((), store)
    said = str(error.value)
    named = [number for number in range(6) if f"p{number}" in said]
    assert named == list(range(min(failures, 3)))
    assert (f"and {failures - 3} more" in said) is (failures > 3)
    assert ("more" in said) is (failures > 3)
    assert ("drop --last-failed" in said) is (failures == 0)


def test_what_a_campaign_is_does_not_depend_on_when_and_how_it_was_called() -> None:
    told = factory.campaign(factory.runs()[:2])
    called = {"command": "second", "started": "2", "provenance": factory.provenance(cpu="another")}
    read = from_json(type(told), to_json(replace(told, **called)))
    assert same_campaign(told, read)
    for change in ({"keys": told.keys[:1]}, {"quick": not told.quick}, {"title": "another"}):
        assert not same_campaign(told, replace(read, **change))


def _asked(pipeline: str) -> dict:
    return {
        "scene_name": "three_cart",
        "scene": "three_cart",
        "pipeline": {"name": pipeline, "legs": []},
    }


def _store_of(folder: Path, runs: list[RunRecord], names: Iterable[str]) -> Store:
    """A campaign of these runs, of which those with a name say what was asked for."""
    store = Store(factory.store(folder / "all", runs))
    for run, name in zip(runs, names, strict=False):
        (store.runs / run.key / REQUEST).write_text(
            json.dumps({"task": _asked(name)}), encoding="utf-8"
        )
    return store


@pytest.mark.parametrize(
    ("part", "keys"),
    [
        (["b"], "abc"),
        (["c", "a"], "cab"),
        (["d"], "abcd"),
        (["b", "d"], "abcd"),
        (["B"], "aBc"),
        ([], "abc"),
    ],
)  # B: the same run, of other code
def test_a_part_leaves_the_others_where_they_are(part: list[str], keys: str, tmp_path: Path):
    store = _store_of(
        tmp_path, [factory.run("strict", None, "strict_lcp", key=key) for key in "abc"], "abc"
    )
    found = with_others(
        store, campaign_of(store.folder), {identity(_asked(key.lower())): key for key in part}
    )
    assert "".join(found) == keys


def test_what_cannot_be_read_does_not_stay(tmp_path: Path):
    store = _store_of(
        tmp_path, [factory.run("strict", None, "strict_lcp", key=key) for key in "abc"], "ab"
    )
    (store.runs / "b" / "record.json").unlink()
    assert with_others(store, campaign_of(store.folder), {identity(_asked("d")): "d"}) == ("a", "d")

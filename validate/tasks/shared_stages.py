"""Stages that several pipelines of a scene begin with: solved, certified and judged once, in whichever cell comes first.

    DIR/stages/<key>/stages.json, trajectory_<n>.nc, replay_<n>.nc, tracked_<n>.nc        n from 1

A beginning ends where the next stage opens another session (another method, or other options), so that nothing but its plan goes on from it: what
follows gives the same numbers whether the beginning ran in the same process or was read from its files. A key is of all that decides a
beginning, as that of a cell is. Its folder is written inside the unfinished folder of a cell, made durable, and renamed: it is whole or not there.

Stages in the midst of a pipeline are the beginning of another one too, where their session leaves the plan it is given for the first guess
(formulations.method, start_used): a restart. What a crash ended is not shared. A beginning that used up all the time of its cell is shared under a key
of its own, with those that have no more time: they end there, too.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.errors import TouchstoneError
from reports.records.record import stage_files
from validate.store.disk import fsync
from validate.store.store import Store

if TYPE_CHECKING:
    from models.scene import Scene
    from models.trajectory import Trajectory
    from reports.records.record import StageRecord
    from validate.tasks.records import Planned

_CONTENT = "stages.json"
# Outcomes that another run might not have.
_BY_CHANCE = frozenset({"time_limit", "crashed", "interrupted"})
# What damaged content raises where it is read; pydantic's and JSON's errors are ValueErrors.
_DAMAGED = (ValueError, LookupError, TypeError, AttributeError, RecursionError)

Signature = tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Beginning:
    """The stages of a pipeline from `first` (counted from 0) until before `stages`, started without a plan."""

    stages: int
    key: str
    first: int = 0

    def late_key(self, limit: float) -> str:
        """Under which it is shared where it used up the `limit` [s] of its cell."""
        return f"{self.key}-{limit:g}s"


@dataclass(frozen=True)
class TakenOver:
    """Finished stages and the plan that the next stage starts from. late: they used up the time of a cell like this one."""

    stages: tuple[StageRecord, ...] = ()
    plan: Trajectory | None = None
    late: bool = False


def signature(plan: Sequence[Planned]) -> Signature:
    """What is asked of each stage, so that two pipelines can be compared."""
    return tuple(
        (planned.name, planned.eps, tuple(sorted((name, repr(value)) for name, value in asdict(planned.options).items())))
        for planned in plan
    )


def common(plans: Iterable[Sequence[Planned]]) -> frozenset[Signature]:
    """The beginnings that two or more of these plans have, but for those that only plans have which begin alike for longer; and those that
    another has in its midst."""
    plans = list(plans)
    found = Counter(signature(plan)[:length] for plan in plans for length in _ends(plan))
    midst = {signature(plan)[first:length] for plan in plans for first, length in _later(plan)}
    several = {begin: times for begin, times in found.items() if times > 1}
    longer = {(begin[:length], times) for begin, times in several.items() for length in range(1, len(begin))}
    return frozenset(begin for begin, times in several.items() if (begin, times) not in longer) | (found.keys() & midst)


def beginnings(plan: Sequence[Planned], shared: frozenset[Signature], key_of: Callable[[Sequence[Planned]], str]) -> tuple[Beginning, ...]:
    """Those of a plan's beginnings that others have too, the longest first. key_of: the key of some stages."""
    whole = signature(plan)
    return tuple(Beginning(length, key_of(plan[:length])) for length in reversed(_ends(plan)) if whole[:length] in shared)


def restarts(plan: Sequence[Planned], shared: frozenset[Signature], key_of: Callable[[Sequence[Planned]], str]) -> tuple[Beginning, ...]:
    """What in the midst of a plan is the beginning of another, the longest first."""
    whole = signature(plan)
    return tuple(
        Beginning(length, key_of(plan[first:length]), first) for first, length in reversed(_later(plan)) if whole[first:length] in shared
    )


def _later(plan: Sequence[Planned]) -> list[tuple[int, int]]:
    """(first, number of stages until the end) of every run of whole sessions but those the plan begins with."""
    ends = _ends(plan)
    return [(first, length) for first in ends for length in ends if length > first]


def _ends(plan: Sequence[Planned]) -> list[int]:
    """Numbers of stages after which the session is closed."""
    asked = [(planned.name, planned.options) for planned in plan]
    return [length for length in range(1, len(plan) + 1) if length == len(plan) or asked[length] != asked[length - 1]]


def beginnings_of(job: object) -> tuple[Beginning, ...]:
    """Those of a cell; an examination has none."""
    return getattr(job, "beginnings", ())


def wanted_of(job: object) -> tuple[Beginning, ...]:
    """What a cell may take over: its beginnings and restarts; an examination nothing."""
    return (*beginnings_of(job), *getattr(job, "restarts", ()))


def must_wait(wanted: Sequence[Beginning], running: Sequence[Sequence[Beginning]], store: Store, limit: float = 0.0) -> bool:
    """Whether a cell with this time limit [s] would run stages that a running one is about to share."""
    theirs = {item.key for items in running for item in items}
    return any(item.key in theirs and not any((store.stages / key).exists() for key in (item.key, item.late_key(limit))) for item in wanted)


def forget(jobs: Iterable[object], store: Store) -> None:
    """Take away what these would take over: they are to be run anew. What cannot be removed is used again."""
    for key in {item.key for job in jobs for item in wanted_of(job)}:
        for folder in store.stages.glob(f"{key}*"):
            shutil.rmtree(folder, ignore_errors=True)


def take_over(wanted: Sequence[Beginning], scene: Scene, stages: int, folder: Path, limit: float = 0.0) -> TakenOver:
    """The longest of these that is stored, its files copied into the folder of a cell of so many stages and this time limit [s], its records
    with the numbers the stages have there. One that is damaged is put aside."""
    named = [(item, item.key) for item in wanted] + [(item, item.late_key(limit)) for item in wanted if not item.first]
    for item, key in named:
        source = Store.of_partial(folder).stages / key
        if not source.is_dir():
            continue
        try:
            return _read(source, item, scene, stages, folder)
        except (OSError, *_DAMAGED, TouchstoneError):
            with contextlib.suppress(OSError):
                os.rename(source, folder / f"damaged-{key}")  # goes with the folder
    return TakenOver()


def _read(source: Path, item: Beginning, scene: Scene, stages: int, folder: Path) -> TakenOver:
    from models.trajectory_netcdf import read_netcdf
    from reports.records.record import StageRecord

    content = json.loads((source / _CONTENT).read_bytes())
    records = tuple(StageRecord.model_validate(record) for record in content["stages"])
    late, length = bool(content.get("late")), item.stages - item.first
    if content["key"] != source.name or not (0 < len(records) <= length if late else len(records) == length):
        raise ValueError("it is not what its folder says")
    if [record.index for record in records] != list(range(len(records))):
        raise ValueError("its stages are not in order")
    files = {name: (source / name).read_bytes() for name in content["files"]}
    if any(hashlib.sha256(files[name]).hexdigest() != digest for name, digest in content["files"].items()):
        raise ValueError("a file was changed")
    plan = None
    for record in records:
        numbered, own = stage_files(record.index, item.stages + 1), stage_files(record.index + item.first, stages)
        for what in own:
            if numbered[what] in files:
                (folder / own[what]).write_bytes(files[numbered[what]])
        if record.has_plan:
            plan = read_netcdf(folder / own["trajectory"], scene)
    return TakenOver(tuple(record.model_copy(update={"index": record.index + item.first}) for record in records), plan, late)


def is_sure(records: Sequence[StageRecord]) -> bool:
    """Whether another run would have found the same: no clock, no crash, no judge that stumbled."""
    return all(record.outcome not in _BY_CHANCE for record in records) and _is_judged(records)


def is_late(records: Sequence[StageRecord]) -> bool:
    """Whether a clock ended the last of these, and chance nothing else."""
    return bool(records) and records[-1].outcome == "time_limit" and is_sure(records[:-1]) and _is_judged(records)


def _is_judged(records: Sequence[StageRecord]) -> bool:
    return all(not record.has_plan or record.metrics for record in records)


def share(item: Beginning, pipeline: str, records: Sequence[StageRecord], stages: int, folder: Path, late: float | None = None) -> None:
    """Store stages of a cell of so many stages. records: of these stages; late: the time limit [s] of a cell that had no time for what comes next.

    Raises OSError where the disk refuses.
    """
    key = item.key if late is None else item.late_key(late)
    aside, target = folder / f"sharing-{key}", Store.of_partial(folder).stages / key
    if target.exists():
        return
    aside.mkdir()
    digests: dict[str, str] = {}
    first, before = records[0].index, records[0].seconds.total - records[0].seconds.stage
    for record in records:
        own, numbered = stage_files(record.index, stages), stage_files(record.index - first, item.stages + 1)
        for what in own:
            if (folder / own[what]).exists():
                shutil.copyfile(folder / own[what], aside / numbered[what])
                digests[numbered[what]] = hashlib.sha256((aside / numbered[what]).read_bytes()).hexdigest()
    content: Mapping[str, Any] = {
        "key": key,
        "late": late is not None,
        "files": digests,
        "stages": [_shared(record, pipeline, first, before).model_dump(mode="json") for record in records],
    }
    (aside / _CONTENT).write_text(json.dumps(content), encoding="utf-8")
    for path in (*sorted(aside.iterdir()), aside):
        fsync(path)
    target.parent.mkdir(exist_ok=True)
    try:
        os.rename(aside, target)
    except OSError as error:
        if error.errno not in {errno.ENOTEMPTY, errno.EEXIST}:  # another campaign was first
            raise
    fsync(target.parent)


def _shared(record: StageRecord, pipeline: str, first: int, before: float) -> StageRecord:
    """The record of a stage as if its pipeline had begun at stage `first`, after `before` seconds."""
    seconds = record.seconds.model_copy(update={"total": record.seconds.total - before if first else record.seconds.total})
    return record.model_copy(update={"index": record.index - first, "seconds": seconds, "shared_from": record.shared_from or pipeline})

"""Stages that several pipelines of a scene begin with: solved, certified and judged once, in whichever cell comes first.

    DIR/stages/<key>/stages.json, trajectory_<n>.nc, replay_<n>.nc, tracked_<n>.nc        n from 1

A beginning ends where the next stage opens another session (another method, or other options), so that nothing but its plan goes on from it: what
follows gives the same numbers whether the beginning ran in the same process or was read from its files. A key is of all that decides a
beginning, as that of a cell is. Its folder is written inside the unfinished folder of a cell, made durable, and renamed: it is whole or not there.
What a clock or a crash ended is not shared.
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
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.errors import TouchstoneError
from validate.store import Store, fsync

if TYPE_CHECKING:
    from models.scene import Scene
    from models.trajectory import Trajectory
    from reports.record import StageRecord
    from validate.records import Planned

_CONTENT = "stages.json"
_FILES = ("trajectory", "replay", "tracked")
# Outcomes that another run might not have.
_BY_CHANCE = frozenset({"time_limit", "crashed", "interrupted"})
# What damaged content raises where it is read; pydantic's and JSON's errors are ValueErrors.
_DAMAGED = (ValueError, LookupError, TypeError, AttributeError, RecursionError)

Signature = tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Beginning:
    """The first `stages` stages of a pipeline."""

    stages: int
    key: str


@dataclass(frozen=True)
class TakenOver:
    """Finished stages and the plan that the next stage starts from."""

    stages: tuple[StageRecord, ...] = ()
    plan: Trajectory | None = None


def stage_files(index: int, stages: int) -> dict[str, str]:
    """The files of stage `index` (from 0) of a cell of so many stages, by what they hold; those of the last stage have no number."""
    ending = "" if index == stages - 1 else f"_{index + 1}"
    return {what: f"{what}{ending}.nc" for what in _FILES}


def signature(plan: Sequence[Planned]) -> Signature:
    """What is asked of each stage, so that two pipelines can be compared."""
    return tuple(
        (planned.name, planned.eps, tuple(sorted((name, repr(value)) for name, value in planned.options.items()))) for planned in plan
    )


def common(plans: Iterable[Sequence[Planned]]) -> frozenset[Signature]:
    """The beginnings that two or more of these plans have, but for those that only plans have which begin alike for longer."""
    found = Counter(signature(plan)[:length] for plan in plans for length in _ends(plan))
    several = {begin: times for begin, times in found.items() if times > 1}
    longer = {(begin[:length], times) for begin, times in several.items() for length in range(1, len(begin))}
    return frozenset(begin for begin, times in several.items() if (begin, times) not in longer)


def beginnings(plan: Sequence[Planned], shared: frozenset[Signature], key_of: Callable[[Sequence[Planned]], str]) -> tuple[Beginning, ...]:
    """Those of a plan's beginnings that others have too, the longest first. key_of: the key of some stages."""
    whole = signature(plan)
    return tuple(Beginning(length, key_of(plan[:length])) for length in reversed(_ends(plan)) if whole[:length] in shared)


def _ends(plan: Sequence[Planned]) -> list[int]:
    """Numbers of stages after which the session is closed."""
    asked = [(planned.name, dict(planned.options)) for planned in plan]
    return [length for length in range(1, len(plan) + 1) if length == len(plan) or asked[length] != asked[length - 1]]


def beginnings_of(job: object) -> tuple[Beginning, ...]:
    """Those of a cell; an examination has none."""
    return getattr(job, "beginnings", ())


def must_wait(wanted: Sequence[Beginning], running: Sequence[Sequence[Beginning]], store: Store) -> bool:
    """Whether a cell would run stages that a running one is about to share."""
    theirs = {item.key for items in running for item in items}
    return any(item.key in theirs and not (store.stages / item.key).exists() for item in wanted)


def take_over(wanted: Sequence[Beginning], scene: Scene, stages: int, folder: Path) -> TakenOver:
    """The longest beginning that is stored, its files copied into the folder of a cell of so many stages. One that is damaged is put aside."""
    for item in wanted:
        source = Store.of_partial(folder).stages / item.key
        if not source.is_dir():
            continue
        try:
            return _read(source, item, scene, stages, folder)
        except (OSError, *_DAMAGED, TouchstoneError):
            with contextlib.suppress(OSError):
                os.rename(source, folder / f"damaged-{item.stages}")  # goes with the folder
    return TakenOver()


def _read(source: Path, item: Beginning, scene: Scene, stages: int, folder: Path) -> TakenOver:
    from models.trajectory_netcdf import read_netcdf
    from reports.record import StageRecord

    content = json.loads((source / _CONTENT).read_bytes())
    records = tuple(StageRecord.model_validate(record) for record in content["stages"])
    if content["key"] != item.key or len(records) != item.stages:
        raise ValueError("it is not what its folder says")
    files = {name: (source / name).read_bytes() for name in content["files"]}
    if any(hashlib.sha256(files[name]).hexdigest() != digest for name, digest in content["files"].items()):
        raise ValueError("a file was changed")
    plan = None
    for record in records:
        numbered, own = stage_files(record.index, item.stages + 1), stage_files(record.index, stages)
        for what in _FILES:
            if numbered[what] in files:
                (folder / own[what]).write_bytes(files[numbered[what]])
        if record.plan_trace is not None:
            plan = read_netcdf(folder / own["trajectory"], scene)
    return TakenOver(records, plan)


def share(wanted: Sequence[Beginning], pipeline: str, records: Sequence[StageRecord], taken: int, stages: int, folder: Path) -> None:
    """Store the beginnings of a cell that ran. records: of its finished stages, the first `taken` of which were taken over; stages: of the cell.

    Raises OSError where the disk refuses.
    """
    for item in wanted:
        begin = records[: item.stages]
        if taken < item.stages <= len(records) and all(_is_sure(record) for record in begin):
            _publish(item, pipeline, begin, stages, folder)


def _is_sure(record: StageRecord) -> bool:
    """Whether another run would have found the same: no clock, no crash, no judge that stumbled."""
    return record.outcome not in _BY_CHANCE and (record.plan_trace is None or bool(record.figures))


def _publish(item: Beginning, pipeline: str, records: Sequence[StageRecord], stages: int, folder: Path) -> None:
    aside, target = folder / f"sharing-{item.stages}", Store.of_partial(folder).stages / item.key
    aside.mkdir()
    digests: dict[str, str] = {}
    for record in records:
        own, numbered = stage_files(record.index, stages), stage_files(record.index, item.stages + 1)
        for what in _FILES:
            if (folder / own[what]).exists():
                shutil.copyfile(folder / own[what], aside / numbered[what])
                digests[numbered[what]] = hashlib.sha256((aside / numbered[what]).read_bytes()).hexdigest()
    content: Mapping[str, Any] = {
        "key": item.key,
        "files": digests,
        "stages": [record.model_copy(update={"shared_from": record.shared_from or pipeline}).model_dump(mode="json") for record in records],
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

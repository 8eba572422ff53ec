"""A leg: one session of a method over its eps.

It is the unit of work of a campaign - keyed by its content, run once, stored once.

    DIR/legs/<key>/leg.json.gz, trajectory_<n>.nc, replay_<n>.nc, tracked_<n>.nc   n from 1: its stages

A run (scene x pipeline) is a path of legs, each of which starts from the plan of the one before it.
The key of a leg is of all that decides it: the scene, what is asked of every stage up to its end,
the sources of these methods, the libraries. So pipelines that begin alike have legs in common, and
a run that was ended goes on behind the last leg it stored. A leg ends where its session does:
nothing but its plan goes on from it, and what follows gives the same numbers whether the leg ran in
the same process or was read from its files.

A leg that leaves the plan it is given for the first guess (formulations.method, start_used) is the
leg of a path that begins with it, and is stored as that. What a crash or a clock ended is not
stored, but for a leg that used up the time of its run: it is stored for runs of the same time
limit, which end there too. A folder is written aside, made durable, and renamed: it is whole or not
there.
"""

from __future__ import annotations

import contextlib
import gzip
import hashlib
import os
import shutil
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from formulations.method import Leg, Method, Options, Pipeline
from formulations.pipelines import stage_plan
from models.errors import TouchstoneError
from models.scene import Scene
from models.trajectory import Trajectory
from models.trajectory_netcdf import read_netcdf
from reports.records.record import LegRecord, StageRecord
from validate.processes.disk import fsync, fsync_whole, remove, renamed, write_durably
from validate.store.provenance import content_key
from validate.tasks.task import PlannedLeg

CONTENT = "leg.json.gz"
# Level of gzip. Higher levels save less than 5 %.
_LEVEL = 4
_FILES = ("trajectory", "replay", "tracked")
# Outcomes that another run might not have.
_BY_CHANCE = frozenset({"time_limit", "crashed", "interrupted"})
# What damaged content raises where it is read; pydantic's errors are ValueErrors.
_DAMAGED = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    RecursionError,
    TouchstoneError,
)


@dataclass(frozen=True, kw_only=True)
class Planned:
    """One stage of a pipeline before it runs: a method at one eps."""

    index: int
    name: str
    method: Method
    eps: float | None
    options: Options

    @property
    def title(self) -> str:
        """Its method, and its eps if it has one."""
        return self.name if self.eps is None else f"{self.name}, eps {self.eps:g}"

    def asked(self) -> list[Any]:
        """All that is asked of it, for a key."""
        places = {item.name for item in fields(self.options) if item.metadata.get("place")}
        options = asdict(self.options).items()
        return [
            self.name,
            self.eps,
            {name: repr(value) for name, value in options if name not in places},
        ]


def planned_stages(pipeline: Pipeline, methods: Mapping[str, Method]) -> tuple[Planned, ...]:
    """The stages of a pipeline in order, options filled in. Raises OptionError."""
    stages = []
    for index, (leg, eps, options) in enumerate(stage_plan(pipeline)):
        method = methods[leg.method]
        method.check_eps(eps)
        stages.append(
            Planned(
                index=index,
                name=leg.method,
                method=method,
                eps=eps,
                options=method.read_options(options),
            )
        )
    return tuple(stages)


def leg_key(scene: Scene, stages: Sequence[Planned], source: str, *named: str) -> str:
    """Return the key of a sequence of stages on a scene.

    source: text of the plugin's module; named: further words, for the key of a run.
    """
    methods = {planned.name for planned in stages} | {
        leg.method for planned in stages for way in planned.method.ways for leg in way.legs
    }
    asked = [*named, [planned.asked() for planned in stages]]
    return content_key(scene, asked, methods, source)


def planned_legs(
    plan: Sequence[Planned], key_of: Callable[[Sequence[Planned]], str]
) -> tuple[PlannedLeg, ...]:
    """The path of a pipeline: a leg ends where the next stage has another method or other options. key_of: the key of some stages."""
    asked = [(planned.name, planned.options) for planned in plan]
    ends = [
        end for end in range(1, len(plan) + 1) if end == len(plan) or asked[end] != asked[end - 1]
    ]
    return tuple(
        PlannedLeg(first, end, key_of(plan[:end]), key_of(plan[first:end]))
        for first, end in zip([0, *ends], ends, strict=False)
    )


def leg_files(number: int) -> dict[str, str]:
    """The files of stage `number` (from 1) in the folder of a leg, by what they hold."""
    return {what: f"{what}_{number}.nc" for what in _FILES}


def timeout_key(key: str, limit: float) -> str:
    """The name of a leg that used up the time limit [s] of its run."""
    return f"{key}-{limit:g}s"


def is_deterministic(records: Sequence[StageRecord]) -> bool:
    """Whether another run would have found the same: no clock, no crash, no judge that stumbled."""
    return all(record.outcome not in _BY_CHANCE for record in records) and _is_judged(records)


def ended_by_timeout(records: Sequence[StageRecord]) -> bool:
    """Whether a clock ended the last of these, and chance nothing else."""
    return (
        bool(records)
        and records[-1].outcome == "time_limit"
        and is_deterministic(records[:-1])
        and _is_judged(records)
    )


def _is_judged(records: Sequence[StageRecord]) -> bool:
    return all(not record.has_plan or record.metrics for record in records)


def write_leg(folder: Path, leg: LegRecord) -> LegRecord:
    """Say beside the files of a leg what it found, and what the files are.

    Raises MachineError where the disk refuses.
    """
    leg = leg.model_copy(
        update={"files": {path.name: _digest(path) for path in sorted(folder.glob("*.nc"))}}
    )
    content = leg.model_dump_json().encode()
    write_durably(folder / CONTENT, gzip.compress(content, _LEVEL, mtime=0))
    return leg


def read_leg(folder: Path, *keys: str) -> LegRecord:
    """What a leg found that has one of these keys.

    Raises OSError or ValueError where it is not whole.
    """
    try:
        content = gzip.decompress((folder / CONTENT).read_bytes())
    except (EOFError, zlib.error) as error:
        raise ValueError("it is cut or damaged") from error
    leg = LegRecord.model_validate_json(content)
    if leg.key not in keys:
        raise ValueError("it is another leg than its folder says")
    if any(_digest(folder / Path(name).name) != digest for name, digest in leg.files.items()):
        raise ValueError("a file was changed")
    return leg


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def plan_of(leg: LegRecord, folder: Path, scene: Scene) -> Trajectory | None:
    """The last plan that a leg found, from the files in its folder.

    Raises what damaged files raise.
    """
    number = max(
        (number for number, record in enumerate(leg.stages, 1) if record.has_plan), default=None
    )
    return None if number is None else read_netcdf(folder / leg_files(number)["trajectory"], scene)


@dataclass(frozen=True)
class StoredStage:
    """A stage of a stored leg. files: "trajectory", "replay", "tracked" -> path, if there is one."""

    record: StageRecord
    plan: Trajectory | None
    files: Mapping[str, Path]


def stored_stages(
    stored: Path,
    path: Sequence[Leg],
    scene: Scene,
    methods: Mapping[str, Method],
    key_of: Callable[[Sequence[Planned]], str],
) -> tuple[StoredStage, ...]:
    """Return the stored stages of the last leg of a path from a cold start.

    Returns () if the leg is not stored or damaged. stored: the folder of all legs; methods: the
    methods of the legs, by name.
    """
    plan = planned_stages(Pipeline(name="", title="", legs=tuple(path)), methods)
    wanted = planned_legs(plan, key_of)[-1]
    folder = stored / wanted.key
    try:
        leg = read_leg(folder, wanted.key)
        found = tuple(
            _stored_stage(record, folder, number, scene)
            for number, record in enumerate(leg.stages, 1)
        )
    except _DAMAGED:
        return ()
    return found if len(found) == len(path[-1].schedule) else ()


def _stored_stage(record: StageRecord, folder: Path, number: int, scene: Scene) -> StoredStage:
    files = {
        what: folder / name for what, name in leg_files(number).items() if (folder / name).exists()
    }
    plan = read_netcdf(files["trajectory"], scene) if record.has_plan else None
    return StoredStage(record, plan, files)


def legs_in(folder: Path, legs: Sequence[PlannedLeg]) -> list[LegRecord]:
    """Of a path those legs that lie in the folder of their run, in order.

    Up to the first that is not there or is damaged.
    """
    found = []
    for number, leg in enumerate(legs, 1):
        try:
            found.append(read_leg(place(folder, number), leg.key, leg.alone))
        except _DAMAGED:
            break
    return found


def place(folder: Path, number: int) -> Path:
    """Where leg `number` (from 1) lies in the folder of a run."""
    return folder / f"leg_{number}"


def take(
    stored: Path, key: str, limit: float | None, stages: int, into: Path, scene: Scene
) -> tuple[LegRecord, Trajectory | None] | None:
    """A stored leg of so many stages, and its plan; its files are linked into a new folder `into`.

    None if it is not stored.

    stored: the folder of all legs; limit [s]: of the run that asks, None where it would not end
        there too. A leg that is damaged is put aside, into the
    folder that `into` lies in.
    """
    for name in (key,) if limit is None else (key, timeout_key(key, limit)):
        source = stored / name
        if not source.is_dir():
            continue
        try:
            leg = read_leg(source, key)
            if (leg.limit is None and len(leg.stages) != stages) or len(leg.stages) > stages:
                raise ValueError("it has another number of stages")
            plan = plan_of(leg, source, scene)
            link(source, into)
            return leg, plan
        except _DAMAGED:
            shutil.rmtree(into, ignore_errors=True)
            with contextlib.suppress(OSError):
                os.rename(source, into.with_name(f"damaged-{name}"))  # goes with the run's folder
    return None


def store(folder: Path, leg: LegRecord, stored: Path) -> None:
    """Store a leg that lies in the folder of its run. Raises OSError where the disk refuses."""
    target = stored / (leg.key if leg.limit is None else timeout_key(leg.key, leg.limit))
    if target.exists():
        return
    aside = folder.with_name(f"storing-{folder.name}")
    link(folder, aside)
    fsync_whole(aside)
    stored.mkdir(exist_ok=True)
    renamed(aside, target)  # or another campaign was first
    fsync(stored)


def store_as(folder: Path, leg: LegRecord, key: str, stored: Path) -> None:
    """Store a leg of a run's folder under a second key. Raises OSError."""
    aside = folder.with_name(f"storing-{key}")
    link(folder, aside)
    remove(aside / CONTENT)
    store(aside, write_leg(aside, leg.model_copy(update={"key": key})), stored)
    shutil.rmtree(aside, ignore_errors=True)


def link(source: Path, target: Path) -> None:
    """Make a folder of the same files, without copying them where the file system allows it.

    Raises OSError.
    """
    target.mkdir()
    for path in source.iterdir():
        link_file(path, target / path.name)


def link_file(source: Path, target: Path) -> None:
    """Give a file another name, in place of what had it. Raises OSError."""
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError:  # a file system without links, or with fewer of them
        shutil.copyfile(source, target)


def forget(paths: Iterable[Sequence[PlannedLeg]], stored: Path) -> None:
    """Take away stored legs: they are to be run anew. What cannot be removed is used again."""
    for key in {key for path in paths for leg in path for key in (leg.key, leg.alone)}:
        for folder in stored.glob(f"{key}*"):
            shutil.rmtree(folder, ignore_errors=True)

"""Leg: one session of a method over its eps; a campaign's unit of work, keyed and stored once.

    DIR/legs/<key>/leg.json.gz, trajectory_<n>.nc, replay_<n>.nc, tracked_<n>.nc   stages n from 1

A run is a path of legs, each started from the previous plan. A key covers the scene, all stages up
to the leg's end, sources and libraries, so that pipelines share legs and runs resume. Only the plan
continues across legs: results do not depend on whether earlier legs were stored. A leg that ignores
its start is stored as the first leg of a path. Results of a crash or a clock are not stored, except
a timeout for runs with the same limit.
"""

from __future__ import annotations

import contextlib
import gzip
import hashlib
import os
import shutil
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from formulations.method import Leg, Method, Options, Pipeline
from formulations.pipelines import stage_plan
from models.errors import TouchstoneError
from models.results.run import LegRecord, StageRecord
from models.results.stored import from_json, to_json
from models.scene import Scene
from models.trajectory import Trajectory
from models.trajectory_netcdf import read_netcdf
from validate.processes.disk import fsync, fsync_whole, remove, renamed, write_durably
from validate.store.provenance import content_key
from validate.tasks.task import PlannedLeg

CONTENT = "leg.json.gz"
# Level of gzip; higher levels save less than 5 %.
_LEVEL = 4

_FILES = ("trajectory", "replay", "tracked")
# Outcomes that may differ in another run.
_BY_CHANCE = frozenset({"time_limit", "crashed", "interrupted"})
# Errors of reading damaged content; pydantic's are ValueErrors.
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
    """A planned stage: a method at one eps."""

    index: int
    name: str
    method: Method
    eps: float | None
    options: Options

    @property
    def title(self) -> str:
        """Return the method, and its eps if it has one."""
        return self.name if self.eps is None else f"{self.name}, eps {self.eps:g}"

    def asked(self) -> list[Any]:
        """Return the stage's part of a key."""
        places = {item.name for item in fields(self.options) if item.metadata.get("place")}
        options = asdict(self.options).items()
        return [
            self.name,
            self.eps,
            {name: repr(value) for name, value in options if name not in places},
        ]


def planned_stages(pipeline: Pipeline, methods: Mapping[str, Method]) -> tuple[Planned, ...]:
    """Return the stages of a pipeline with all options. Raises OptionError."""
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
    """Return the key of stages on a scene; source: the plugin's; named: words of a run's key."""
    methods = {planned.name for planned in stages} | {
        leg.method for planned in stages for way in planned.method.ways for leg in way.legs
    }
    request = [*named, [planned.asked() for planned in stages]]
    return content_key(scene, request, methods, source)


def planned_legs(
    plan: Sequence[Planned], key_of: Callable[[Sequence[Planned]], str]
) -> tuple[PlannedLeg, ...]:
    """Return the legs of a pipeline, split at each other method or option; key_of: of stages."""
    settings = [(planned.name, planned.options) for planned in plan]
    ends = [
        end
        for end in range(1, len(plan) + 1)
        if end == len(plan) or settings[end] != settings[end - 1]
    ]
    return tuple(
        PlannedLeg(first, end, key_of(plan[:end]), key_of(plan[first:end]))
        for first, end in zip([0, *ends], ends, strict=False)
    )


def leg_files(number: int) -> dict[str, str]:
    """Return the file names of stage `number` (from 1) of a leg, by content."""
    return {what: f"{what}_{number}.nc" for what in _FILES}


def timeout_key(key: str, limit: float) -> str:
    """Return the name of a leg that used up its run's time limit [s]."""
    return f"{key}-{limit:g}s"


def is_deterministic(records: Sequence[StageRecord]) -> bool:
    """Return whether another run must give the same records."""
    return all(record.outcome not in _BY_CHANCE for record in records) and _is_judged(records)


def ended_by_timeout(records: Sequence[StageRecord]) -> bool:
    """Return whether the time limit alone, and nothing by chance, ended these records."""
    return (
        bool(records)
        and records[-1].outcome == "time_limit"
        and is_deterministic(records[:-1])
        and _is_judged(records)
    )


def _is_judged(records: Sequence[StageRecord]) -> bool:
    return all(not record.has_plan or record.metrics for record in records)


def write_leg(folder: Path, leg: LegRecord) -> LegRecord:
    """Write the record and file digests of a leg. Raises MachineError if the disk refuses."""
    leg = replace(leg, files={path.name: _digest(path) for path in sorted(folder.glob("*.nc"))})
    content = to_json(leg).encode()
    write_durably(folder / CONTENT, gzip.compress(content, _LEVEL, mtime=0))
    return leg


def read_leg(folder: Path, *keys: str) -> LegRecord:
    """Return the record of a leg with one of these keys. Raises OSError, ValueError if damaged."""
    try:
        content = gzip.decompress((folder / CONTENT).read_bytes())
    except (EOFError, zlib.error) as error:
        raise ValueError("it is cut or damaged") from error
    leg = from_json(LegRecord, content)
    if leg.key not in keys:
        raise ValueError("its key differs from its folder's")
    if any(_digest(folder / Path(name).name) != digest for name, digest in leg.files.items()):
        raise ValueError("a file was changed")
    return leg


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def plan_of(leg: LegRecord, folder: Path, scene: Scene) -> Trajectory | None:
    """Return the last plan of a leg. Raises the errors of damaged files."""
    number = max(
        (number for number, record in enumerate(leg.stages, 1) if record.has_plan), default=None
    )
    return None if number is None else read_netcdf(folder / leg_files(number)["trajectory"], scene)


@dataclass(frozen=True)
class StoredStage:
    """A stage of a stored leg; files: existing ones of "trajectory", "replay", "tracked"."""

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
    """Return the stored stages of a cold path's last leg, () if missing or damaged.

    stored: folder of all legs; methods: by name.
    """
    plan = planned_stages(Pipeline(name="", title="", legs=tuple(path)), methods)
    wanted = planned_legs(plan, key_of)[-1]
    folder = stored / wanted.key
    try:
        leg = read_leg(folder, wanted.key)
        stages = tuple(
            _stored_stage(record, folder, number, scene)
            for number, record in enumerate(leg.stages, 1)
        )
    except _DAMAGED:
        return ()
    return stages if len(stages) == len(path[-1].schedule) else ()


def _stored_stage(record: StageRecord, folder: Path, number: int, scene: Scene) -> StoredStage:
    files = {
        what: folder / name for what, name in leg_files(number).items() if (folder / name).exists()
    }
    plan = read_netcdf(files["trajectory"], scene) if record.has_plan else None
    return StoredStage(record, plan, files)


def legs_in(folder: Path, legs: Sequence[PlannedLeg]) -> list[LegRecord]:
    """Return the legs in the folder of a run, up to the first missing or damaged one."""
    records = []
    for number, leg in enumerate(legs, 1):
        try:
            records.append(read_leg(place(folder, number), leg.key, leg.alone))
        except _DAMAGED:
            break
    return records


def place(folder: Path, number: int) -> Path:
    """Return the folder of leg `number` (from 1) of a run."""
    return folder / f"leg_{number}"


def take(
    stored: Path, key: str, limit: float | None, stages: int, into: Path, scene: Scene
) -> tuple[LegRecord, Trajectory | None] | None:
    """Return a stored leg of this many stages and its plan, with files linked into `into`.

    None if not stored. limit [s]: also accept a leg that a run of this limit ended. A damaged leg
    is moved into the run's folder.
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
                os.rename(
                    source, into.with_name(f"damaged-{name}")
                )  # is removed with the run's folder
    return None


def store(folder: Path, leg: LegRecord, stored: Path) -> None:
    """Store a leg of a run's folder. Raises OSError if the disk refuses."""
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
    store(aside, write_leg(aside, replace(leg, key=key)), stored)
    shutil.rmtree(aside, ignore_errors=True)


def link(source: Path, target: Path) -> None:
    """Create a folder with links to files, or copies. Raises OSError."""
    target.mkdir()
    for path in source.iterdir():
        link_file(path, target / path.name)


def link_file(source: Path, target: Path) -> None:
    """Link or copy a file, replacing the target. Raises OSError."""
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError:  # a file system without links, or with a limit
        shutil.copyfile(source, target)


def forget(paths: Iterable[Sequence[PlannedLeg]], stored: Path) -> None:
    """Delete stored legs that must run again; legs that cannot be removed are reused."""
    for key in {key for path in paths for leg in path for key in (leg.key, leg.alone)}:
        for folder in stored.glob(f"{key}*"):
            shutil.rmtree(folder, ignore_errors=True)

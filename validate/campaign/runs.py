"""Select the tasks of a campaign in order, scenes by pipelines before checks; read stored records.

entries, left_out = select(CampaignSettings(out=Path("runs/all"), quick=True))
entries = with_stored(entries, store, settings)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from formulations.method import Pipeline
from formulations.pipelines import PIPELINES, method_names
from models.catalog import load_scene, scene_names, scene_path
from models.results.check import divided
from models.results.run import RunRecord
from models.results.verdict import HOLD
from models.scene import Scene
from reports.load import Stored
from reports.paper import SCENE as PAPER_SCENE
from reports.rule import failed_keys
from validate.campaign.selection import matches, near, words_of
from validate.campaign.stored import CampaignError, campaign_of, identity
from validate.judge.score import check_limits
from validate.store.provenance import survey_sources
from validate.store.store import Store
from validate.tasks.check import check_key
from validate.tasks.leg import Planned, leg_key, planned_legs, planned_stages
from validate.tasks.path import LoadedRun
from validate.tasks.plugins import DEFAULT_PLUGIN, Plugin, load_plugin, plugin_source
from validate.tasks.task import CheckTask, RunTask, SceneReference, Task, TaskRecord, task_to_json

NOTHING_STORED = "nothing is stored of it"
# Largest number of explained unknown words of a -k.
_UNKNOWN = 3


class NothingSelectedError(CampaignError):
    """A -k that selects nothing.

    `mistakes` contains a sentence for each word that is in no name.
    """

    def __init__(self, expression: str, names: Sequence[str]) -> None:
        self.headline = f"nothing to run: -k {expression!r} selects no run and no check"
        unknown = [word for word in words_of(expression) if not matches(word, names)]
        self.mistakes = tuple(_unknown(word, names) for word in unknown[:_UNKNOWN])
        if not unknown:
            self.mistakes = (
                "each of its words is in a name, but no scene with its pipeline and methods has all that it asks for",
            )
        self.mistakes += ("`python -m validate list` has all names; =NAME asks for the whole name",)
        super().__init__(f"{self.headline}: {'; '.join(self.mistakes)}.")


def _unknown(word: str, names: Sequence[str]) -> str:
    elsewhere = [pipeline for pipeline in PIPELINES if pipeline.name == word and pipeline.only]
    if elsewhere:
        return f"{word!r} runs by default on {elsewhere[0].only} only; a campaign file can select it for other scenes"
    if matches(word, method_names()):
        return f"{word!r} is a method that no pipeline of these scenes runs; a new one needs a row in formulations/pipelines.py"
    return f"{word!r} is in no name; near are {', '.join(near(word, names))}"


@dataclass(frozen=True, kw_only=True)
class CampaignSettings:
    """The user's choices for a campaign.

    - scenes: names or paths, empty for the whole catalog
    - last_failed: run only tasks that failed in the folder's last campaign, even if stored
    - stop_early: stop at the first failure
    - retries: number of retries of a task that crashes
    - engine: runs the tasks (validate.campaign.engine)
    - worlds: plans that are tried in perturbed worlds: all that hold (True), none (False), the
      cheapest of each scene (None)
    - jobs: tasks at a time, None for the engine's default

    A campaign file sets these fields:

    - chosen: replaces `scenes`
    - pipelines: replaces all pipelines
    - checked: scenes whose FMUs are checked
    - title: title of the report
    - files: texts written into the folder, by name
    - refused: a sentence for each instance of foreign plans that does not run
    """

    out: Path
    scenes: tuple[str, ...] = ()
    quick: bool = False
    expression: str | None = None
    jobs: int | None = None
    engine: str = "local"
    fresh: bool = False
    time_limit: float = 240.0
    plugin: str = DEFAULT_PLUGIN
    command: str = ""
    last_failed: bool = False
    stop_early: bool = False
    retries: int = 0
    worlds: bool | None = None
    chosen: tuple[SceneReference, ...] = ()
    pipelines: tuple[Pipeline, ...] = ()
    checked: tuple[SceneReference, ...] = ()
    title: str = ""
    files: Mapping[str, str] = field(default_factory=dict)
    refused: tuple[str, ...] = ()

    def wants(self, names: Iterable[str], title: str) -> bool:
        """Return whether `-k` selects a task of these names and title. Raises SelectionError."""
        return self.expression is None or matches(self.expression, names, title)

    @property
    def is_part(self) -> bool:
        """Return whether the settings select a part of a campaign.

        The folder's other tasks then stay in its tables and report.
        """
        return bool(self.expression is not None or self.scenes or self.quick or self.last_failed)


@dataclass(frozen=True)
class PlannedTask:
    """A task with the data of the parent process.

    loaded: a run as loaded in this process.
    stored: the task's record, if usable.
    why: the reason to run the task although a similar record may be stored.
    """

    task: Task
    loaded: LoadedRun | None = None
    stored: TaskRecord | None = None
    why: str = ""


def scenes_of(entries: Iterable[PlannedTask]) -> dict[str, Scene]:
    """Return the scenes of the runs among these tasks, by name."""
    return {
        entry.loaded.scene.name: entry.loaded.scene for entry in entries if entry.loaded is not None
    }


def select(settings: CampaignSettings) -> tuple[list[PlannedTask], tuple[str, ...]]:
    """Return the selected tasks in order, and titles of tasks that a quick campaign omits.

    Raises TouchstoneError.
    """
    plugin = load_plugin(settings.plugin)
    scenes = list(settings.chosen) or _scenes(settings)
    entries: list[PlannedTask] = []
    seen: list[str] = []
    left_out: list[tuple[str, str]] = []
    long: list[str] = []
    for reference in scenes:
        scene = reference.scene
        pipelines = reference.pipelines
        if pipelines is None:
            pipelines = settings.pipelines or plugin.pipelines_for(scene)
        for pipeline in pipelines:
            methods = dict.fromkeys(leg.method for leg in pipeline.legs)
            seen += [scene.name, pipeline.name, *methods]
            if settings.wants(
                (scene.name, pipeline.name, *methods), f"{scene.name} x {pipeline.name}"
            ):
                if _is_too_long(settings, scene):
                    long.append(scene.name)
                elif settings.quick and pipeline.name not in plugin.quick:
                    left_out.append((scene.name, pipeline.name))
                else:
                    entries.append(_entry(settings, plugin, reference, pipeline))
    long = list(dict.fromkeys(long))
    skipped = (
        *_in_words(left_out, len(scenes) - len(long)),
        *(f"{name} x every pipeline" for name in long),
    )
    checks, unchecked = _checks(
        settings, plugin, settings.checked if settings.chosen else scenes, seen
    )
    skipped += unchecked
    if entries or checks:
        return [*entries, *checks], skipped
    if skipped:
        raise CampaignError(
            f"nothing to run: --quick leaves out all that is selected ({', '.join(skipped)}); drop --quick."
        )
    raise NothingSelectedError(settings.expression or "", tuple(dict.fromkeys(seen)))


def _is_too_long(settings: CampaignSettings, scene: Scene) -> bool:
    """Return whether a quick campaign omits the scene: not `quick`, and not named by the user."""
    return settings.quick and not scene.quick and not settings.scenes


def _scenes(settings: CampaignSettings) -> list[SceneReference]:
    scenes: list[SceneReference] = []
    for name in dict.fromkeys(settings.scenes or scene_names()):
        found = referred(name)
        if any(
            other.scene.name == found.scene.name and other.scene is not found.scene
            for other in scenes
        ):
            raise CampaignError(
                f"--scene {name}: another scene of this campaign is named {found.scene.name!r} too; rename one of them."
            )
        scenes.append(found)
    if settings.scenes:
        return scenes
    # The user reads Table I first, which is complete after a minute; then cheap scenes precede
    # expensive ones.
    return sorted(
        scenes,
        key=lambda reference: (reference.scene.name != PAPER_SCENE, scene_cost(reference.scene)),
    )


def referred(name: str) -> SceneReference:
    """Return a scene by its name or file path. Raises UnknownNameError, SceneError."""
    scene = load_scene(name)
    check_limits(scene, scene_path(name))
    return SceneReference(str(Path(name).resolve()) if name.endswith(".py") else name, scene)


def scene_cost(scene: Scene) -> int:
    """Return the expected relative cost of a scene: steps times states times contacts.

    The friction of a contact counts as another contact. A scene without inputs costs 0, because its
    motion is only simulated. Over the 16 scenes of touchstone the rank correlation with the CPU
    seconds of all runs is 0.94.
    """
    return (
        scene.task.steps * 2 * scene.nq * max(1, scene.nc + len(scene.frictions))
        if scene.inputs
        else 0
    )


def _checks(
    settings: CampaignSettings, plugin: Plugin, scenes: Sequence[SceneReference], seen: list[str]
) -> tuple[list[PlannedTask], tuple[str, ...]]:
    """Return the selected checks, and titles of checks that a quick campaign omits.

    The names of all checks are added to `seen`. If scenes are named, only checks of these scenes are
    selected.
    """
    long = {reference.scene.name for reference in scenes if _is_too_long(settings, reference.scene)}
    wanted: list[PlannedTask] = []
    left_out: list[CheckTask] = []
    for item in plugin.checks(scenes):
        if item.scene is None and (settings.scenes or settings.chosen):
            continue
        seen += [name for name in item.names if name not in seen]
        if not settings.wants(item.names, item.title):
            continue
        if settings.quick and (not item.quick or item.scene in long):
            left_out.append(item)
            continue
        wanted.append(
            PlannedTask(replace(item, key=check_key(item), time_limit=settings.time_limit))
        )
    return wanted, _counted(left_out)


def _counted(checks: Sequence[CheckTask]) -> tuple[str, ...]:
    """Return the title of a single check, or the number of checks, of each group."""
    groups: dict[str, list[str]] = {}
    for item in checks:
        groups.setdefault(item.group or item.kind, []).append(item.title)
    return tuple(
        titles[0] if len(titles) == 1 else f"{group}: {len(titles)} checks"
        for group, titles in groups.items()
    )


def _in_words(runs: Sequence[tuple[str, str]], scenes: int) -> tuple[str, ...]:
    """Return `scene x pipeline`, or once `every scene x pipeline` for all of several scenes."""
    times = Counter(pipeline for _, pipeline in runs)
    return tuple(
        dict.fromkeys(
            f"{'every scene' if times[pipeline] == scenes > 1 else scene} x {pipeline}"
            for scene, pipeline in runs
        )
    )


def _entry(
    settings: CampaignSettings, plugin: Plugin, reference: SceneReference, pipeline: Pipeline
) -> PlannedTask:
    scene, plan = reference.scene, planned_stages(pipeline, plugin.methods_of(pipeline))
    source = plugin_source(settings.plugin)

    def key_of(stages: Sequence[Planned]) -> str:
        return leg_key(scene, stages, source)

    used = {
        leg.key
        for planned in plan
        for way in planned.method.ways
        for leg in planned_legs(planned_stages(way, plugin.methods_of(way)), key_of)
    }
    task = RunTask(
        key=leg_key(
            scene,
            plan,
            source,
            pipeline.name,
            pipeline.title,
            reference.instance,
            reference.judged_by,
        ),
        scene=reference.where,
        scene_name=scene.name,
        pipeline=pipeline,
        plugin=settings.plugin,
        time_limit=settings.time_limit,
        variant=reference.variant,
        legs=planned_legs(plan, key_of),
        uses=tuple(sorted(used)),
        instance=reference.instance,
        judged_by=reference.judged_by,
    )
    return PlannedTask(task, LoadedRun(scene=scene, plan=plan))


def with_stored(
    entries: Sequence[PlannedTask], store: Store, settings: CampaignSettings
) -> list[PlannedTask]:
    """Return the tasks with their usable stored records, or with the reason to run.

    `settings.last_failed`: return the tasks of `only_last_failed`, which may raise CampaignError.
    """
    usable = (_usable(store, entry.task, settings.fresh) for entry in entries)
    found = [
        replace(entry, stored=record, why=why)
        for entry, (record, why) in zip(entries, usable, strict=True)
    ]
    return only_last_failed(found, store) if settings.last_failed else found


def _usable(store: Store, task: Task, fresh: bool) -> tuple[TaskRecord | None, str]:
    record = store.read(task.key)
    if record is None:
        return None, "stored, but its record cannot be read" if (
            store.runs / task.key
        ).is_dir() else NOTHING_STORED
    if fresh:
        return None, "stored, but --fresh runs it again"
    stages = record.stages if isinstance(record, RunRecord) else ()
    outcomes = {record.outcome, *(stage.outcome for stage in stages)}
    if "crashed" in outcomes:
        return None, "stored, but it crashed"
    if "time_limit" in outcomes or any(stage.certificate_missing for stage in stages):
        asked = store.request(task.key).get("time_limit")
        before = asked if isinstance(asked, (int, float)) else 0.0
        if not before >= task.time_limit:
            return (
                None,
                f"stored, but it ran out of {before:g} s and would have {task.time_limit:g} s now",
            )
    if file := store.damaged_file(task.key):
        return None, f"stored, but {file} is gone or cut off"
    return record, ""


def worlds_tasks(
    entries: Iterable[PlannedTask],
    records: Mapping[str, TaskRecord],
    worlds: bool | None,
) -> list[RunTask]:
    """Return a task for each run whose plans must still be tried in perturbed worlds.

    records: of all tasks of the folder, by key; their order decides between plans of equal cost.
    worlds: see `CampaignSettings`.
    """
    if worlds is False:
        return []
    runs = [
        (entry.task, record)
        for entry in entries
        if isinstance(entry.task, RunTask)
        and isinstance(record := records.get(entry.task.key), RunRecord)
    ]
    if worlds is None:
        stored = Stored(None, divided(records.values())[0])
        cheapest = {
            plans[0][0].key
            for scene in {run.scene.name for _, run in runs}
            if (plans := stored.cheapest(scene))
        }
        # Foreign plans have many scenes and are tried only on request.
        runs = [(task, run) for task, run in runs if run.key in cheapest and not task.instance]
    tasks = []
    for task, run in runs:
        wanted = tuple(
            stage.index
            for stage in (run.stages if worlds else run.stages[-1:])
            if stage.verdict in HOLD
            and (stage.survey is None or stage.survey.sources != survey_sources())
        )
        tasks += [replace(task, worlds=wanted)] if wanted else []
    return tasks


def reasons(entries: Sequence[PlannedTask], store: Store) -> list[str]:
    """Return for each task the reason to run, "" if its record is used.

    The reason mentions a stored record of another version.
    """
    others = {identity(request) for request in store.requests()}
    return [
        "stored for other code, options, libraries or another scene file"
        if entry.why == NOTHING_STORED and identity(task_to_json(entry.task)) in others
        else entry.why
        for entry in entries
    ]


def past_seconds(entries: Sequence[PlannedTask], store: Store) -> dict[str, float]:
    """Return the CPU time [s] of the previous run of each task that must run, by key.

    Records of any code version in this folder count. Tasks without a record are omitted.
    """
    keys: dict[str, list[str]] = {}
    for request in store.requests():
        keys.setdefault(identity(request), []).append(str(request.get("key")))
    found: dict[str, float] = {}
    for entry in entries:
        if entry.stored is None:
            before = [
                record
                for key in keys.get(identity(task_to_json(entry.task)), ())
                if (record := store.read(key)) is not None
            ]
            if before:
                found[entry.task.key] = max(
                    before, key=lambda record: record.provenance.started
                ).cpu_seconds
    return found


def only_last_failed(entries: Sequence[PlannedTask], store: Store) -> list[PlannedTask]:
    """Return the tasks that failed in the folder's last campaign, and the stored tasks.

    Failed tasks run again. Tasks that are neither are omitted. Raises CampaignError if there is no
    campaign, or if no selected task failed.
    """
    records = tuple(filter(None, map(store.read, campaign_of(store.folder).keys)))
    failing = failed_keys(records)
    failed = {identity(store.request(key)) for key in failing}
    again = {entry.task.key for entry in entries if identity(task_to_json(entry.task)) in failed}
    if not again:
        hint = "drop --last-failed."
        if failing:
            named = sorted(record.title for record in records if record.key in failing)
            more = f" and {len(named) - 3} more" if len(named) > 3 else ""
            hint = f"what did is not selected ({', '.join(named[:3])}{more}): select it as it was, by -k, --scene, --plugin or the file of `run`."
        raise CampaignError(
            f"nothing to run: nothing that is selected failed when the campaign in {store.folder} last ran; {hint}"
        )
    why = "it failed the last time"
    return [
        replace(entry, stored=None, why=why) if entry.task.key in again else entry
        for entry in entries
        if entry.task.key in again or entry.stored is not None
    ]

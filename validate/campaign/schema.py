"""Define the keys of a campaign file, and write the resolved file.

    CampaignFile.model_validate(data)

`python -m validate run --schema` prints the JSON Schema, with the descriptions below. A run of the
resolved file gives the same tasks with the same keys. The resolved file contains:

- one number for each change of a scene
- absolute paths of scene files
- default options of the methods in the file's own pipelines
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from validate.processes.toml_text import is_number, toml_text, toml_value

if TYPE_CHECKING:
    from formulations.method import Method
    from validate.tasks.task import SceneReference

# No method can handle a plan of a million steps.
MOST_STEPS = 1_000_000
FREE = "free"
# Keys of [[plans]] whose values are paths, with any ending.
_PLACES = frozenset({"instances", "plans", "time_step", "start"})


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def _listed(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


def _short_limit(value: Any) -> Any:
    return (
        {"value": value}
        if isinstance(value, (int, float)) and not isinstance(value, bool)
        else value
    )


def _short_scene(value: Any) -> Any:
    return {"scene": value} if isinstance(value, str) else value


def _option(value: Any) -> Any:
    items = value if isinstance(value, list) else [value]
    if not all(isinstance(item, (bool, int, float, str)) for item in items):
        raise ValueError("true, false, a number, text, or a list of these")
    return value


def _end(value: Any) -> Any:
    if value != FREE and not is_number(value):
        raise ValueError(f'a number, or "{FREE}"')
    return value


# A number, or several numbers; each gives its own scene.
Numbers = Annotated[
    list[float],
    BeforeValidator(_listed, json_schema_input_type=float | list[float]),
    Field(min_length=1),
]
Counts = Annotated[
    list[Annotated[int, Field(ge=1, le=MOST_STEPS)]],
    BeforeValidator(_listed, json_schema_input_type=int | list[int]),
    Field(min_length=1),
]
Steps = Annotated[
    list[Annotated[float, Field(gt=0.0)]],
    BeforeValidator(_listed, json_schema_input_type=float | list[float]),
    Field(min_length=1),
]
Ends = Annotated[
    list[Annotated[Any, BeforeValidator(_end, json_schema_input_type=float | Literal["free"])]],
    BeforeValidator(
        _listed, json_schema_input_type=float | Literal["free"] | list[float | Literal["free"]]
    ),
    Field(min_length=1),
]
Option = Annotated[
    Any,
    BeforeValidator(
        _option, json_schema_input_type=bool | int | float | str | list[bool | int | float | str]
    ),
]


class CampaignLimit(_Strict):
    """A limit on a figure of the score, and its reason."""

    value: float = Field(ge=0.0, description="The largest value with which a plan still holds.")
    reason: str = "set in the campaign file"


OfLimit = Annotated[
    CampaignLimit, BeforeValidator(_short_limit, json_schema_input_type=float | CampaignLimit)
]


class SceneEntry(_Strict):
    """A scene and its changes.

    A list instead of a number gives one scene for each of its values.
    """

    scene: str = Field(
        min_length=1,
        description="A name (`python -m validate list`), or the path of a scene file, from the campaign file.",
    )
    name: str | None = Field(
        default=None,
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,60}$",
        description="What the changed scene is called; its own name and the changes without.",
    )
    parameters: dict[str, Numbers] = Field(
        default={}, description="Parameters of the scene by name, in its units."
    )
    steps: Counts | None = Field(default=None, description="How many time steps.")
    step: Steps | None = Field(default=None, description="Length of a time step [s].")
    start: dict[str, Numbers] = Field(
        default={}, description="Components of the first state, by coordinate or velocity."
    )
    goal: dict[str, Ends] = Field(
        default={}, description='Components of the last state; "free" leaves one open.'
    )
    limits: dict[str, OfLimit] = Field(
        default={},
        description="Limits on figures of the score instead of, or beside, those of the scene.",
    )
    sweep: Literal["product", "together"] = Field(
        default="product",
        description="Lists are combined each with each, or value by value (then they are equally long).",
    )


class LegEntry(_Strict):
    """A run of one method over a schedule of eps."""

    method: str = Field(min_length=1, description="A name (`python -m validate list`).")
    eps: list[float] = Field(
        default=[],
        max_length=1000,
        description="The relaxation of each stage, in order; none for a method without.",
    )
    options: dict[str, Option] = Field(
        default={}, description="Options of the method, for all stages."
    )
    stage_options: list[dict[str, Option]] = Field(
        default=[], max_length=1000, description="Options of stage 1, 2, ..., laid over `options`."
    )


class PipelineEntry(_Strict):
    """A chain of methods; each stage starts from the plan of the stage before it."""

    title: str = Field(default="", description="What it is, for tables.")
    legs: list[LegEntry] = Field(min_length=1, max_length=100)


class PlansEntry(_Strict):
    """Plans from files, one for each instance of a scene. Paths start at the campaign file."""

    scene: str = Field(
        min_length=1, description="A name, or the path of a scene file: the physics."
    )
    name: str = Field(
        default="plan",
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,60}$",
        description="Name of these plans in tables, in the place of a pipeline's.",
    )
    instances: str | None = Field(
        default=None,
        description="CSV with one line an instance: name, parameters of the scene, start.NAME and goal.NAME of states, plan (a path). Without it each plan is an instance.",
    )
    plans: str | None = Field(
        default=None,
        description='Pattern of the plans: "plans/*.csv", or "plans/{name}.csv" of instances with names.',
    )
    model: str | None = Field(
        default=None, description="A scene of the plans' own equations, with the same coordinates."
    )
    time_step: str | None = Field(
        default=None,
        description="FILE.py:FUNCTION, the plans' own time step: step(q, v, u, h, parameters) -> (q, v).",
    )
    start: str | None = Field(
        default=None,
        description='A plan from which the pipelines of this file start; a path, or a pattern with "{name}".',
    )
    steps: Annotated[int, Field(ge=1, le=MOST_STEPS)] | None = Field(
        default=None, description="How many time steps."
    )
    step: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="Length of a time step [s]."
    )
    limits: dict[str, OfLimit] = Field(
        default={}, description="Limits on figures of the score, for the scene and the model."
    )


class CampaignFile(_Strict):
    """A campaign of touchstone: scenes by pipelines, plans from files.

    Run it with `python -m validate run FILE.toml`.
    """

    title: str = Field(default="", description="The title of the report.")
    scenes: list[
        Annotated[
            SceneEntry, BeforeValidator(_short_scene, json_schema_input_type=str | SceneEntry)
        ]
    ] = Field(default=[], description="Scenes to plan for; needed if there are no plans.")
    plans: list[PlansEntry] = Field(default=[], description="Plans from files.")
    pipelines: list[str] = Field(
        default=[],
        description="Names of pipelines, ours or of this file; without it all of this file, and if it has none, all of ours.",
    )
    pipeline: dict[str, PipelineEntry] = Field(
        default={}, description="Pipelines of one's own, by name."
    )
    time_limit: float = Field(
        default=240.0, gt=0.0, description="Seconds for each run, all its stages and replays."
    )
    checks: bool = Field(
        default=False, description="Whether the FMUs of the unchanged scenes are checked too."
    )


def resolved_text(
    file: CampaignFile,
    scenes: Sequence[SceneReference],
    load_method: Callable[[str], Method],
    name: str,
    folder: Path,
) -> str:
    """Return the file as text with all defaults.

    name, folder: of the original file.
    """
    head = {
        "title": file.title,
        "time_limit": float(file.time_limit),
        "checks": file.checks,
        "pipelines": file.pipelines or list(file.pipeline),
    }
    lines = [
        f"# {' '.join(name.split())}, with everything filled in",
        *_lines(head),
    ]
    for reference in scenes:
        lines += ["", "[[scenes]]", *_lines(_scene(reference))]
    for entry in file.plans:
        lines += ["", "[[plans]]", *_lines(_plans(entry, folder))]
    for own, entry in file.pipeline.items():
        lines += ["", f"[pipeline.{toml_text(own)}]", *_lines({"title": entry.title})]
        for leg in entry.legs:
            options = {**_defaults(load_method(leg.method)), **leg.options}
            lines += ["", f"[[pipeline.{toml_text(own)}.legs]]"]
            lines += _lines(
                {
                    "method": leg.method,
                    "eps": leg.eps,
                    "options": options,
                    "stage_options": leg.stage_options,
                }
            )
    return "\n".join(lines) + "\n"


def _lines(data: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {toml_value(value)}" for key, value in data.items()]


def _plans(entry: PlansEntry, folder: Path) -> dict[str, Any]:
    """The entry with absolute paths."""

    def absolute(key: str, value: str) -> str:
        is_path = key in _PLACES or value.endswith(".py")
        return str((folder / value).resolve()) if is_path else value

    given = entry.model_dump(exclude_defaults=True)
    return {
        key: absolute(key, value) if isinstance(value, str) else value
        for key, value in given.items()
    }


def _defaults(method: Method) -> dict[str, Any]:
    """Return the method's default options that TOML can represent."""
    return {
        name: value
        for name, value in asdict(method.options()).items()
        if isinstance(value, (bool, int, float, str))
    }


def _scene(reference: SceneReference) -> dict[str, Any]:
    """Return the origin of a scene and its changes."""
    variant = reference.variant
    if variant is None:
        return {"scene": reference.where}
    changes = {
        "steps": variant.steps,
        "step": variant.step,
        "parameters": variant.parameters,
        "start": variant.start,
        "goal": {name: FREE if value is None else value for name, value in variant.goal.items()},
        "limits": {
            metric: {"value": value, "reason": reason}
            for metric, (value, reason) in variant.limits.items()
        },
    }
    return {
        "scene": reference.where,
        "name": variant.name,
        **{key: value for key, value in changes.items() if value not in (None, {})},
    }

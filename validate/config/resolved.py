"""A campaign file in which nothing is left open: run again, it gives the same cells by the same keys.

Every scene stands there with one number for each change, scene files by their absolute paths, pipelines of one's own with their methods'
defaults.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from validate.config.schema import FREE
from validate.toml_text import toml_text, toml_value

if TYPE_CHECKING:
    from formulations.method import Method
    from validate.config.schema import CampaignFile
    from validate.examination import SceneReference


def resolved_text(file: CampaignFile, scenes: Sequence[SceneReference], load_method: Callable[[str], Method], name: str) -> str:
    """The file as text. name: of the file it was made from."""
    seeds = f"seeds = {toml_value(file.seeds)}\n" if file.seeds else ""
    names = file.pipelines or list(file.pipeline)
    lines = [
        f"# {' '.join(name.split())}, with everything filled in",
        f"title = {toml_text(file.title)}",
        f"time_limit = {toml_value(float(file.time_limit))}",
        f"examinations = {toml_value(file.examinations)}",
        f"pipelines = {toml_value(names)}",
        *seeds.splitlines(),
    ]
    for reference in scenes:
        lines += ["", "[[scenes]]", *_scene(reference)]
    for own, entry in file.pipeline.items():
        lines += ["", f"[pipeline.{toml_text(own)}]", f"title = {toml_text(entry.title)}"]
        for leg in entry.legs:
            lines += ["", f"[[pipeline.{toml_text(own)}.legs]]", f"method = {toml_text(leg.method)}", f"eps = {toml_value(leg.eps)}"]
            options = {**_defaults(load_method(leg.method)), **leg.options}
            lines += [f"options = {toml_value(options)}", f"stage_options = {toml_value(leg.stage_options)}"]
    return "\n".join(lines) + "\n"


def _defaults(method: Method) -> dict[str, Any]:
    """Those that TOML can hold."""
    return {name: value for name, value in asdict(method.options()).items() if isinstance(value, (bool, int, float, str))}


def _scene(reference: SceneReference) -> Iterator[str]:
    yield f"scene = {toml_text(reference.where)}"
    variant = reference.variant
    if variant is None:
        return
    yield f"name = {toml_text(variant.name)}"
    goal: dict[str, Any] = {name: FREE if value is None else value for name, value in variant.goal.items()}
    limits = {figure: {"value": value, "reason": reason} for figure, (value, reason) in variant.limits.items()}
    for key in ("steps", "step"):
        if getattr(variant, key) is not None:
            yield f"{key} = {toml_value(getattr(variant, key))}"
    for key, content in (("parameters", variant.parameters), ("start", variant.start), ("goal", goal), ("limits", limits)):
        if content:
            yield f"{key} = {toml_value(content)}"

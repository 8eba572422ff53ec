"""Reads a campaign file, in full or not at all: TOML -> what a campaign runs. Every mistake of a file is reported at once, with its place.

campaign = read_campaign(Path("stiffness.toml"))
run_campaign(CampaignSettings(out=out, **campaign.settings()), narrator)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from formulations.method import Pipeline
from formulations.pipelines import PIPELINES
from models.errors import TouchstoneError
from validate.plan.mistakes import MOST_SHOWN, checked
from validate.plan.pipelines import chosen_pipelines
from validate.plan.scenes import references
from validate.plan.schema import CampaignFile, resolved_text
from validate.plan.toml_text import TomlError, read_toml
from validate.tasks.plugins import DEFAULT_PLUGIN, Plugin, load_plugin
from validate.tasks.variant import SceneReference

# Stored beside the results: the file as it was given, and with everything filled in.
GIVEN, RESOLVED = "campaign.toml", "resolved.toml"


class ConfigError(TouchstoneError):
    """A campaign file with mistakes; `mistakes` has a sentence for each, which begins with its place in the file."""

    def __init__(self, path: Path, mistakes: list[str]) -> None:
        shown = mistakes[:MOST_SHOWN] + ([f"and {len(mistakes) - MOST_SHOWN} more"] if len(mistakes) > MOST_SHOWN else [])
        self.mistakes = tuple(" ".join(mistake.split()) for mistake in shown)
        count = f"{len(mistakes)} mistakes" if len(mistakes) > 1 else "a mistake"
        self.headline = f"campaign {path}: there {'are' if len(mistakes) > 1 else 'is'} {count} in it"
        super().__init__(f"{self.headline}: {'; '.join(self.mistakes)}")


@dataclass(frozen=True)
class Campaign:
    """A campaign file that can be run. text, resolved: the file as it was given, and as another campaign file in which nothing is left open."""

    file: CampaignFile
    text: str
    resolved: str
    scenes: tuple[SceneReference, ...]
    bases: tuple[SceneReference, ...]
    pipelines: tuple[Pipeline, ...]

    def settings(self) -> dict[str, Any]:
        """The fields of validate.plan.runs.CampaignSettings that the file decides."""
        return {
            "chosen": self.scenes,
            "pipelines": self.pipelines,
            "checked": self.bases if self.file.checks else (),
            "time_limit": self.file.time_limit,
            "title": self.file.title,
            "files": {GIVEN: self.text, RESOLVED: self.resolved},
        }


def read_campaign(path: Path, plugin: str = DEFAULT_PLUGIN) -> Campaign:
    """Read and check. Raises ConfigError with every mistake, UnknownNameError for `plugin`."""
    loaded = load_plugin(plugin)
    try:
        text, data = read_toml(path)
    except TomlError as error:
        raise ConfigError(path, [str(error)]) from error
    file, mistakes = checked(data)
    if file is None:
        raise ConfigError(path, mistakes)
    scenes, bases, wrong = references(file.scenes, path.parent)
    mistakes += wrong
    pipelines, wrong = chosen_pipelines(file, _known(loaded, bases), loaded.load_method)
    mistakes += wrong
    if mistakes:
        raise ConfigError(path, mistakes)
    resolved = resolved_text(file, scenes, loaded.load_method, path.name)
    return Campaign(file, text, resolved, tuple(scenes), tuple(bases), pipelines)


def _known(plugin: Plugin, scenes: list[SceneReference]) -> list[Pipeline]:
    """All pipelines there are for these scenes; all of ours where no scene can be read."""
    found = {pipeline.name: pipeline for reference in scenes for pipeline in plugin.pipelines_for(reference.scene)}
    return list(found.values()) or list(PIPELINES)

"""What a shell offers for a value that is being typed."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem

from models.catalog import scene_names


def scenes(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Names of scenes, and files where a path has begun or no name fits."""
    names = [CompletionItem(name) for name in scene_names() if name.startswith(begun)]
    return names or [CompletionItem(begun, type="file")]

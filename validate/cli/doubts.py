"""What is hardly meant in a scene, told on stderr before the command goes on."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import click

from validate.cli.table import one_line

if TYPE_CHECKING:
    from models.scene import Scene


def tell_doubts(scenes: Iterable[Scene]) -> None:
    """One line a doubt (validate.scene_doubts), each scene once."""
    from validate.scene_doubts import doubts

    for sentence in doubts(scenes):
        click.echo(one_line(f"warning: {sentence}"), err=True)

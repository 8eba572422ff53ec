"""Numbers on the command line: nan and inf, which a range of click lets through, are refused.

What a shell offers for a value that is being typed.
"""

from __future__ import annotations

import math
from typing import Any

import click
from click.shell_completion import CompletionItem

from models.catalog import scene_names


def scenes(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Names of scenes, and files where a path has begun or no name fits."""
    names = [CompletionItem(name) for name in scene_names() if name.startswith(begun)]
    return names or [CompletionItem(begun, type="file")]


class FiniteRange(click.FloatRange):
    """A finite number within a range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number; nan, inf and what is outside the range are refused."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number.", param, ctx)
        return number

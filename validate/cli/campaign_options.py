"""The options by which a campaign is chosen: those of `all`, and of `plan`, which says what `all` would do."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from validate.tools import DEFAULT_TOOLS

_Command = TypeVar("_Command", bound=Callable[..., Any])


def _positive(context: click.Context, parameter: click.Parameter, value: float) -> float:
    if not math.isfinite(value) or value <= 0:
        raise click.BadParameter(f"{value:g} is not a positive number of seconds.", ctx=context, param=parameter)
    return value


_OPTIONS = (
    click.option(
        "--quick",
        is_flag=True,
        help="Only the pipelines softplus_dc+strict, softplus_gd+relu_gd and free_motion, and FMUs in FMI 2.0, without scenes that take minutes; below the table stands what was left out.",
    ),
    click.option("--fresh", is_flag=True, help="Run cells again that are stored."),
    click.option(
        "-k",
        "expression",
        default="",
        metavar="EXPR",
        help="Only cells whose scene, pipeline or method names match: words joined with and, or, not.",
    ),
    click.option(
        "-j",
        "--jobs",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        metavar="N",
        help="Cells at a time. With more than one, times are less comparable.",
    ),
    click.option(
        "--scene",
        "scenes",
        multiple=True,
        metavar="NAME|FILE.py",
        help="Only this scene, by name or by the path of a scene file; may be repeated.",
    ),
    click.option(
        "--out", type=click.Path(path_type=Path), default="runs/all", show_default=True, metavar="DIR", help="The folder of the campaign."
    ),
    click.option(
        "--time-limit",
        type=float,
        default=120.0,
        callback=_positive,
        show_default=True,
        metavar="SECONDS",
        help="For each cell, all its stages and replays.",
    ),
    click.option(
        "--tools", default=DEFAULT_TOOLS, metavar="MODULE:NAME", help="Methods, pipelines and judge from elsewhere (see validate/tools.py)."
    ),
)


def campaign_options(command: _Command) -> _Command:
    """Adds them all, as the parameters quick, fresh, expression, jobs, scenes, out, time_limit and tools."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command

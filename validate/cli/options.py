"""Options that several commands share.

`all` and `run` share the options that choose and run a campaign; for `run` a file chooses. Each
option is a parameter named like its field of validate.campaign.runs.CampaignSettings. The module
also contains a range of finite numbers, since click's ranges accept nan and inf, and the shell
completion of scene names.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import click
from click.shell_completion import CompletionItem

from models.catalog import scene_names
from validate.cli.table import wide_option
from validate.processes.disk import make_folder, write_durably

Command = TypeVar("Command", bound=Callable[..., Any])


A_FILE = click.Path(path_type=Path)


def scenes(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Return names of scenes, or files if a path has begun or no name fits."""
    names = [CompletionItem(name) for name in scene_names() if name.startswith(begun)]
    return names or [CompletionItem(begun, type="file")]


class FiniteRange(click.FloatRange):
    """A finite number within a range."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number; refuse nan, inf and numbers outside the range."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number.", param, ctx)
        return number

    def _describe_range(self) -> str:  # click writes [x<=None] for a range without bounds
        return super()._describe_range() if (self.min, self.max) != (None, None) else ""


def written_to(option: str, name: str, metavar: str, what: str) -> Callable[[Command], Command]:
    """Return an option for a file that a command writes.

    name: the command's parameter. what: description of the contents.
    """
    kind = click.Path(path_type=Path, dir_okay=False)
    return lambda command: click.option(
        option, name, type=kind, metavar=metavar, help=f"Write {what} to this file."
    )(apart(option, name)(command))


def apart(option: str, name: str) -> Callable[[Command], Command]:
    """Return a decorator that checks the output file before the command begins.

    The output must be a file, and none of the other files that the command reads or writes.
    """

    def checked(command: Command) -> Command:
        @functools.wraps(command)
        def guarded(*words: Any, **given: Any) -> Any:
            file = given[name]
            if file is not None and not file.name:
                raise click.UsageError(f"{option}: {str(file)!r} names no file; give its path.")
            others = [
                one
                for key, value in given.items()
                if key != name
                for one in (value if isinstance(value, tuple) else (value,))
            ]
            if file is not None and any(
                isinstance(one, (str, Path)) and Path(one).resolve() == file.resolve()
                for one in others
            ):
                raise click.UsageError(
                    f"{option} {file}: this file is named twice, and what it holds would be lost; name another for {option}."
                )
            return command(*words, **given)

        return cast(Command, guarded)

    return checked


def write(file: Path | None, make: Callable[[], str | bytes]) -> None:
    """Write the contents to the file of such an option, if given, and create the file's folder.

    make: returns the contents. Raises MachineError if the disk refuses.
    """
    if file is not None:
        content = make()
        make_folder(file.parent)
        write_durably(file, content)


def folder_of(option: str, words: str) -> Callable[[Command], Command]:
    """Return an option for the folder of a campaign, by default runs/all."""
    return click.option(
        option,
        "folder",
        type=A_FILE,
        default="runs/all",
        show_default=True,
        metavar="DIR",
        help=words,
    )


def options(*wanted: Callable[[Any], Any]) -> Callable[[Command], Command]:
    """Return a decorator that adds these options in this order."""

    def given(command: Command) -> Command:
        for option in reversed(wanted):
            command = option(command)
        return command

    return given


def _our_plugin() -> str:
    """Return the default plugin, read on use.

    The plugin's file imports the methods, which checks and replays of FMUs do not need.
    """
    from validate.tasks.plugins import DEFAULT_PLUGIN

    return DEFAULT_PLUGIN


def _one_expression(
    context: click.Context, option: click.Parameter, given: tuple[str, ...]
) -> str | None:
    if len(given) > 1:
        raise click.UsageError(
            f"-k is given {len(given)} times; join what is meant in one: -k '{' or '.join(map('({})'.format, given))}'."
        )
    return given[0] if given else None


# Options that a campaign file replaces.
CHOOSING = options(
    click.option(
        "--quick",
        is_flag=True,
        help="Run only the pipelines softplus_dc+strict, softplus_gd+relu_gd and free_motion, without the scenes that take minutes.",
    ),
    click.option(
        "--scene",
        "scenes",
        multiple=True,
        metavar="NAME|FILE.py",
        shell_complete=scenes,
        help="Select this scene, by name or by the path of a scene file; may be repeated.",
    ),
    click.option(
        "--time-limit",
        type=FiniteRange(min=0.0, min_open=True),
        default=240.0,
        show_default=True,
        metavar="SECONDS",
        help="Limit the wall time of each run, with all its stages and replays.",
    ),
)
# Options that a campaign file does not replace.
SELECTING = options(
    click.option(
        "-k",
        "expression",
        multiple=True,
        callback=_one_expression,
        metavar="EXPR",
        help="Select by the names of scene, pipeline and method: words joined by and, or, not. =NAME is a whole name; FMU and stress name the checks.",
    ),
    click.option("--fresh", is_flag=True, help="Delete the selected stored runs, then run them."),
    click.option(
        "--worlds/--no-worlds",
        default=None,
        help="Try every plan that holds, or none, in perturbed worlds (docs/robustness.md).  [default: the cheapest of each scene]",
    ),
    click.option(
        "--last-failed",
        "--lf",
        is_flag=True,
        help="Run only the runs that failed in the last campaign in DIR.",
    ),
    click.option(
        "-j",
        "--jobs",
        type=click.IntRange(min=1),
        metavar="N",
        help="Run N runs at a time, each on one core.  [default: the number of cores; on an existing Dask cluster, all]",
    ),
    click.option(
        "--plugin",
        "plugin",
        default=_our_plugin,
        metavar="MODULE[:NAME]",
        help="Load a module on PYTHONPATH with a METHOD of your own, or MODULE:PLUGIN, which may replace the judge (docs/extending.md).",
    ),
)
# Options for the place of execution and its end.
ENDING = options(
    click.option(
        "--engine",
        default="local",
        show_default=True,
        metavar="local|dask[:ADDRESS|:FILE.json]",
        help="Execute runs in child processes here, in Dask workers here, or on a Dask cluster by its scheduler's address or file (docs/cluster.md).",
    ),
    click.option(
        "-x", "stop_early", is_flag=True, help="Stop at the first run that makes the campaign fail."
    ),
    click.option(
        "--retry",
        "retries",
        type=click.IntRange(min=0),
        default=0,
        metavar="N",
        help="Repeat crashed runs, up to N times.",
    ),
)
DRY_RUN = click.option(
    "--dry-run",
    is_flag=True,
    help="Test this machine and list the runs, without running or writing anything.",
)
OUT = click.option(
    "--out",
    type=A_FILE,
    default="runs/all",
    show_default=True,
    metavar="DIR",
    help="Store the campaign in this folder.",
)
OUT_OF_FILE = click.option(
    "--out",
    type=A_FILE,
    metavar="DIR",
    help="Store the campaign in this folder.  [default: runs/NAME of the file]",
)
# How results are printed.
PRINTING = options(
    click.option(
        "--table",
        "as_table",
        is_flag=True,
        help="Print a table with a row for each stage (--dry-run: for each run).",
    ),
    wide_option,
    click.option("--json", "as_json", is_flag=True, help="Print all results as JSON."),
)

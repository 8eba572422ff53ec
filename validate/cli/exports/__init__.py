"""Other exports of the command `fmu`: one file each, which defines EXPORT.

    EXPORT = Export(option="coupled", options=(click.option("--coupled", ..),), ..)

The command finds the files by their place in this folder.
"""

from __future__ import annotations

import importlib
import pkgutil
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from validate.processes.disk import disk_error, make_folder, write_durably


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """Arguments of the command `fmu`; options: those of the exports, by parameter."""

    scene: str | None
    output: Path
    version: str
    platforms: tuple[str, ...]
    options: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Export:
    """An export that an option of `fmu` selects.

    - option: parameter that selects the export.
    - options: click's options, first the selecting one.
    - example: command line for the help.
    - check: raises click.UsageError for options that do not fit, whether selected or not.
    - write: writes the file; returns the exit code.
    """

    option: str
    options: tuple[Callable[[Any], Any], ...]
    example: str
    check: Callable[[ExportRequest], None]
    write: Callable[[ExportRequest], int]


def exports() -> tuple[Export, ...]:
    """Return the exports of this folder, sorted by the names of their files."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return tuple(importlib.import_module(f"{__name__}.{name}").EXPORT for name in names)


def copy(built: Path, output: Path) -> None:
    """Copy a built file to its place and print the place. Raises MachineError."""
    make_folder(output.parent)
    if output.is_file() or not output.exists():
        write_durably(output, built.read_bytes())
    else:  # a pipe or a device
        try:
            shutil.copyfile(built, output)
        except OSError as error:
            raise disk_error(output, error) from error
    click.echo(str(output))

"""Further results of the command `replay`: one file each, which defines ADDITION.

    ADDITION = Addition(name="engines", option=click.option("--engine", "engines", ..), ..)

The command finds the files by their place in this folder.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from validate.judge.judgement import Judgement
    from validate.processes.isolated import Limits


@dataclass(frozen=True, kw_only=True)
class Addition:
    """Results that an option of `replay` adds to a verdict.

    - name: parameter of the option; also the name in the JSON and of the page's section.
    - option: click's option, None by default.
    - example: command line for the help.
    - prepare: takes the option's value and whether the subject is an FMU. Returns the request.
      Raises errors of the user before the replay starts.
    - results: takes judgement, request and limits; returns JSON data.
    - show: prints the results.
    """

    name: str
    option: Callable[[Any], Any]
    example: str
    prepare: Callable[[Any, bool], Any]
    results: Callable[[Judgement, Any, Limits], Sequence[dict[str, Any]]]
    show: Callable[[Sequence[dict[str, Any]]], None]


def additions() -> tuple[Addition, ...]:
    """Return the additions of this folder, sorted by the names of their files."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return tuple(importlib.import_module(f"{__name__}.{name}").ADDITION for name in names)

"""Plausibility warnings about scenes, on stderr before the command goes on."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from validate.cli.table import say

if TYPE_CHECKING:
    from models.scene import Scene


def print_warnings(scenes: Iterable[Scene], *, steps: bool = False) -> None:
    """Print the warnings of `warnings_of`, one line each."""
    for sentence in warnings_of(scenes, steps=steps):
        say(f"warning: {sentence}", err=True)


def warnings_of(scenes: Iterable[Scene], *, steps: bool = False) -> list[str]:
    """Plausibility warnings (validate.plan.warnings), each scene once.

    steps: also about a time step that is unstable in contact, for which scenes that are not in the bank are compiled.
    """
    from validate.plan.warnings import doubts

    each = list({scene.name: scene for scene in scenes}.values())
    return [*doubts(each), *(_unstable(each) if steps else ())]


def _unstable(scenes: Iterable[Scene]) -> Iterator[str]:
    from models.catalog import load_scene, scene_names
    from models.errors import MachineError
    from models.scene.text import scene_text
    from models.stability import step_stability

    bank = set(scene_names())
    for scene in scenes:
        if scene.name in bank and scene_text(load_scene(scene.name)) == scene_text(scene):
            continue
        with contextlib.suppress(MachineError):  # without a compiler: whoever runs it is told
            if sentence := step_stability(scene).sentence:
                yield sentence

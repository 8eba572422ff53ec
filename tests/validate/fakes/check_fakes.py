"""Examinations that pass, fail and misbehave, beside the cells of campaign_fakes.py.

python -m validate all --plugin check_fakes:PLUGIN        # with this folder on PYTHONPATH
"""

import ctypes
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

import campaign_fakes

from models.errors import TouchstoneError
from models.results.verdict import Metric
from models.scene.text import scene_text
from validate.tasks.check import Course, Found
from validate.tasks.task import CheckTask, SceneReference


def _raise() -> None:
    raise ValueError("its own mistake\nwith a second line")


def _refuse() -> None:
    raise TouchstoneError("the check says why it cannot.")


_MISBEHAVIOUR = {
    "segfault": lambda: ctypes.string_at(0),
    "hang": campaign_fakes.hang,
    "raise": _raise,
    "refuse": _refuse,
}


def ask(arguments: Mapping[str, str], course: Course) -> Found:
    """Says what it is told to say, and notes each time in the file named by NOTED that it was asked."""
    with open(os.environ["NOTED"], "a", encoding="utf-8") as file:
        file.write(f"{arguments['says']}\n")
    course.at(f"the question {arguments['says']}")
    _MISBEHAVIOUR.get(arguments["says"], lambda: None)()
    figure = Metric(
        name="patience", value=course.seconds_left, unit="s", meaning="what is left of its time"
    )
    return Found(arguments["says"] == "yes", f"it says {arguments['says']}.", (figure,))


def _offered(scenes: Sequence[SceneReference]) -> list[CheckTask]:
    """For each scene one of each kind of answer; `maybe` is not for quick campaigns.

    And one about no scene.
    """

    def question(says: str, scene: SceneReference | None, *, quick: bool = True) -> CheckTask:
        return CheckTask(
            kind="question", name=f"{says} of {scene.scene.name if scene else 'nothing'}",
            expected="it says yes.",
            function="check_fakes:ask", arguments={"says": says},
            content=scene_text(scene.scene) if scene else "",
            sources=("validate/tasks/check.py",), scene=scene.scene.name if scene else None,
            quick=quick, words=("asked",),
        )  # fmt: skip

    said = ["yes", "no", *_MISBEHAVIOUR]
    about = [question(says, scene) for scene in scenes for says in said]
    return [
        *about,
        *(question("maybe", scene, quick=False) for scene in scenes),
        question("yes", None),
    ]


PLUGIN = replace(campaign_fakes.PLUGIN, checks=_offered)

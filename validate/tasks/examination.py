"""An examination: a task of a campaign that is no run. A function is asked a question, and what it finds is as expected or not.

    Examination(kind="FMU", name="three_cart, FMI 2.0", expected="...", function="validate.tasks.fmu_examination:examine",
                arguments={"scene": "three_cart", "version": "2.0"}, ...)

Examinations are selected, keyed by content, run in a child with the campaign's time limit, stored, resumed and reported like a run. A room
that has some offers a function `examinations(scenes)` (see validate/tasks/plugins.py, EXAMINATIONS); the campaign does the rest. The function that examines is called in
the child as function(arguments, course) and hands back what it found.
"""

from __future__ import annotations

import importlib
import os
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from models.errors import MachineError, TouchstoneError
from models.scene import Scene
from reports.records.check_record import ExaminationRecord
from reports.records.record import MetricRecord, ProvenanceRecord
from validate.store.disk import raise_if_disk_ended
from validate.store.store import LOG, PROGRESS
from validate.tasks.run import ChildExit
from validate.tasks.variant import Variant

# Of an examination's time limit, what is reserved for writing down what was found: a twentieth, but no more than 5 s.
_WRITING_SHARE, _WRITING_MOST = 0.05, 5.0
# Lines of the log that go into the record.
_LOG_LINES = 40


@dataclass(frozen=True)
class SceneReference:
    """A scene of the campaign, what load_scene takes to find it again in a child, and what a campaign file changed of it (done in `scene`)."""

    where: str
    scene: Scene
    variant: Variant | None = None


@dataclass(frozen=True, kw_only=True)
class Examination:
    """What is to be examined.

    function: `module:name`, called in the child with the arguments (JSON data); content: text that decides the result beside arguments and
    sources, such as that of a scene (models.scene.text); sources: the parts of our sources that matter, as beginnings of
    paths (nothing: all of them); methods: names of the methods it runs; scene: the name of the one it is about; quick: whether `--quick` runs it;
    words: further names for `-k`; group: what it and its like are called where only their number is said; key and time_limit [s]: filled in by the campaign.
    """

    kind: str
    name: str
    expected: str
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    content: str = ""
    sources: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    scene: str | None = None
    quick: bool = True
    words: tuple[str, ...] = ()
    group: str = ""
    key: str = ""
    time_limit: float = 0.0

    @property
    def title(self) -> str:
        """What it is called."""
        return f"{self.kind}: {self.name}"

    @property
    def names(self) -> tuple[str, ...]:
        """What `-k` looks at."""
        return (self.kind, self.name, *self.words, *([self.scene] if self.scene else []))

    def to_json(self) -> dict[str, Any]:
        """Everything that run_examination and a resumed campaign need."""
        return {"examination": True, **asdict(self)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Examination:
        """The examination that `to_json` wrote."""
        tuples = {name: tuple(data[name]) for name in ("sources", "methods", "words")}
        return cls(**{**{name: value for name, value in data.items() if name != "examination"}, **tuples})


@dataclass(frozen=True)
class Found:
    """What an examination found: whether it is as expected, in one sentence, with figures. details: further fields of the record."""

    passed: bool
    sentence: str
    figures: tuple[MetricRecord, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Course:
    """What an examination is given beside its arguments. folder: for scratch files; deadline: time.monotonic() by which it should be done."""

    folder: Path
    deadline: float

    def at(self, text: str) -> None:
        """Say where we are, for the parent to read if we never come back."""
        (self.folder / PROGRESS).write_text(text, encoding="utf-8")

    @property
    def seconds_left(self) -> float:
        """Until the deadline [s]."""
        return max(0.0, self.deadline - time.monotonic())


def run_examination(examination: Examination, provenance: ProvenanceRecord, folder: Path, began: float) -> ExaminationRecord:
    """Examine, in the child. began: time.monotonic() at its start. Raises MachineError; whatever else goes wrong is in the record."""
    reserve = min(_WRITING_MOST, _WRITING_SHARE * examination.time_limit)
    course = Course(folder, began + examination.time_limit - reserve)
    module, _, name = examination.function.partition(":")
    found, outcome, message = Found(False, ""), "answered", ""
    try:
        function: Callable[[Mapping[str, Any], Course], Found] = getattr(importlib.import_module(module), name)
        found = function(examination.arguments, course)
    except MachineError:
        raise
    except TouchstoneError as error:
        raise_if_disk_ended(folder, error)
        traceback.print_exc()
        outcome, message = "failed", str(error)
    except Exception as error:  # noqa: BLE001 - an examination may fail in any way; the log has the traceback, the row has the sentence
        raise_if_disk_ended(folder, error)
        traceback.print_exc()
        outcome, message = "crashed", f"{type(error).__name__}: {next(iter(str(error).splitlines()), '') or 'no further words.'}"
    log = folder / LOG
    text = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
    used = os.times()
    cpu = used.user + used.system + used.children_user + used.children_system
    return _record(examination, provenance, found, outcome, message, time.monotonic() - began, cpu, text)


def unfinished_examination(examination: Examination, provenance: ProvenanceRecord, child: ChildExit) -> ExaminationRecord:
    """The record of an examination whose child left none."""
    return _record(examination, provenance, Found(False, ""), child.outcome, child.message, child.wall, child.cpu, child.log)


def _record(
    examination: Examination, provenance: ProvenanceRecord, found: Found, outcome: str, message: str, wall: float, cpu: float, log: str
) -> ExaminationRecord:
    return ExaminationRecord(
        key=examination.key,
        kind=examination.kind,
        name=examination.name,
        expected=examination.expected,
        scene=examination.scene,
        outcome=outcome,
        passed=found.passed,
        found=found.sentence,
        message=message,
        figures=found.figures,
        wall_seconds=wall,
        cpu_seconds=cpu,
        provenance=provenance,
        log_tail="\n".join(log.splitlines()[-_LOG_LINES:]),
        **found.details,
    )


Offers = Callable[[Sequence[SceneReference]], Sequence[Examination]]

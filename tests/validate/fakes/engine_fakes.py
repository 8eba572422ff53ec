"""A method that takes the worker of its cell with it, and one that does nothing, for tests of engines that lose their workers.

COUNTS names a folder; each run of a method leaves a file in it. `fatal` kills the process that its cell was started by, as often as KILLS says.
"""

import os
import signal
import time
import uuid
from dataclasses import replace
from pathlib import Path

from begun_by import begun_by
from campaign_fakes import PLUGIN, FakeMethod

from formulations.method import Leg, Pipeline


def _counted(name: str) -> int:
    """How often the method has run by now."""
    folder = Path(os.environ["COUNTS"])
    (folder / f"{name}-{uuid.uuid4().hex}").touch()
    return len(list(folder.glob(f"{name}-*")))


def _fatal() -> None:
    if _counted("fatal") <= int(os.environ["KILLS"]):
        os.kill(begun_by(), signal.SIGKILL)
        time.sleep(1000)  # we die with it


def _calm() -> None:
    _counted("calm")


METHODS = {method.name: method for method in (FakeMethod("fatal", _fatal), FakeMethod("calm", _calm))}
PIPELINES = tuple(Pipeline(name=name, title=f"only {name}", legs=(Leg(method=name),)) for name in METHODS)
LOSING = replace(PLUGIN, load_method=METHODS.__getitem__, pipelines_for=lambda scene: PIPELINES)

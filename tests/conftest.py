"""Hypothesis tries the same examples in every run and keeps none: what passes here passes again.

New ones: `pytest --hypothesis-profile=default`.
"""

import os

import pytest
from hypothesis import settings

from validate.processes.process import usable_cores

settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.load_profile("repeatable")

# How wide the terminal is in which the tests run decides no test: what they read goes through
# pipes. A test of widths sets its own.
os.environ.pop("COLUMNS", None)

# What a test asks for says what it is: a command line is processes, Chromium is a browser. The
# others are marked where they stand.
_MARKS = {"cli": "process", "start_cli": "process", "chromium": "browser"}


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One process more than cores for `-n auto`: tests wait for processes, and two of them leave an eighth of two cores idle."""
    return usable_cores() + 1


def pytest_collection_modifyitems(items: list[pytest.Function]):
    for item in items:
        for fixture in _MARKS.keys() & set(item.fixturenames):
            item.add_marker(_MARKS[fixture])

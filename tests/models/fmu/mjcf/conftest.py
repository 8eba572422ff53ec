"""Robots of MuJoCo from texts."""

import pytest

from models.fmu.mjcf import read_robot


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """robot(text, *contacts, keyframe=..) reads a robot from a text.

    One text has one name, and with that its FMUs are built once.
    """
    pytest.importorskip("mujoco")
    folder, names = tmp_path_factory.mktemp("robots"), {}

    def made(text: str, *contacts: str, keyframe: str | None = None, suffix: str = ".xml"):
        path = folder / f"robot{names.setdefault(text, len(names))}{suffix}"
        path.write_text(text, encoding="utf-8")
        return read_robot(path, contacts, keyframe)

    return made

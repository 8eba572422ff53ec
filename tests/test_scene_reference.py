"""docs/scene_reference.md is what the code says, has every field, and its examples run."""

import importlib.util
import inspect
import re
from dataclasses import fields
from pathlib import Path

import pytest
import sympy as sp

import models.scene
from models.scene import Scene
from models.scene.checks import check_expressions
from models.scene.functions import FUNCTIONS, ROUNDED

SOURCE = Path(__file__).parents[1] / "docs/site/scene_reference.py"
spec = importlib.util.spec_from_file_location("scene_reference", SOURCE)
assert spec is not None
assert spec.loader is not None
reference = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reference)


def test_page_is_up_to_date():
    assert reference.PAGE.read_text(encoding="utf-8") == reference.page(), (
        "run python docs/site/scene_reference.py"
    )


@pytest.mark.parametrize("name", reference.CLASSES)
def test_every_field_has_a_meaning_and_nothing_else_has(name: str):
    kind = getattr(models.scene, name)
    said = reference.meanings(kind)
    assert list(said) == [field.name for field in fields(kind)]
    assert all(meaning.endswith(".") for meaning in said.values()), said


def test_every_class_of_the_package_has_its_table():
    public = {name for name in models.scene.__all__ if inspect.isclass(getattr(models.scene, name))}
    assert public - set(reference.CLASSES) == {"DampingLaw"}


def test_examples_run_and_are_scenes_that_can_be_planned():
    space: dict = {}
    for block in re.findall(r"```python\n(.*?)```", reference.page(), re.DOTALL):
        exec(compile(block, "docs/scene_reference.md", "exec"), space)
    scenes = [value for value in space.values() if isinstance(value, Scene)]
    assert len(scenes) == 8
    for scene in scenes:
        check_expressions(scene)
    assert not space["free"].task.has_goal
    assert space["damped"].damped == (0, 1)
    assert [item.pressing for item in space["rough"].frictions] == [(), ("wall", "rear")]


def test_functions_are_those_that_a_scene_may_use():
    page = reference.page()
    for function in (*FUNCTIONS, *ROUNDED, sp.sqrt):
        assert f"`{function.__name__}`" in page

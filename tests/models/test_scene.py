"""A scene checks itself when it is created: each mistake is one sentence that names the scene and the field."""

from dataclasses import replace

import pytest
import sympy as sp

from models.catalog import load_scene, scene_names
from models.errors import SceneError, UnknownNameError
from models.scene import Contact, Coordinate, Input, Parameter, Scene, Task
from models.units import base_exponents

x, vx, u = sp.symbols("x vx u", real=True)
m, k = sp.symbols("m k", positive=True)


def small_scene(**changes: object) -> Scene:
    fields: dict = {
        "name": "small",
        "title": "a mass before a wall",
        "source": "this test",
        "coordinates": (Coordinate(symbol=x, velocity=vx, unit="m"),),
        "inputs": (Input(symbol=u, unit="N"),),
        "parameters": (Parameter(symbol=m, value=1.0, unit="kg"), Parameter(symbol=k, value=10.0, unit="N/m")),
        "kinetic_energy": m * vx**2 / 2,
        "potential_energy": sp.Integer(0),
        "forces": (u,),
        "contacts": (Contact(name="wall", penetration=x - 1, stiffness=k),),
        "task": Task(start=(0.0, 0.0), goal=(0.5, 0.0), running_cost=u**2, step=0.01, steps=10),
    }
    return Scene(**(fields | changes))


def test_a_sound_scene_is_accepted():
    scene = small_scene()
    assert (scene.nq, scene.nu, scene.nc) == (1, 1, 1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"task": Task(start=(0.0,), goal=(0.5, 0.0), running_cost=u**2, step=0.01, steps=10)},
            ["task.start", "1 numbers", "2 are needed"],
        ),
        ({"forces": (u - sp.Symbol("c") * vx,)}, ["forces[x]", "uses c", "parameter"]),
        ({"forces": (u - sp.Symbol("k") * vx,)}, ["forces[x]", "other assumptions"]),
        ({"forces": (u, u)}, ["forces", "2 entries", "1 coordinates"]),
        (
            {"parameters": (Parameter(symbol=m, value=-1.0, unit="kg"), Parameter(symbol=k, value=1.0, unit="N/m"))},
            ["not positive definite"],
        ),
        ({"parameters": (Parameter(symbol=m, value=1.0, unit="kg"), Parameter(symbol=k, value=-1.0, unit="N/m"))}, ["wall", "stiffness"]),
        ({"kinetic_energy": m * vx}, ["kinetic_energy", "quadratic"]),
        ({"contacts": (Contact(name="wall", penetration=sp.sqrt(x), stiffness=k),)}, ["wall", "not differentiable at the start"]),
        ({"contacts": (Contact(name="wall", penetration=sp.Integer(1) * m, stiffness=k),)}, ["wall", "no coordinate"]),
        ({"contacts": (Contact(name="a", penetration=x, stiffness=k),) * 2}, ["lam_a", "2 times"]),
        ({"inputs": (Input(symbol=m, unit="N"),)}, ["'m'", "2 times"]),
        ({"coordinates": ()}, ["no coordinates"]),
        ({"name": "two words"}, ["two words", "identifier"]),
        ({"forces": u}, ["forces", "tuple"]),
    ],
)
def test_a_mistake_is_one_sentence(changes: dict, words: list[str]):
    with pytest.raises(SceneError) as caught:
        small_scene(**changes)
    text = str(caught.value)
    assert "\n" not in text
    assert all(word in text for word in words), text


@pytest.mark.parametrize("unit", ["", None, "newton", "N/", "m^x"])
def test_a_bad_unit_is_refused(unit: object):
    with pytest.raises(SceneError, match="unit"):
        Parameter(symbol=m, value=1.0, unit=unit)  # pyright: ignore[reportArgumentType] - the mistake under test


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "1"])
def test_a_parameter_is_a_finite_number(value: object):
    with pytest.raises(SceneError, match="finite"):
        Parameter(symbol=m, value=value, unit="kg")  # pyright: ignore[reportArgumentType] - the mistake under test


@pytest.mark.parametrize(
    ("changes", "word"), [({"step": 0.0}, "step"), ({"step": float("nan")}, "step"), ({"steps": 0}, "steps"), ({"steps": 2.5}, "steps")]
)
def test_a_task_needs_a_grid(changes: dict, word: str):
    with pytest.raises(SceneError, match=word):
        replace(small_scene().task, **changes)


def test_units_reduce_to_base_units():
    assert base_exponents("N s/m") == {"kg": 1, "s": -1}
    assert base_exponents("J") == {"kg": 1, "m": 2, "s": -2}
    assert base_exponents("m/s^2") == {"m": 1, "s": -2}
    assert base_exponents("1") == {}


def test_other_parameter_values():
    assert small_scene().with_parameters(k=300.0).parameter_values[k] == 300.0
    with pytest.raises(SceneError, match="no parameter 'kk'"):
        small_scene().with_parameters(kk=1.0)


def test_the_catalog_names_what_there_is():
    assert "three_cart" in scene_names()
    with pytest.raises(UnknownNameError, match="did you mean three_cart"):
        load_scene("three_carts")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "must define SCENE"),
        ("SCENE = 3", "found int"),
        ("1/0", "ZeroDivisionError"),
        ("def (", "SyntaxError"),
        ("from models.scenes.three_cart import SCENE", "must equal the file's name"),
        (
            "import sympy as sp\nfrom models.scene import Parameter\nParameter(symbol=sp.Symbol('m'), value=1.0)",
            "unit",
        ),
    ],
)
def test_a_broken_scene_file_is_named(tmp_path, text: str, words: str):
    path = tmp_path / "own.py"
    path.write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(str(path))
    assert str(path) in str(caught.value)
    assert words in str(caught.value)


def test_a_missing_scene_file_is_named():
    with pytest.raises(SceneError, match=r"nowhere\.py"):
        load_scene("nowhere.py")

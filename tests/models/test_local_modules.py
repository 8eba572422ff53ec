"""Modules beside a scene's file: found from everywhere, read afresh, and their content decides the keys wherever the scene's expressions do not show it."""

import gc
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from models.catalog import load_scene
from models.codegen.emit import emit_model
from models.codegen.text_cache import cached_text
from models.errors import SceneError
from models.loading import declared
from models.scene import Scene
from models.scene.text import equations_text, scene_text

SCENES = Path(__file__).parents[1] / "scenes"
# A function of somebody's own: SymPy writes its name alone.
SPRINGS = """
import sympy as sp
from {package}numbers_ import HARD

class Spring(sp.Function):
    def fdiff(self, argindex=1):
        return HARD * sp.cos(self.args[0])

    def _ccode(self, printer):
        return f"({{HARD}} * sin({{printer._print(self.args[0])}}))"
"""


def write(folder: Path, hard: float = 2.0, package: str = "") -> Path:
    """A scene file whose force is a function of a module beside it, which imports a number from a second module."""
    (folder / package).mkdir(parents=True, exist_ok=True)
    dots = "." if package else ""
    (folder / package / "springs_.py").write_text(SPRINGS.format(package=dots))
    (folder / package / "numbers_.py").write_text(f"HARD = {hard!r}\n")
    text = (SCENES / "oscillator.py").read_text()
    assert "forces=(sp.Integer(0),)" in text
    module = f"{package}.springs_" if package else "springs_"
    path = folder / "oscillator.py"
    path.write_text(
        text.replace("forces=(sp.Integer(0),)", "forces=(-Spring(q),)").replace(
            "SCENE =", f"from {module} import Spring\nSCENE ="
        )
    )
    return path


@pytest.mark.slow
@pytest.mark.parametrize("package", ["", "parts_"])
def test_a_module_beside_the_file_is_found_wherever_one_is_and_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
):
    monkeypatch.chdir("/")
    path = write(tmp_path, package=package)
    before = (list(sys.path), list(sys.meta_path))
    scene = load_scene(str(path))
    assert sp.diff(-scene.forces[0], scene.coordinates[0].symbol) == 2.0 * sp.cos(
        scene.coordinates[0].symbol
    )
    assert not {"springs_", "numbers_", "parts_", "parts_.springs_"} & sys.modules.keys()
    assert (sys.path, sys.meta_path) == before
    assert not list(tmp_path.rglob("*.pyc"))


@pytest.mark.slow
@given(st.lists(st.sampled_from([1.0, 2.0, 3.0]), min_size=2, max_size=4))
@settings(
    max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
def test_equal_sources_equal_text_others_another(tmp_path: Path, numbers: list[float]):
    """The files are written again within a second, to the same length."""
    scenes = [load_scene(str(write(tmp_path, number))) for number in numbers]
    for text in (scene_text, equations_text):
        assert (
            len(set(zip(numbers, map(text, scenes), strict=True)))
            == len({text(scene) for scene in scenes})
            == len(set(numbers))
        )


def test_two_folders_have_a_module_of_one_name(tmp_path: Path):
    scenes = [
        load_scene(str(write(tmp_path / name, hard))) for name, hard in (("one", 1.0), ("two", 5.0))
    ]
    slopes = [
        sp.diff(-scene.forces[0], scene.coordinates[0].symbol).subs(scene.coordinates[0].symbol, 0)
        for scene in scenes
    ]
    assert slopes == [1.0, 5.0]


def test_a_changed_scene_keeps_what_its_functions_are_from(tmp_path: Path):
    scenes = [load_scene(str(write(tmp_path, hard))).with_task(steps=7) for hard in (1.0, 2.0)]
    assert scene_text(scenes[0]) != scene_text(scenes[1])


def test_generated_code_is_that_of_the_changed_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path / "cache"))

    def code(scene: Scene) -> str:
        return cached_text(scene, "probe.h", lambda: emit_model(scene))

    for hard in (1.5, 2.5):
        assert f"{hard} * sin(" in code(load_scene(str(write(tmp_path, hard))))


def test_scenes_of_sympy_alone_have_no_more_in_their_text(tmp_path: Path):
    """A remark in the file changes no key."""
    path = tmp_path / "oscillator.py"
    texts = []
    for remark in ("", "# remark\n"):
        path.write_text(remark + (SCENES / "oscillator.py").read_text())
        texts.append(scene_text(load_scene(str(path))))
    assert texts[0] == texts[1]


def test_a_function_that_nobody_defines_is_refused_in_words(tmp_path: Path):
    path = tmp_path / "oscillator.py"
    path.write_text(
        (SCENES / "oscillator.py")
        .read_text()
        .replace("forces=(sp.Integer(0),)", 'forces=(sp.Function("f")(q),)')
    )
    with pytest.raises(SceneError, match=r"contains f\(.*, which a scene cannot use"):
        load_scene(str(path))


def test_a_scene_that_loads_itself_says_so(tmp_path: Path):
    for name, other in (("one", "two"), ("two", "one")):
        (tmp_path / f"{name}.py").write_text(
            f"from models.catalog import load_scene\nSCENE = load_scene({str(tmp_path / other)!r} + '.py')\n"
        )
    with pytest.raises(SceneError, match=r"it loads itself \(one.py -> two.py -> one.py\)"):
        load_scene(str(tmp_path / "one.py"))
    assert load_scene("three_cart").name == "three_cart"


@dataclass(frozen=True)
class Said:
    """What a file declares of itself."""

    words: tuple[tuple[str, int], ...]


def test_threads_may_ask_at_once_what_files_declare(tmp_path: Path):
    """Before Python 3.11.8 the parser loses count of depth where another thread gets its turn in a collection of garbage, and parses too."""
    words = {
        name: tuple((f"{name}{number}", number) for number in range(size))
        for name, size in (("one", 30), ("two", 100))
    }
    for name in words:
        (tmp_path / f"{name}.py").write_text(
            f"\nSAID = Said(words={words[name]!r})\n", encoding="utf-8"
        )

    def give_way(phase: str, info: dict[str, int]) -> None:
        time.sleep(1e-4)

    usual = gc.get_threshold()
    gc.callbacks.append(give_way)
    gc.set_threshold(5)
    try:
        with ThreadPoolExecutor(8) as pool:
            said = list(
                pool.map(
                    lambda name: declared(tmp_path / f"{name}.py", "SAID", Said).words,
                    [*words] * 400,
                )
            )
    finally:
        gc.set_threshold(*usual)
        gc.callbacks.remove(give_way)
    assert said == [*words.values()] * 400

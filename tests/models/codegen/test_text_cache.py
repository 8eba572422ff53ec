"""Generated text that is kept: the same as anew, found again for equal equations, made anew for anything else."""

from dataclasses import replace

import pytest
import sympy as sp

from models.catalog import load_scene
from models.codegen import text_cache
from models.codegen.emit import emit_model, model_source
from models.codegen.text_cache import cached_text
from models.fmu import description as experiment
from models.fmu.reference import true_motion
from models.fmu.sensitivity import emit_sensitivity, sensitivity_source
from models.scene import Scene


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["three_cart", "transport", "cart_pole_walls", "damped_collision", "bouncing_mass"])
def test_cached_text_equals_emitted_text(name: str):
    scene = load_scene(name)
    for source, emit in ((model_source, lambda scene: emit_model(scene, defaults=False)), (sensitivity_source, emit_sensitivity)):
        anew = emit(scene)
        assert source(scene) == anew
        assert source(scene) == anew, "read back"


def asked(scene: Scene) -> bool:
    """Whether the text had to be made."""
    made = []
    cached_text(scene, "probe", lambda: made.append(1) or "text")
    return bool(made)


def test_equal_equations_are_written_once():
    scene = load_scene("three_cart")
    assert asked(scene)
    assert not asked(scene)
    assert not asked(scene.with_parameters(k=77.0)), "values are no part of the equations"
    assert not asked(scene.with_task(steps=7)), "nor is the task"


def test_the_motion_in_an_fmu_is_integrated_once(monkeypatch):
    """For every version and platform; again for other values and another task. What is read back is what was computed."""
    integrated = []

    def counted(*arguments):
        integrated.append(arguments[0].scene)
        return true_motion(*arguments)

    monkeypatch.setattr(experiment, "true_motion", counted)
    scene = load_scene("three_cart").with_task(steps=4)
    first = experiment.experiment_texts(scene)
    assert experiment.experiment_texts(scene) == first
    assert len(integrated) == 1
    others = [scene.with_parameters(k=77.0), scene.with_task(steps=5)]
    assert all(experiment.experiment_texts(other) for other in others)
    assert integrated == [scene, *others]


@pytest.mark.parametrize(
    "change",
    [
        lambda scene: replace(scene, potential_energy=scene.potential_energy + sp.Symbol("q1", real=True)),
        lambda scene: replace(scene, forces=(-scene.forces[0], *scene.forces[1:])), lambda scene: replace(scene, contacts=scene.contacts[::-1]),
        lambda scene: replace(scene, contacts=(replace(scene.contacts[0], nominal=0.5), *scene.contacts[1:])),
        lambda scene: scene.with_task(running_cost=2 * scene.task.running_cost), lambda scene: replace(scene, name="other"),
    ],
)  # fmt: skip
def test_other_equations_are_written_anew(change):
    scene = load_scene("three_cart")
    asked(scene)
    assert asked(change(scene))


def test_every_pattern_of_generators_finds_files():
    for pattern in (*text_cache._GENERATORS, *text_cache._COMPUTED, *text_cache._ALL):
        assert list(text_cache._MODELS.glob(pattern)), pattern


def test_other_generators_write_anew(monkeypatch):
    scene = load_scene("three_cart")
    asked(scene)
    monkeypatch.setattr(text_cache, "_generators", lambda: "another version of the code")
    assert asked(scene)

"""The model structure of an FMU, kept between processes: what is read back is what the equations say."""

from __future__ import annotations

import pytest

from models.catalog import load_scene
from models.fmu import structure
from models.fmu.structure import dependencies, derived_dependencies


@pytest.mark.parametrize("name", ["three_cart", "cart_pole_walls", "transport", "damped_collision"])
def test_what_is_kept_is_what_is_derived_in_the_same_order(name, monkeypatch):
    scene = load_scene(name)
    derived = derived_dependencies(scene)
    assert derived, "a scene has states"
    first = dependencies(scene)
    monkeypatch.setattr(structure, "derived_dependencies", lambda _scene: pytest.fail("kept already"))
    for found in (first, dependencies(scene)):
        assert found == derived
        assert [(known, list(knowns)) for known, knowns in found.items()] == [(known, list(knowns)) for known, knowns in derived.items()]


def test_another_equation_is_another_structure():
    """The key is of the equations: a scene that differs there never reads the other's."""
    with_walls, without = load_scene("cart_pole_walls"), load_scene("wall_pendulum")
    assert dependencies(with_walls) != dependencies(without)

"""The model structure of an FMU, kept between processes: what is read back is what the equations say."""

import pytest
import sympy as sp

from models.catalog import load_scene
from models.fmu import structure
from models.fmu.structure import Dependency, dependencies, derived_dependencies


@pytest.mark.parametrize("name", ["three_cart", "cart_pole_walls", "transport", "damped_collision"])
def test_cached_structure_equals_derived_structure(name, monkeypatch):
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


@pytest.mark.parametrize("name", ["three_cart", "acrobot_limits", "two_discs", "two_finger"])
def test_dependence_at_two_points_equals_expansion(name, monkeypatch):
    scene = load_scene(name)
    found = derived_dependencies(scene)
    assert Dependency.DEPENDENT in {kind for knowns in found.values() for kind in knowns.values()}
    monkeypatch.setattr(structure, "_seen_to_vary", lambda *_: set())
    assert found == derived_dependencies(scene)


def test_cancelling_terms_are_not_dependencies():
    x, y, m = sp.symbols("x y m")
    slopes = {x: (1 + y) * m - y * m, y: sp.sin(x) ** 2 + sp.cos(x) ** 2 + m, m: x * y, sp.Symbol("f"): sp.Function("unknown")(x)}
    assert structure._seen_to_vary(slopes, {m}) == set(), "a function that Python has not: nothing is said of any"
    slopes.popitem()
    assert structure._seen_to_vary(slopes, {m}) == {m}


def test_a_power_that_is_complex_at_a_point_is_not_seen_to_vary():
    """(x - 5)^(3/2) is real for some x, but at neither of the points."""
    x, y = sp.symbols("x y", real=True)
    assert structure._seen_to_vary({x: (x - 5) ** sp.Rational(3, 2), y: x * y}, set()) == {y}

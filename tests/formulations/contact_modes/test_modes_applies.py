"""Which scenes mpcc accepts is said without deriving anything."""

from dataclasses import replace

import pytest
import sympy as sp

from formulations.pipelines import load_method
from models import dynamics
from models.catalog import load_scene

SCENE = load_scene("hopper")


@pytest.mark.parametrize("method", ["mpcc", "mpcc_front"])
def test_nothing_is_derived_to_say_so(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def derived(_scene: object) -> None:
        raise AssertionError("a scene was derived")

    monkeypatch.setattr(dynamics, "_build", derived)
    assert load_method(method).accepts(replace(SCENE)) is None


@pytest.mark.parametrize("field", ["potential_energy", "kinetic_energy"])
def test_a_function_that_pyomo_does_not_have_is_named(field: str) -> None:
    bent = replace(SCENE, **{field: getattr(SCENE, field) * (2 + sp.erf(SCENE.coordinates[0].symbol))})
    reason = load_method("mpcc").accepts(bent)
    assert f"{field} contains erf(" in reason

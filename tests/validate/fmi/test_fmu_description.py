"""Numbers and units of a description, as every room reads them."""

from types import SimpleNamespace
from typing import Any

import pytest

from validate.fmi.description import experiment
from validate.fmi.units import Unit, defined_units


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("tolerance", "1e-6", 1e-6), ("tolerance", "0", None), ("tolerance", "-1e-6", None),
        ("tolerance", "tight", None), ("stepSize", "inf", None), ("stepSize", None, None),
        ("startTime", "-2", -2.0), ("startTime", "0", 0.0), ("stopTime", "nan", None),
    ],
)  # fmt: skip
def test_experiment_number_usable_or_none(name: str, text: str | None, value: float | None):
    description = SimpleNamespace(defaultExperiment=SimpleNamespace(**{name: text}))
    assert experiment(description, name) == value
    assert experiment(SimpleNamespace(defaultExperiment=None), name) is None


def _units(**definitions: dict[str, Any] | None) -> dict[str, Unit]:
    powers = dict.fromkeys(("kg", "m", "s", "A", "K", "mol", "cd", "rad"), 0)
    plain = {**powers, "factor": 1.0, "offset": 0.0}
    units = [
        SimpleNamespace(name=name, baseUnit=base and SimpleNamespace(**{**plain, **base}))
        for name, base in definitions.items()
    ]
    return defined_units(SimpleNamespace(unitDefinitions=units))


def test_unit_per_second_by_definition():
    units = _units(
        km={"m": 1, "factor": 1e3}, kmh={"m": 1, "s": -1, "factor": 1e3 / 3600.0},
        mps={"m": 1, "s": -1}, degC={"K": 1, "offset": 273.15}, heating={"K": 1, "s": -1},
        turn={"rad": 1}, number={"rad": 0}, unknown=None,
    )  # fmt: skip
    assert "unknown" not in units
    assert units["degC"].per_second().is_same(units["heating"])
    assert not units["km"].per_second().is_same(units["mps"]), "a factor"
    assert not units["km"].per_second().is_same(units["kmh"]), "an hour"
    assert units["turn"].is_same(units["number"]), "an angle is a number"
    assert Unit({"m": 1}, 0.3048).is_same(Unit({"m": 1}, 0.30480000001)), (
        "written with fewer digits"
    )

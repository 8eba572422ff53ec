"""The FMU file: valid, reproducible, complete; and what a user does wrong is said in one sentence."""

import dataclasses
import zipfile

import fmpy
import pytest
import sympy as sp
from fmpy.validation import validate_fmu

from models.errors import SceneError, TouchstoneError, UnknownNameError
from models.fmu import build_fmu, variable_names
from models.fmu.description import render
from models.scene import Parameter
from models.scene.values import base_exponents


@pytest.mark.slow
def test_another_scene_or_date_is_another_fmu(scene_of, monkeypatch, tmp_path):
    scene = scene_of("bouncing_mass")
    guid = fmpy.read_model_description(str(build_fmu(scene))).guid
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    other = fmpy.read_model_description(str(build_fmu(scene.with_parameters(k=2000.0))))
    assert other.guid != guid
    assert next(variable.start for variable in other.modelVariables if variable.name == "k") == "2000.0"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    dated = build_fmu(scene)
    assert fmpy.read_model_description(str(dated)).generationDateAndTime == "2023-11-14T22:13:20Z"
    with zipfile.ZipFile(dated) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(2023, 11, 14, 22, 13, 20)}


def test_description_says_what_an_importer_needs(any_scene):
    description = fmpy.read_model_description(str(build_fmu(any_scene)))
    names = variable_names(any_scene)
    by_name = {variable.name: variable for variable in description.modelVariables}
    for part in (description.coSimulation, description.modelExchange):
        assert part.canGetAndSetFMUstate
        assert part.canSerializeFMUstate
        assert part.providesDirectionalDerivative
    assert description.coSimulation.canInterpolateInputs
    assert description.coSimulation.canHandleVariableCommunicationStepSize
    assert float(description.defaultExperiment.stepSize) == any_scene.task.step
    assert float(description.defaultExperiment.stopTime) == any_scene.task.horizon
    assert float(description.defaultExperiment.tolerance) > 0
    assert all(variable.unit for variable in description.modelVariables if variable.name != "integrator")
    for unit in description.unitDefinitions:
        found = {base: getattr(unit.baseUnit, base) for base in ("kg", "m", "s", "rad")}
        assert {base: exponent for base, exponent in found.items() if exponent} == base_exponents(unit.name)
    assert [by_name[name].causality for name in (*names.q, *names.v)] == ["output"] * (2 * any_scene.nq)
    assert [by_name[name].derivative.name for name in (*names.der_q, *names.der_v)] == [*names.q, *names.v]
    assert float(by_name["internal_step"].start) == any_scene.task.step / 100


def test_fmu_has_only_variables_of_the_scene(scene_of):
    bare = variable_names(scene_of("oscillator"))
    assert (bare.u, bare.lam, bare.gap, bare.parameters) == ((), (), (), ())
    assert (bare.contact_energy, bare.input_power, bare.dissipated_power) == (None, None, None)
    assert bare.potential_energy == "potential_energy"
    count = len(fmpy.read_model_description(str(build_fmu(scene_of("oscillator")))).modelVariables)
    assert count == 9  # time, q, v, der(q), der(v), two energies, internal_step, integrator
    carts = variable_names(scene_of("three_cart"))
    assert carts.potential_energy is None
    assert carts.lam == ("lam_left", "lam_right")
    assert carts.gap == ("gap_left", "gap_right")


def test_templates_are_strict():
    with pytest.raises(Exception, match="undefined"):
        render("licenses.txt.j2")


@pytest.mark.slow
def test_texts_are_escaped(scene_of, tmp_path, monkeypatch):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    scene = dataclasses.replace(scene_of("oscillator"), title='a < b & "c"')
    path = str(build_fmu(scene))
    assert validate_fmu(path) == []
    assert fmpy.read_model_description(path).description == scene.title


def test_unknown_version_is_refused(scene_of):
    with pytest.raises(UnknownNameError, match=r"FMI version '1\.0' is not offered; choose 2\.0"):
        build_fmu(scene_of("three_cart"), version="1.0")


def test_names_an_fmu_cannot_carry_are_refused(scene_of):
    scene = scene_of("oscillator")
    taken = Parameter(symbol=sp.Symbol("kinetic_energy"), value=1.0, unit="1")
    with pytest.raises(SceneError, match=r"'kinetic_energy' is also.*every FMU has"):
        build_fmu(dataclasses.replace(scene, parameters=(taken,)))
    with pytest.raises(SceneError, match="ASCII"):
        dataclasses.replace(scene, name="schwingerä")  # at once: a plan without an FMU is judged by nobody


@pytest.mark.parametrize("epoch", ["yesterday", "-5", "12"])
def test_bad_date_is_refused(scene_of, monkeypatch, epoch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", epoch)
    with pytest.raises(TouchstoneError, match="SOURCE_DATE_EPOCH"):
        build_fmu(scene_of("three_cart"))

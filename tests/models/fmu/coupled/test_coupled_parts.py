"""A scene split into bodies and contacts: the parts add up to the scene, and their FMUs are as good as any."""

import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
import sympy as sp
from c_programs import run, sanitizers
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu
from lxml import etree
from wording import unsaid

from models.catalog import load_scene, scene_names
from models.dynamics import derive
from models.errors import SceneError
from models.fmu.coupled import build_part, build_ssp, contact_table, split
from models.scene.contacts import Friction
from validate.cli import group
from validate.fmu_check import check_fmu

SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"


def splittable():
    return [
        name
        for name in scene_names()
        if (scene := load_scene(name)).contacts and not scene.frictions and not scene.damped
    ]


@pytest.mark.parametrize("name", splittable())
def test_parts_add_up_to_the_scene(name):
    """With the contacts' forces put in, M and tau + J' lam of the bodies are those of the scene, and so are the energies' gradients."""
    scene = load_scene(name)
    d, parts = derive(scene), split(scene)
    lam = dict(zip([contact.name for contact in scene.contacts], d.lam, strict=True))
    pushes = {
        sp.Symbol(part.force_name(item), real=True): slope * lam[part.contact.name]
        for part in parts.contacts
        for item, slope in zip(part.coordinates, part.gradient, strict=True)
    }
    row = {symbol: index for index, symbol in enumerate(d.q)}
    seen = []
    for body in parts.bodies:
        own = derive(body)
        rows = [row[symbol] for symbol in own.q]
        seen += rows
        assert (own.mass_matrix - d.mass_matrix.extract(rows, rows)).expand().is_zero_matrix
        force = own.tau.xreplace(pushes) - d.generalised_force.extract(rows, [0])
        assert sp.simplify(force).is_zero_matrix
        others = [index for index in range(scene.nq) if index not in rows]
        assert not rows or not others or d.mass_matrix.extract(rows, others).is_zero_matrix
    assert sorted(seen) == list(range(scene.nq))
    potential = sum(body.potential_energy for body in parts.bodies)
    assert all(
        sp.simplify(sp.diff(potential - scene.potential_energy, symbol)) == 0 for symbol in d.q
    )


def test_three_carts_are_three_bodies_and_two_contacts():
    parts = split(load_scene("three_cart"))
    assert [body.name for body in parts.bodies] == [
        "three_cart_q1",
        "three_cart_q2",
        "three_cart_q3",
    ]
    assert [[item.name for item in body.inputs] for body in parts.bodies] == [
        ["u1", "lam_left_q1"],
        ["lam_left_q2", "lam_right_q2"],
        ["u3", "lam_right_q3"],
    ]
    assert [part.name for part in parts.contacts] == ["three_cart_left", "three_cart_right"]
    assert len(parts.connections) == 12


def test_bodies_that_mass_couples_stay_together():
    (body,) = split(load_scene("cart_pole_walls")).bodies
    assert body.nq == 2


def test_split_refuses_unsplittable_scenes():
    scene = load_scene("three_cart")
    with pytest.raises(SceneError, match=r"no contacts.*nothing to split"):
        split(replace(scene, contacts=()))
    rubbing = Friction(
        name="left",
        slip=scene.coordinates[0].velocity,
        coefficient=sp.Rational(1, 2),
        contact="left",
    )
    with pytest.raises(SceneError, match="friction"):
        split(replace(scene, frictions=(rubbing,)))
    renamed = replace(scene.contacts[0], name="q1")
    with pytest.raises(SceneError, match="would both be called three_cart_q1"):
        split(replace(scene, contacts=(renamed, scene.contacts[1])))


def test_split_damped_contact_is_refused():
    scene = load_scene("two_body_collision")
    damped = replace(scene.contacts[0], damping=sp.Integer(3))
    with pytest.raises(SceneError, match=rf"damped contacts \({damped.name}\)"):
        split(replace(scene, contacts=(damped,)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["three_cart", "two_discs"])
def test_the_system_structure_is_valid_and_complete(name, tmp_path):
    """Against the schema of SSP 1.0.

    Every input is connected once, every connection joins an output to an input of the same unit.
    """
    from fmpy.ssp import ssd

    scene = load_scene(name)
    path = build_ssp(scene)
    ssd.read_ssd(str(path), validate=True)
    with zipfile.ZipFile(path) as archive:
        reduced = etree.fromstring(archive.read("PartsOnly.ssd"))
        ssd.validate_tree(reduced, "SystemStructureDescription.xsd")
        assert all(
            item.get("startElement") and item.get("endElement")
            for item in reduced.iter(f"{SSD}Connection")
        )
        assert len(list(reduced.iter(f"{SSD}Connection"))) == len(split(scene).connections)
        assert archive.namelist()[0] == "SystemStructure.ssd"
        root = ElementTree.fromstring(archive.read("SystemStructure.ssd"))
        resources = {entry for entry in archive.namelist() if entry.startswith("resources/")}

        units = {}
        for component in root.iter(f"{SSD}Component"):
            (tmp_path / "part.fmu").write_bytes(archive.read(component.attrib["source"]))
            described = {
                v.name: v
                for v in fmpy.read_model_description(str(tmp_path / "part.fmu")).modelVariables
            }
            for connector in component.iter(f"{SSD}Connector"):
                variable = described[connector.attrib["name"]]
                assert variable.causality == connector.attrib["kind"]
                units[component.attrib["name"], variable.name] = (variable.causality, variable.unit)
    assert resources == {component.attrib["source"] for component in root.iter(f"{SSD}Component")}
    driven = []
    for item in root.iter(f"{SSD}Connection"):
        start = (item.get("startElement"), item.get("startConnector"))
        end = (item.get("endElement"), item.get("endConnector"))
        if start[0] and end[0]:
            assert units[start][0] == "output"
            assert units[end][0] == "input"
            assert units[start][1] == units[end][1]
        driven.append(end)
    assert len(driven) == len(set(driven))
    assert {key for key, (kind, _) in units.items() if kind == "input"} <= set(driven)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["three_cart", "two_discs"])
def test_a_contact_is_a_sound_fmu(name):
    """FMPy's and our own check; the values of every part are those of the scene."""
    part = split(load_scene(name)).contacts[0]
    path = build_part(part)
    assert validate_fmu(str(path)) == []
    report = check_fmu(path)
    assert report.ok, [row for row in report.rows if row.status.value == "failed"]


@pytest.mark.slow
def test_equal_scenes_give_equal_bytes(tmp_path, monkeypatch):
    scene = load_scene("two_body_collision")
    first = build_ssp(scene).read_bytes()
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    assert build_ssp(scene).read_bytes() == first


@pytest.mark.slow
def test_a_contact_gives_what_the_equations_say(tmp_path):
    """Force, gap, energy, power and the force on each coordinate of two discs in the plane, in contact and apart."""
    scene = load_scene("two_discs")
    part = split(scene).contacts[0]
    names = [variable.name for variable in contact_table(part)]
    path = str(build_part(part))
    guid, folder = fmpy.read_model_description(path).guid, fmpy.extract(path, str(tmp_path))
    fmu = FMU2Slave(guid=guid, unzipDirectory=folder, modelIdentifier=part.name, instanceName="it")
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    values = {item.symbol: item.value for item in part.parameters}
    rng = np.random.default_rng(4)
    depths = []
    for _ in range(20):
        q, v = rng.uniform(-0.3, 0.3, 4), rng.normal(size=4)
        at = values | dict(zip((item.symbol for item in part.coordinates), q, strict=True))
        phi, k = float(part.contact.penetration.subs(at)), float(part.contact.stiffness.subs(at))
        lam = k * max(phi, 0.0)
        push = lam * np.array([float(slope.subs(at)) for slope in part.gradient])
        fmu.setReal(list(range(1, 9)), [*q, *v])
        got = fmu.getReal(list(range(len(names)))[-8:])
        np.testing.assert_allclose(
            got, [lam, -phi, lam * max(phi, 0.0) / 2, push @ v, *push], rtol=1e-12, atol=1e-12
        )
        depths.append(phi)
    fmu.terminate()
    fmu.freeInstance()
    assert min(depths) < 0 < max(depths)


def test_the_command_writes_an_ssp_and_refuses_what_it_would_ignore(tmp_path, capsys):
    target = tmp_path / "pair.ssp"
    assert group.run(["fmu", "two_body_collision", "--coupled", "-o", str(target)]) == 0
    assert target.read_bytes() == build_ssp(load_scene("two_body_collision")).read_bytes()
    assert (
        group.run(["fmu", "two_body_collision", "--coupled", "--fmi", "3", "-o", str(target)]) == 2
    )
    assert not unsaid(
        capsys.readouterr().err, "--coupled writes FMI 2.0 for … leave out --fmi and --platform"
    )


@pytest.mark.slow
def test_the_contact_is_clean_under_sanitizers(tmp_path):
    """Whatever is called."""
    with zipfile.ZipFile(build_part(split(load_scene("two_discs")).contacts[0])) as archive:
        archive.extractall(tmp_path)
    (compiler, flags), driver = sanitizers(tmp_path), Path(__file__).with_name("contact_driver.c")
    more = ["-O1", "-Wpedantic", "-Wshadow", f"-I{tmp_path / 'sources'}"]
    run([compiler, *flags, *more, driver, "-o", tmp_path / "program", "-lm"])
    run([tmp_path / "program"])

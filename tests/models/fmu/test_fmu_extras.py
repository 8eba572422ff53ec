"""What a first-class FMU carries beside its binary: terminals, icon, build description, reference results - in both versions."""

import io
import struct
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import fmpy.validation
import numpy as np
import pytest
from lxml import etree
from wording import unsaid

from models.fmu import build_fmu, reference, variable_names
from models.fmu.description import ACCURACY, FOLDER, STANDARDS, experiment_texts

both = pytest.mark.parametrize("version", STANDARDS)
SCHEMAS = Path(fmpy.__file__).parent / "schema" / "fmi3"
LS = "{http://fmi-standard.org/fmi-ls-manifest}"


def read(scene, version, name):
    with zipfile.ZipFile(build_fmu(scene, version)) as archive:
        return archive.read(name)


def table(data):
    return np.atleast_1d(np.genfromtxt(io.StringIO(data.decode()), delimiter=",", names=True))


@both
@pytest.mark.parametrize(
    ("name", "schema"),
    [
        ("terminalsAndIcons/terminalsAndIcons.xml", "fmi3TerminalsAndIcons.xsd"),
        ("sources/buildDescription.xml", "fmi3BuildDescription.xsd"),
    ],
)
def test_xml_follows_the_schema(any_scene, version, name, schema):
    etree.XMLSchema(etree.parse(SCHEMAS / schema)).assertValid(etree.fromstring(read(any_scene, version, name)))


@both
def test_terminals_name_variables_that_exist(any_scene, version):
    names = variable_names(any_scene)
    root = ElementTree.fromstring(read(any_scene, version, "terminalsAndIcons/terminalsAndIcons.xml"))
    members = [member.get("variableName") for member in root.iter("TerminalMemberVariable")]
    assert sorted(members) == sorted([*names.q, *names.v, *names.lam, *names.gap, *names.u])


@both
def test_icon_is_a_png_of_128_by_128_and_a_drawing(scene_of, version):
    scene = scene_of("three_cart")
    places = ["terminalsAndIcons/icon.png"] + (["model.png"] if version == "2.0" else [])
    for place in places:
        data = read(scene, version, place)
        assert data.startswith(b"\x89PNG\r\n\x1a\n")
        assert struct.unpack(">II", data[16:24]) == (128, 128)
    assert ElementTree.fromstring(read(scene, version, "terminalsAndIcons/icon.svg")).tag.endswith("svg")


@both
def test_reference_results_are_declared(any_scene, version):
    """By the layered standard FMI-LS-REF: its three attributes, and every file that is named is there and the other way round."""
    with zipfile.ZipFile(build_fmu(any_scene, version)) as archive:
        inside = {name.removeprefix(f"{FOLDER}/") for name in archive.namelist() if name.startswith(f"{FOLDER}/")}
        manifest = ElementTree.fromstring(archive.read(f"{FOLDER}/fmi-ls-manifest.xml"))
        experiment = ElementTree.fromstring(archive.read(f"{FOLDER}/validation.exp")).find("Experiment")
        assert "documentation/fmi-ls-ref.html" in archive.namelist()
        assert b"fmi-ls-ref.html" in archive.read("documentation/index.html")
    assert manifest.tag == "fmiReferences"
    assert manifest.get(f"{LS}fmi-ls-name") == "org.fmi-standard.fmi-ls-ref"
    assert manifest.get(f"{LS}fmi-ls-version") == "1.0.0-alpha.1"
    assert manifest.get(f"{LS}fmi-ls-description").startswith("Layered Standard")
    related = {item.get("source"): item.get("role") for item in manifest.findall("Related")}
    assert inside == {"fmi-ls-manifest.xml", *related}
    assert related["validation.exp"] == "experiment/validation"
    assert related["validation_results.csv"] == "result"
    assert experiment.find("References").get("source") == "validation_results.csv"
    assert (experiment.find("Stimuli") is not None) == (any_scene.nu > 0) == ("validation_inputs.csv" in related)
    assert float(experiment.get("stopTime")) <= any_scene.task.horizon * (1 + 1e-12)


@both
def test_stock_importer_meets_the_reference_results(any_scene, version):
    """FMPy's Co-Simulation under the inputs of the file, at every time of the file, in every output."""
    want = table(read(any_scene, version, f"{FOLDER}/validation_results.csv"))
    given = table(read(any_scene, version, f"{FOLDER}/validation_inputs.csv")) if any_scene.nu else None
    interval = want["time"][1] - want["time"][0]
    path = str(build_fmu(any_scene, version))
    got = fmpy.simulate_fmu(path, fmi_type="CoSimulation", input=given, stop_time=want["time"][-1], output_interval=interval)
    last = [np.flatnonzero(np.abs(got["time"] - t) < 1e-9)[0] for t in want["time"]]  # before the inputs change at a knot
    names = variable_names(any_scene)
    scale = max(coordinate.nominal for coordinate in any_scene.coordinates)
    for name in (*names.q, *names.v):
        np.testing.assert_allclose(got[name][last], want[name], rtol=0, atol=ACCURACY * scale, err_msg=name)
    for name in set(want.dtype.names) - {"time", *names.q, *names.v, "input_power"}:
        size = max(1.0, np.abs(want[name]).max())
        np.testing.assert_allclose(got[name][last] / size, want[name] / size, rtol=0, atol=10 * ACCURACY, err_msg=name)
    if any_scene.name in ("three_cart", "bouncing_mass", "two_body_collision"):
        assert any(np.ptp(np.sign(want[name])) == 2 for name in names.gap), "no contact closes in the experiment"


def test_a_stiff_motion_is_integrated_by_an_implicit_method(scene_of, monkeypatch):
    """A thousand times the damping: explicit steps would be a hundred times shorter than the task's."""
    monkeypatch.setattr(reference, "BUDGET", 3000)
    stiff = scene_of("three_cart").with_parameters(c=1e6).with_task(steps=8)
    texts = experiment_texts(stiff)
    assert "Radau IIA" in texts["documentation/fmi-ls-ref.html"]
    assert np.isfinite(table(texts[f"{FOLDER}/validation_results.csv"].encode())["q1"]).all()


@pytest.mark.slow
def test_a_motion_beyond_the_budget_leaves_an_fmu_without_results_that_says_so(scene_of, monkeypatch):
    monkeypatch.setattr(reference, "BUDGET", 20)
    scene = scene_of("three_cart").with_task(steps=9)
    path = build_fmu(scene)
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        page = archive.read("documentation/fmi-ls-ref.html").decode()
        about = archive.read(f"{FOLDER}/fmi-ls-manifest.xml") + archive.read(f"{FOLDER}/validation.exp")
    assert f"{FOLDER}/validation.exp" in names
    assert f"{FOLDER}/validation_results.csv" not in names
    assert b"result" not in about
    assert not unsaid(page, "no results: scene three_cart: … more than 20 evaluations")
    assert fmpy.validation.validate_fmu(str(path)) == []


@pytest.mark.slow
@both
def test_built_once_and_equal_bytes_anywhere(scene_of, tmp_path, monkeypatch, version):
    known = build_fmu(scene_of("three_cart"), version).read_bytes()
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    path = build_fmu(scene_of("three_cart"), version)
    assert path.is_relative_to(tmp_path)
    assert path.read_bytes() == known
    stamp = path.stat().st_mtime_ns
    assert build_fmu(scene_of("three_cart"), version) == path
    assert path.stat().st_mtime_ns == stamp


@both
def test_archive_has_everything_deflated_and_no_links(any_scene, version):
    with zipfile.ZipFile(build_fmu(any_scene, version)) as archive:
        entries = archive.infolist()
        text = archive.read("documentation/index.html").decode()
        licenses = archive.read("documentation/licenses/license.txt").decode()
    names = [entry.filename for entry in entries]
    binary = "linux64" if version == "2.0" else "x86_64-linux"
    needed = {f"binaries/{binary}/{any_scene.name}.so", "sources/scene_model.h", "sources/model_config.h"}
    assert names[0] == "modelDescription.xml"
    assert needed <= set(names)
    assert any(name.startswith("sources/") and name.endswith(f"fmi{version[0]}Functions.h") for name in names)
    assert len(set(names)) == len(names)
    assert not any("\\" in name or name.startswith("/") or ".." in name for name in names)
    assert {(entry.compress_type, entry.date_time) for entry in entries} == {(zipfile.ZIP_DEFLATED, (1980, 1, 1, 0, 0, 0))}
    assert not any((entry.external_attr >> 16) & 0o170000 == 0o120000 for entry in entries)
    assert any_scene.title.split("'")[0] in text
    assert "MIT" in licenses
    assert "2-clause BSD" in licenses

"""The FMU file: valid, reproducible, complete, with terminals, icon and build description, for other platforms too; and what a user does wrong is said in one sentence."""

import dataclasses
import importlib.util
import re
import shutil
import struct
import subprocess
import zipfile
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
import sympy as sp
from example_scenes import example_scene
from fmpy.validation import validate_fmu
from lxml import etree

from models.errors import MachineError, SceneError, TouchstoneError, UnknownNameError
from models.fmu import build_fmu, variable_names
from models.fmu.description import STANDARDS, render
from models.fmu.package import PLATFORMS, find_platforms, this_platform
from models.fmu.variables import variable_table
from models.scene import Parameter, Scene
from models.scene.values import base_exponents
from tests.models.fmu.scene_outputs import scene_outputs
from validate.truth import exact_motion
from validate.truth.exact_motion import Equations, MotionError, Piece, true_motion


@pytest.mark.slow
def test_another_scene_or_date_is_another_fmu(scene_of, monkeypatch, tmp_path):
    scene = scene_of("bouncing_mass")
    guid = fmpy.read_model_description(str(build_fmu(scene))).guid
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(tmp_path))
    other = fmpy.read_model_description(str(build_fmu(scene.with_parameters(k=2000.0))))
    assert other.guid != guid
    assert (
        next(variable.start for variable in other.modelVariables if variable.name == "k")
        == "2000.0"
    )
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
    assert all(
        variable.unit for variable in description.modelVariables if variable.name != "integrator"
    )
    for unit in description.unitDefinitions:
        found = {base: getattr(unit.baseUnit, base) for base in ("kg", "m", "s", "rad")}
        assert {base: exponent for base, exponent in found.items() if exponent} == base_exponents(
            unit.name
        )
    assert [by_name[name].causality for name in (*names.q, *names.v)] == ["output"] * (
        2 * any_scene.nq
    )
    assert [by_name[name].derivative.name for name in (*names.der_q, *names.der_v)] == [
        *names.q,
        *names.v,
    ]
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
        dataclasses.replace(
            scene, name="schwingerä"
        )  # at once: a plan without an FMU is judged by nobody


@pytest.mark.parametrize("epoch", ["yesterday", "-5", "12"])
def test_bad_date_is_refused(scene_of, monkeypatch, epoch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", epoch)
    with pytest.raises(TouchstoneError, match="SOURCE_DATE_EPOCH"):
        build_fmu(scene_of("three_cart"))


both = pytest.mark.parametrize("version", STANDARDS)
SCHEMAS = Path(fmpy.__file__).parent / "schema" / "fmi3"


def read(scene, version, name):
    with zipfile.ZipFile(build_fmu(scene, version)) as archive:
        return archive.read(name)


@both
@pytest.mark.parametrize(("name", "schema"), [
    ("terminalsAndIcons/terminalsAndIcons.xml", "fmi3TerminalsAndIcons.xsd"),
    ("sources/buildDescription.xml", "fmi3BuildDescription.xsd"),
])  # fmt: skip
def test_xml_follows_the_schema(any_scene, version, name, schema):
    etree.XMLSchema(etree.parse(SCHEMAS / schema)).assertValid(
        etree.fromstring(read(any_scene, version, name))
    )


@both
def test_terminals_name_variables_that_exist(any_scene, version):
    names = variable_names(any_scene)
    root = ElementTree.fromstring(
        read(any_scene, version, "terminalsAndIcons/terminalsAndIcons.xml")
    )
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
    assert ElementTree.fromstring(read(scene, version, "terminalsAndIcons/icon.svg")).tag.endswith(
        "svg"
    )


# Inputs in each quarter of an experiment, as a share of half of what the actuator can do. Every
# second input has the other sign, so that contacts close and open.
SHARES = (1.0, -0.5, 0.0, 0.75)
# Largest difference from the exact motion, as a fraction of a state's nominal.
ACCURACY = 1e-6


def experiment(scene: Scene) -> tuple[np.ndarray, list[Piece]]:
    """Times of about 200 communication steps over the task [s], and inputs."""
    stride = -(-scene.task.steps // 200)
    count = scene.task.steps // stride
    times = np.arange(count + 1) * (scene.task.step * stride)
    strength = []
    for index, item in enumerate(scene.inputs):
        bounds = [abs(bound) for bound in (item.lower, item.upper) if np.isfinite(bound) and bound]
        strength.append((-1) ** index * (0.5 * min(bounds) if bounds else 1.0))
    ends = [times[round(count * (quarter + 1) / 4)] for quarter in range(4)]
    return times, [
        Piece(float(end), share * np.array(strength))
        for end, share in zip(ends, SHARES, strict=True)
    ]


@cache
def exact_outputs(name: str) -> dict[str, np.ndarray]:
    """All outputs over the experiment, integrated without the FMU."""
    scene = example_scene(name)
    times, pieces = experiment(scene)
    equations, names = Equations(scene), variable_names(scene)
    states = true_motion(equations, pieces, times)
    # At a knot the inputs are those that end there.
    held = [next(piece.u for piece in pieces if t <= piece.end) for t in times]
    rows = [
        scene_outputs(equations, x, u) | dict(zip((*names.q, *names.v), x, strict=True))
        for x, u in zip(states, held, strict=True)
    ]
    outputs = [item.name for item in variable_table(scene) if item.causality == "output"]
    return {output: np.array([row[output] for row in rows]) for output in outputs}


@both
def test_simulate_fmu_by_fmpy_exact_motion(any_scene, version):
    """FMPy's Co-Simulation through contacts that close and open, at every time and in every output."""
    (times, pieces), want = experiment(any_scene), exact_outputs(any_scene.name)
    given, begin = None, 0.0
    if any_scene.nu:
        rows = []
        for piece in pieces:
            rows += [(begin, *piece.u), (piece.end, *piece.u)]
            begin = piece.end
        columns = [(item, float) for item in ("time", *(item.name for item in any_scene.inputs))]
        given = np.array(rows, dtype=columns)
    got = fmpy.simulate_fmu(
        str(build_fmu(any_scene, version)),
        fmi_type="CoSimulation",
        input=given,
        stop_time=times[-1],
        output_interval=times[1],
    )
    last = [
        np.flatnonzero(np.abs(got["time"] - t) < 1e-9)[0] for t in times
    ]  # before the inputs change at a knot
    names = variable_names(any_scene)
    scale = max(coordinate.nominal for coordinate in any_scene.coordinates)
    for name in (*names.q, *names.v):
        np.testing.assert_allclose(
            got[name][last], want[name], rtol=0, atol=ACCURACY * scale, err_msg=name
        )
    for name in set(want) - {*names.q, *names.v, "input_power"}:
        size = max(1.0, np.abs(want[name]).max())
        np.testing.assert_allclose(
            got[name][last] / size, want[name] / size, rtol=0, atol=10 * ACCURACY, err_msg=name
        )
    if any_scene.name in ("three_cart", "bouncing_mass", "two_body_collision"):
        assert any(np.ptp(np.sign(want[name])) == 2 for name in names.gap), (
            "no contact closes in the experiment"
        )


def test_true_motion_stiff_scene_by_implicit_method(scene_of, monkeypatch):
    """A thousand times the damping: explicit steps would be a hundred times shorter than the task's."""
    monkeypatch.setattr(exact_motion, "BUDGET", 3000)
    stiff = scene_of("three_cart").with_parameters(c=1e6).with_task(steps=8)
    times, pieces = experiment(stiff)
    with pytest.raises(MotionError, match="of which DOP853 came to"):
        exact_motion._motion_by(exact_motion.EXPLICIT, Equations(stiff), pieces, times)
    assert np.isfinite(true_motion(Equations(stiff), pieces, times)).all()


def test_true_motion_beyond_the_budget_is_refused(scene_of, monkeypatch):
    monkeypatch.setattr(exact_motion, "BUDGET", 20)
    scene = scene_of("three_cart").with_task(steps=9)
    times, pieces = experiment(scene)
    with pytest.raises(MotionError, match=r"scene three_cart: .* more than 20 evaluations"):
        true_motion(Equations(scene), pieces, times)


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
    needed = {
        f"binaries/{binary}/{any_scene.name}.so",
        "sources/scene_model.h",
        "sources/model_config.h",
    }
    assert names[0] == "modelDescription.xml"
    assert needed <= set(names)
    assert any(
        name.startswith("sources/") and name.endswith(f"fmi{version[0]}Functions.h")
        for name in names
    )
    assert len(set(names)) == len(names)
    assert not any("\\" in name or name.startswith("/") or ".." in name for name in names)
    assert {(entry.compress_type, entry.date_time) for entry in entries} == {
        (zipfile.ZIP_DEFLATED, (1980, 1, 1, 0, 0, 0))
    }
    assert not any((entry.external_attr >> 16) & 0o170000 == 0o120000 for entry in entries)
    assert any_scene.title.split("'")[0] in text
    assert "MIT" in licenses
    assert "2-clause BSD" in licenses


# The first bytes of a shared library: ELF and Mach-O with their machine, and a Windows library.
MAGIC = {
    "x86_64-linux": lambda data: data[:5] == b"\x7fELF\x02" and data[18] == 62,
    "aarch64-linux": lambda data: data[:5] == b"\x7fELF\x02" and data[18] == 183,
    "x86_64-windows": lambda data: (
        data[:2] == b"MZ" and data[data[60] + 256 * data[61] + 4 :][:2] == b"\x64\x86"
    ),
    "x86_64-darwin": lambda data: data[:8] == b"\xcf\xfa\xed\xfe\x07\x00\x00\x01",
    "aarch64-darwin": lambda data: data[:8] == b"\xcf\xfa\xed\xfe\x0c\x00\x00\x01",
}


def test_platforms_are_found_by_the_names_of_either_version():
    names = [platform.name for platform in find_platforms(["win64", "linux64", "x86_64-linux"])]
    assert names == ["x86_64-linux", "x86_64-windows"]
    assert [platform.name for platform in find_platforms([])] == [this_platform()]
    with pytest.raises(
        UnknownNameError,
        match=r"platform 'os2' is not offered; choose from x86_64-linux \(linux64\), ",
    ):
        find_platforms(["linux64", "os2"])


def test_without_the_cross_compiler_a_sentence_says_what_to_install(scene_of, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    other = next(platform.name for platform in PLATFORMS if platform.name != this_platform())
    with pytest.raises(
        MachineError, match=r"a cross-compiler; install one with: pip install ziglang"
    ):
        build_fmu(scene_of("oscillator"), platforms=[other])


@pytest.mark.peer
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_one_fmu_for_all_platforms(scene_of, tmp_path, monkeypatch, version):
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("the cross-compiler is not installed; it comes with the extra [compiler]")
    monkeypatch.delenv("CC", raising=False)
    scene = scene_of("two_link_arm")
    with zipfile.ZipFile(
        build_fmu(scene, version, platforms=[platform.name for platform in PLATFORMS])
    ) as archive:
        for platform in PLATFORMS:
            folder = platform.fmi2 if version == "2.0" else platform.name
            data = archive.read(f"binaries/{folder}/{scene.name}{platform.suffix}")
            assert MAGIC[platform.name](data), platform.name
            assert str(tmp_path.parent.parent).encode() not in data
        library = archive.read(
            f"binaries/{'linux64' if version == '2.0' else 'x86_64-linux'}/{scene.name}.so"
        )
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("nm is not installed")
    (tmp_path / "model.so").write_bytes(library)
    symbols = subprocess.run(
        [nm, "-D", tmp_path / "model.so"], capture_output=True, text=True, check=True
    ).stdout
    needed = {
        tuple(map(int, found.split("."))) for found in re.findall(r"@GLIBC_([\d.]+)", symbols)
    }
    assert needed
    assert max(needed) <= (2, 17)

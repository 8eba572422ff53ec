"""The C of the FMU: compiles on its own with warnings as errors, exports every FMI function, and is clean under sanitizers."""

import re
import shutil
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import pytest
from c_programs import native_compiler, run, sanitizers

from models.codegen.compiler import find_compiler
from models.fmu import variable_names
from models.fmu.description import STANDARDS, standard_headers

STRICT = [
    "-std=c99",
    "-O2",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wshadow",
    "-Wstrict-prototypes",
    "-Werror",
]
DRIVERS = {
    version: Path(__file__).with_name(name)
    for version, name in (("2.0", "driver.c"), ("3.0", "driver3.c"))
}
FUNCTIONS = {"2.0": 44, "3.0": 75}
BINARIES = {"2.0": "linux64", "3.0": "x86_64-linux"}
both = pytest.mark.parametrize("version", STANDARDS)
# Neither contacts nor inputs; contacts of bodies; a mass matrix that couples.
each_kind = pytest.mark.parametrize(
    "any_scene", ["oscillator", "three_cart", "two_link_arm"], indirect=True
)


@pytest.mark.slow
@each_kind
@both
def test_sources_compile_on_their_own_without_a_warning(any_scene, unpacked, tmp_path, version):
    """As the build description says it, from the unpacked FMU alone.

    The standard's own headers may warn.
    """
    sources = Path(unpacked(any_scene, version)) / "sources"
    files = (
        ElementTree.parse(sources / "buildDescription.xml")
        .getroot()
        .find("BuildConfiguration/SourceFileSet")
    )
    listed = [file.get("name") for file in files.findall("SourceFile")]
    assert sorted(listed) == sorted(path.name for path in sources.glob("*.c"))
    if version == "2.0":
        xml = (sources.parent / "modelDescription.xml").read_text()
        assert sorted(re.findall(r'<File name="(.+)"/>', xml)) == sorted(
            listed * 2
        )  # once for each FMU type
    include = [f"-isystem{folder.get('name')}" for folder in files.findall("IncludeDirectory")]
    libraries = [
        f"-l{library.get('name')}"
        for library in ElementTree.parse(sources / "buildDescription.xml").getroot().iter("Library")
    ]
    command = [
        *find_compiler().command,
        *STRICT,
        *files.get("compilerOptions").split(),
        *include,
        "-fPIC",
        "-shared",
        *listed,
    ]
    run([*command, "-o", tmp_path / "model.so", *libraries], cwd=sources)


@each_kind
@both
def test_every_function_of_the_standard_is_exported_and_nothing_else(any_scene, unpacked, version):
    standard = STANDARDS[version]
    text = standard_headers(standard)[standard.headers[0]]
    declared = set(re.findall(rf"{standard.prefix}FullName\(({standard.prefix}\w+)\)", text))
    assert len(declared) == FUNCTIONS[version]
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("nm is not installed")
    library = (
        Path(unpacked(any_scene, version)) / "binaries" / BINARIES[version] / f"{any_scene.name}.so"
    )
    exported = {
        line.split()[-1] for line in run([nm, "-D", "--defined-only", library]).splitlines()
    }
    assert exported == declared


@each_kind
@both
def test_binary_has_no_mutable_globals_and_names_no_path_of_this_machine(
    any_scene, unpacked, version
):
    folder = Path(unpacked(any_scene, version))
    for name in (folder / "sources").glob("*.[ch]"):
        text = name.read_text()
        for line in text.splitlines():
            assert not re.match(r"\s*(static|extern) (?!const |inline ).*[;=]", line), (
                f"{name.name}: {line}"
            )
    data = (folder / "binaries" / BINARIES[version] / f"{any_scene.name}.so").read_bytes()
    assert b"/home" not in data
    assert b"/tmp" not in data
    assert str(Path(__file__).parents[3]).encode() not in data


# Without contacts, with friction, with damped contacts.
FEW = ("oscillator", "transport", "damped_collision")
MORE = ("two_link_arm", "three_cart")


def program(scene_of, unpacked, tmp_path, version, compiler, flags, names, steps):
    """Models linked into one program by their prefixes, with a driver each that takes so many steps; the program's path.

    Compiled as written, without optimisation: what it would do away with is seen too, in a third of
    the time.
    """
    objects = []
    driver = DRIVERS[version]
    for name in names:
        scene, folder = scene_of(name), Path(unpacked(scene_of(name), version))
        description = fmpy.read_model_description(str(folder))
        table = variable_names(scene)
        assert description.modelVariables[1].name == table.q[0]
        number = {variable.name: variable.valueReference for variable in description.modelVariables}
        prefix = STANDARDS[version].prefix
        own = tmp_path / name
        own.mkdir()
        macros = {
            "GUID": f'"{description.guid if version == "2.0" else description.instantiationToken}"',
            "CHECK": f"check_{name}",
            "STEPS": steps,
            "STATES": 2 * scene.nq,
            "INDICATORS": int(description.numberOfEventIndicators),
            "INPUTS": scene.nu,
            "INPUT": number[table.u[0]] if scene.nu else 0,
            "VARIABLES": len(description.modelVariables)
            - 1,  # all but the enumeration, which is the last
            f"{prefix.upper()}_FUNCTION_PREFIX": f"{name}_",
        }
        include = [
            f"-I{folder / 'sources'}",
            f"-I{own}",
            f"-isystem{folder / 'sources' / STANDARDS[version].header_folder}",
        ]
        defines = [f"-D{key}={value}" for key, value in macros.items()]
        if version == "2.0":  # some copies of its headers ignore the prefix
            used = sorted(set(re.findall(r"\bfmi2[A-Z]\w+(?=\()", driver.read_text())))
            declared = [
                f"#define {function} {name}_{function}\nextern {function}TYPE {function};\n"
                for function in used
            ]
            (own / "names.h").write_text("".join(declared))
        for source in sorted((folder / "sources").glob("*.c")):
            objects.append(tmp_path / f"{name}_{source.stem}.o")
            run(
                [
                    compiler,
                    *flags,
                    *include,
                    f"-D{prefix.upper()}_FUNCTION_PREFIX={name}_",
                    "-c",
                    source,
                    "-o",
                    objects[-1],
                ]
            )
        objects.append(tmp_path / f"{name}_driver.o")
        run([compiler, *flags, *include, *defines, "-c", driver, "-o", objects[-1]])
    main = tmp_path / "main.c"
    calls = " || ".join(f"check_{name}()" for name in names)
    main.write_text(
        "".join(f"int check_{name}(void);\n" for name in names)
        + f"int main(void) {{ return {calls}; }}\n"
    )
    run([compiler, *flags, main, *objects, "-o", tmp_path / "program", "-lm"])
    return tmp_path / "program"


@pytest.mark.slow
@both
def test_models_in_one_program_under_sanitizers(scene_of, unpacked, tmp_path, version):
    run([program(scene_of, unpacked, tmp_path, version, *sanitizers(tmp_path), (*FEW, *MORE), 200)])


@pytest.mark.slow
@both
def test_models_in_one_program_under_valgrind(scene_of, unpacked, tmp_path, version):
    """No leak and no use of a value that was never set, of few models and steps, in which friction slips and sticks: each takes fifty times as long here."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        pytest.skip("valgrind is not installed")
    binary = program(
        scene_of, unpacked, tmp_path, version, native_compiler(), ["-std=c99", "-g"], FEW, 40
    )
    run(
        [
            valgrind,
            "-q",
            "--leak-check=full",
            "--show-leak-kinds=all",
            "--errors-for-leak-kinds=all",
            "--error-exitcode=9",
            binary,
        ]
    )

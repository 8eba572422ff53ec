"""The C of the FMU: compiles on its own with warnings as errors, exports every FMI function, and is clean under sanitizers."""

import re
import shutil
import subprocess
from pathlib import Path

import fmpy
import pytest

from models.codegen.compiler import find_compiler
from models.fmu import variable_names
from models.fmu.standards import STANDARDS, standard_headers

STRICT = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wstrict-prototypes", "-Werror"]
DRIVER = Path(__file__).with_name("driver.c")


def run(command, **options):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_sources_compile_on_their_own_without_a_warning(any_scene, unpacked, tmp_path):
    sources = Path(unpacked(any_scene)) / "sources"
    xml = (sources.parent / "modelDescription.xml").read_text()
    listed = re.findall(r'<File name="(.+)"/>', xml)
    assert sorted(listed) == sorted([path.name for path in sources.glob("*.c")] * 2)  # once for each FMU type
    listed = sorted(set(listed))
    run([*find_compiler().command, *STRICT, "-fPIC", "-shared", *listed, "-o", tmp_path / "model.so", "-lm"], cwd=sources)


def test_every_function_of_the_standard_is_exported_and_nothing_else(any_scene, unpacked):
    declared = set(re.findall(r"fmi2FullName\((fmi2\w+)\)", standard_headers(STANDARDS["2.0"])["fmi2Functions.h"]))
    assert len(declared) == 44
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("nm is not installed")
    library = Path(unpacked(any_scene)) / "binaries" / "linux64" / f"{any_scene.name}.so"
    exported = {line.split()[-1] for line in run([nm, "-D", "--defined-only", library]).splitlines()}
    assert exported == declared


def test_binary_has_no_mutable_globals_and_names_no_path_of_this_machine(any_scene, unpacked):
    folder = Path(unpacked(any_scene))
    for name in (folder / "sources").glob("*.[ch]"):
        text = name.read_text()
        for line in text.splitlines():
            assert not re.match(r"\s*(static|extern) (?!const |inline ).*[;=]", line), f"{name.name}: {line}"
    data = (folder / "binaries" / "linux64" / f"{any_scene.name}.so").read_bytes()
    assert b"/home" not in data
    assert b"/tmp" not in data
    assert str(Path(__file__).parents[3]).encode() not in data


@pytest.mark.parametrize("sanitizer", ["address,undefined", "undefined"])
def test_two_models_in_one_program_under_sanitizers(scene_of, unpacked, tmp_path, sanitizer):
    """Two models linked into one program by their prefixes: no clash, no leak, no access out of bounds, no undefined behaviour."""
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("sanitizers need gcc or clang")
    flags = ["-std=c99", "-g", "-O1", f"-fsanitize={sanitizer}", "-fno-sanitize-recover=all", "-Wall", "-Wextra", "-Werror"]
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    if subprocess.run([compiler, *flags, probe, "-o", tmp_path / "probe"], capture_output=True, check=False).returncode:
        pytest.skip(f"this compiler has no -fsanitize={sanitizer}")
    objects, names = [], ("two_link_arm", "three_cart", "oscillator")
    for name in names:
        scene, folder = scene_of(name), Path(unpacked(scene_of(name)))
        description = fmpy.read_model_description(str(folder))
        include = [f"-I{folder / 'sources'}"]
        macros = {
            "GUID": f'"{description.guid}"',
            "CHECK": f"check_{name}",
            "STATES": 2 * scene.nq,
            "CONTACTS": scene.nc,
            "VARIABLES": len(description.modelVariables) - 1,  # all but the enumeration, which is the last
        }
        assert description.modelVariables[1].name == variable_names(scene).q[0]
        used = sorted(set(re.findall(r"\bfmi2[A-Z]\w+(?=\()", DRIVER.read_text())))
        own = tmp_path / name
        own.mkdir()
        (own / "names.h").write_text(
            "".join(f"#define {function} {name}_{function}\nextern {function}TYPE {function};\n" for function in used)
        )
        for source in sorted((folder / "sources").glob("*.c")):
            objects.append(tmp_path / f"{name}_{source.stem}.o")
            run([compiler, *flags, *include, f"-DFMI2_FUNCTION_PREFIX={name}_", "-c", source, "-o", objects[-1]])
        objects.append(tmp_path / f"{name}_driver.o")
        run(
            [
                compiler,
                *flags,
                *include,
                f"-I{own}",
                *(f"-D{key}={value}" for key, value in macros.items()),
                "-c",
                DRIVER,
                "-o",
                objects[-1],
            ]
        )
    main = tmp_path / "main.c"
    calls = " || ".join(f"check_{name}()" for name in names)
    main.write_text("".join(f"int check_{name}(void);\n" for name in names) + f"int main(void) {{ return {calls}; }}\n")
    run([compiler, *flags, main, *objects, "-o", tmp_path / "program", "-lm"])
    run([tmp_path / "program"])

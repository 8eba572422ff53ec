"""C programs that tests compile and run, with sanitizers where the compiler has them."""

import shutil
import subprocess

import pytest


def run(command, **options):
    done = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, check=False, **options
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def native_compiler():
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("sanitizers and valgrind need gcc or clang")
    return compiler


def sanitizers(folder):
    """(compiler, flags): no leak, no access out of bounds, no undefined behaviour.

    Some compilers have the second sanitizer only.
    """
    compiler, probe = native_compiler(), folder / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    for named in ("address,undefined", "undefined"):
        flags = [
            "-std=c99",
            "-g",
            f"-fsanitize={named}",
            "-fno-sanitize-recover=all",
            "-Wall",
            "-Wextra",
            "-Werror",
        ]
        if (
            subprocess.run(
                [compiler, *flags, probe, "-o", folder / "probe"], capture_output=True, check=False
            ).returncode
            == 0
        ):
            return compiler, flags
    pytest.skip("this compiler has no sanitizers")

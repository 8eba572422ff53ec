"""Binaries for other platforms by the cross-compiler, and what is said without it."""

import importlib.util
import re
import shutil
import subprocess
import zipfile

import pytest

from models.errors import MachineError, UnknownNameError
from models.fmu import build_fmu
from models.fmu.package import PLATFORMS, find_platforms, this_platform

# The first bytes of a shared library: ELF and Mach-O with their machine, and a Windows library.
MAGIC = {
    "x86_64-linux": lambda data: data[:5] == b"\x7fELF\x02" and data[18] == 62,
    "aarch64-linux": lambda data: data[:5] == b"\x7fELF\x02" and data[18] == 183,
    "x86_64-windows": lambda data: data[:2] == b"MZ" and data[data[60] + 256 * data[61] + 4 :][:2] == b"\x64\x86",
    "x86_64-darwin": lambda data: data[:8] == b"\xcf\xfa\xed\xfe\x07\x00\x00\x01",
    "aarch64-darwin": lambda data: data[:8] == b"\xcf\xfa\xed\xfe\x0c\x00\x00\x01",
}


def test_platforms_are_found_by_the_names_of_either_version():
    names = [platform.name for platform in find_platforms(["win64", "linux64", "x86_64-linux"])]
    assert names == ["x86_64-linux", "x86_64-windows"]
    assert [platform.name for platform in find_platforms([])] == [this_platform()]
    with pytest.raises(UnknownNameError, match=r"platform 'os2' is not offered; choose from x86_64-linux \(linux64\), "):
        find_platforms(["linux64", "os2"])


def test_without_the_cross_compiler_a_sentence_says_what_to_install(scene_of, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    other = next(platform.name for platform in PLATFORMS if platform.name != this_platform())
    with pytest.raises(MachineError, match=r"a cross-compiler; install one with: pip install ziglang"):
        build_fmu(scene_of("oscillator"), platforms=[other])


@pytest.mark.peer
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_one_fmu_for_all_platforms(scene_of, tmp_path, monkeypatch, version):
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("the cross-compiler is not installed; it comes with the extra [compiler]")
    monkeypatch.delenv("CC", raising=False)
    scene = scene_of("two_link_arm")
    with zipfile.ZipFile(build_fmu(scene, version, platforms=[platform.name for platform in PLATFORMS])) as archive:
        for platform in PLATFORMS:
            folder = platform.fmi2 if version == "2.0" else platform.name
            data = archive.read(f"binaries/{folder}/{scene.name}{platform.suffix}")
            assert MAGIC[platform.name](data), platform.name
            assert str(tmp_path.parent.parent).encode() not in data
        library = archive.read(f"binaries/{'linux64' if version == '2.0' else 'x86_64-linux'}/{scene.name}.so")
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("nm is not installed")
    (tmp_path / "model.so").write_bytes(library)
    symbols = subprocess.run([nm, "-D", tmp_path / "model.so"], capture_output=True, text=True, check=True).stdout
    needed = {tuple(map(int, found.split("."))) for found in re.findall(r"@GLIBC_([\d.]+)", symbols)}
    assert needed
    assert max(needed) <= (2, 17)

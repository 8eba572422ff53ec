"""FMUs with a seeded defect: the exporter's own sources and description, changed at one place, compiled and packed anew."""

import zipfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import pytest

from models.catalog import load_scene
from models.codegen.compiler import compile_shared, find_compiler
from models.fmu import build_fmu
from validate.fmu_check import Status, check_fmu

Edit = tuple[str, str, str]


@cache
def _content(version: str) -> dict[str, bytes]:
    """The files of three_cart's FMU."""
    with zipfile.ZipFile(build_fmu(load_scene("three_cart"), version)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pack(path: Path, content: Mapping[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def _edited(content: dict[str, bytes], edits: Sequence[Edit]) -> dict[str, bytes]:
    """Each edit is (file, old, new); the old text must be there."""
    changed = dict(content)
    for name, old, new in edits:
        text = changed[name].decode()
        assert old in text, (
            f"{name} does not contain {old!r} any more: the defect must be seeded elsewhere"
        )
        changed[name] = text.replace(old, new, 1).encode()
    return changed


def _compiled(content: dict[str, bytes], folder: Path) -> dict[str, bytes]:
    """The same with its binary built from its sources, as fast as can be: forty of them are built."""
    binary = next(name for name in content if name.startswith("binaries/"))
    sources = {
        name.removeprefix("sources/"): data.decode()
        for name, data in content.items()
        if name.startswith("sources/") and name.endswith((".c", ".h"))
    }
    includes = sorted({Path(name).parent for name in sources} - {Path()})
    library = folder / "defective.so"
    compile_shared(
        find_compiler(), sources, library, extra_flags=["-w", "-O0"], include_dirs=includes
    )
    return content | {binary: library.read_bytes()}


@pytest.fixture
def defective(tmp_path: Path) -> Callable[..., Path]:
    """defective(edits, version) -> the FMU with these edits of its files."""

    def build(edits: Sequence[Edit], version: str = "2.0") -> Path:
        content = _edited(_content(version), edits)
        if any(name.startswith("sources/") for name, _, _ in edits):
            content = _compiled(content, tmp_path)
        return pack(tmp_path / "defective.fmu", content)

    return build


@pytest.fixture
def sound_content() -> Callable[[str], dict[str, bytes]]:
    """Version -> the files of a sound FMU, to be packed in other ways."""
    return lambda version: dict(_content(version))


@pytest.fixture
def must_find(defective: Callable[..., Path]) -> Callable[..., None]:
    """must_find(defect, check, words, edits, version): the check of that name must fail with these words in its sentence."""

    def find(
        defect: str, check: str, words: str, edits: Sequence[Edit], version: str = "2.0"
    ) -> None:
        report = check_fmu(
            defective(edits, version), names=[check], seconds=1.5 if "hangs" in defect else 20.0
        )
        found = [
            row.sentence for row in report.rows if row.name == check and row.status is Status.FAILED
        ]
        assert found, [(row.name, row.type, row.status.value, row.sentence) for row in report.rows]
        assert words in " ".join(found), found

    return find

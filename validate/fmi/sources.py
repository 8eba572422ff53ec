"""FMUs that come as sources: which files, definitions and folders an interface is compiled from, and the binary of it for this machine.

FMI 3.0 and 2.0.4 say it in sources/buildDescription.xml, FMI 2.0 in modelDescription.xml. Options of compilers are not taken over: they are for the compiler they name.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from models.codegen.compiler import find_compiler
from validate.fmi.archive import DESCRIPTION, FmuError

# Seconds of compilation.
_LONGEST = 300.0


@dataclass(frozen=True)
class Sources:
    """What a binary is compiled from: files and folders below sources/, and definitions, NAME or NAME=VALUE."""

    files: tuple[str, ...]
    folders: tuple[str, ...]
    definitions: tuple[str, ...]


def sources_of(folder: Path, identifier: str) -> Sources | None:
    """Of an interface of an unpacked FMU, by its modelIdentifier; None where it has none. Raises FmuError for XML that cannot be read."""
    described = folder / "sources" / "buildDescription.xml"
    try:
        if described.is_file():
            for item in ElementTree.parse(described).iter("BuildConfiguration"):
                if item.get("modelIdentifier") == identifier:
                    return _found(item, "SourceFile")
        for item in ElementTree.parse(folder / DESCRIPTION).getroot():
            if item.get("modelIdentifier") == identifier and item.find("SourceFiles") is not None:
                return _found(item, "File")
    except ElementTree.ParseError as error:
        raise FmuError(f"sources/{described.name} cannot be read ({error})") from error
    return None


def _found(item: ElementTree.Element, name: str) -> Sources:
    files = tuple(file.get("name", "") for file in item.iter(name))
    folders = tuple(place.get("name", "") for place in item.iter("IncludeDirectory"))
    definitions = [(entry.get("name", ""), entry.get("value"), entry.get("optional")) for entry in item.iter("PreprocessorDefinition")]
    return Sources(
        files, folders, tuple(key if value is None else f"{key}={value}" for key, value, optional in definitions if optional != "true")
    )


def compile_sources(folder: Path, sources: Sources, major: int, library: Path) -> str:
    """Compile an unpacked FMU's binary to `library`; by which compiler. Raises FmuError with what the compiler says, MachineError without one."""
    from models.fmu.description import find_standard, standard_headers  # SymPy with it, 0.6 s, which few FMUs need

    place, compiler = (folder / "sources").resolve(), find_compiler()
    paths = [(place / name).resolve() for name in (*sources.files, *sources.folders)]
    for path, name in zip(paths, (*sources.files, *sources.folders), strict=True):
        if not path.is_relative_to(place) or not path.exists():
            raise FmuError(f"sources/{name} is named, and is not there")
    headers = library.parent / "headers"
    for name, text in standard_headers(find_standard(f"{major}.0")).items():
        (headers / name).parent.mkdir(parents=True, exist_ok=True)
        (headers / name).write_text(text, encoding="utf-8")
    includes = {place, *paths[len(sources.files) :], headers, *(path.parent for path in headers.rglob("*.h"))}
    command = [
        *compiler.command,
        "-O2",
        "-w",
        "-fPIC",
        "-shared",
        f"-DFMI{major}_OVERRIDE_FUNCTION_PREFIX",  # names as a shared library has them
        *(f"-I{path}" for path in sorted(includes)),
        *(f"-D{text}" for text in sources.definitions),
    ]
    done = subprocess.run(
        [*command, *map(str, paths[: len(sources.files)]), "-o", str(library), "-lm"],
        capture_output=True,
        text=True,
        timeout=_LONGEST,
        check=False,
    )
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines() or ["no word"]
        raise FmuError(f"{compiler.command[0]} cannot compile it: {lines[0].replace(str(place), 'sources')}")
    return Path(compiler.command[0]).name

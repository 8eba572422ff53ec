"""The files of an FMU: its archive, the binary for this machine, and the description - valid, and free of contradictions that no schema sees.

What a shared library of Linux exports and needs is read without loading it (System V Application
Binary Interface, chapters 4 and 5: sections, symbol table, dynamic section). Where there is none,
it is compiled from what sources/buildDescription.xml says in FMI 3.0 and 2.0.4, or
modelDescription.xml in FMI 2.0. Options of compilers are not taken over: they are for the compiler
they name.
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import math
import platform
import re
import struct
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fmpy.model_description import ValidationError, read_build_description, read_model_description
from fmpy.validation import validate_model_description

from models.codegen.compiler import find_compiler
from models.errors import MachineError
from validate.fmi.archive import ARCHIVE_CHECKS, FmuError, binary_name, problems
from validate.fmi.description import in_words, understood, unfit, without_garbage
from validate.fmi.instance import CLASSES
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed, unless
from validate.fmu_check.subject import FmuVariable, Subject

# Names that are legal by either naming convention (FMI 2.0.4, 2.2.9; 3.0.2, 2.4.7.5.1).
_PART = r"[A-Za-z_][A-Za-z_0-9]*(\[[0-9]+(,[0-9]+)*\])?"
_PLAIN = re.compile(rf"{_PART}(\.{_PART})*|der\({_PART}(\.{_PART})*(,[0-9]+)?\)")
_HEADER = 52  # bytes of the shorter header, that of 32 bits
_MACHINES = {3: "x86", 62: "x86_64", 183: "aarch64"}
_DYNAMIC_SECTION = 6
_SYMBOL_SECTION = 11
_NEEDED = 1
_UNDEFINED = 0
_FUNCTION_KINDS = (2, 10)  # STT_FUNC, STT_GNU_IFUNC


class NotElf(ValueError):  # noqa: N818 - says what the file is not
    """The bytes are no ELF file that can be read."""


@dataclass(frozen=True)
class Library:
    """exported: names of functions; needed: other libraries.

    glibc: the newest version of the GNU C library it asks for ("" if none).
    """

    machine: str
    exported: frozenset[str]
    needed: tuple[str, ...]
    glibc: str


def read_library(data: bytes) -> Library:
    """The tables of a library of 64 bits, little end first, as every machine has them on which FMUs are checked; of others the machine alone. Raises NotElf."""
    if data[:4] != b"\x7fELF" or len(data) < _HEADER:
        raise NotElf("it does not begin like an ELF file")
    if data[4] not in (1, 2) or data[5] not in (1, 2):
        raise NotElf("its class or byte order is unknown")
    number = int.from_bytes(data[18:20], "little" if data[5] == 1 else "big")
    machine = _MACHINES.get(number, f"machine {number}")
    if data[4:6] != b"\2\1":
        return Library(machine, frozenset(), (), "")

    def read(form: str, at: int) -> tuple[int, ...]:
        return struct.unpack_from(f"<{form}", data, at)

    try:
        (table,), (size, count) = read("Q", 40), read("HH2x", 58)
        sections = [
            read("4xI16xQQI12xQ", table + place * size) for place in range(count)
        ]  # kind, offset, length, link and size of a row
        if sum(
            length
            for kind, _, length, _, _ in sections
            if kind in (_DYNAMIC_SECTION, _SYMBOL_SECTION)
        ) > len(data):
            raise NotElf("its tables are larger than the file")
        exported: set[str] = set()
        needed: list[str] = []
        strings = b""
        for kind, offset, length, link, entry in sections:
            if kind not in (_DYNAMIC_SECTION, _SYMBOL_SECTION):
                continue
            strings = data[sections[link][1] : sections[link][1] + sections[link][2]]
            for at in range(offset, offset + length, entry):
                if kind == _SYMBOL_SECTION:
                    name, info, section = read("IBxH", at)
                    if section != _UNDEFINED and info & 0xF in _FUNCTION_KINDS and info >> 4:
                        exported.add(_text(strings, name))
                else:
                    tag, value = read("QQ", at)
                    if tag == _NEEDED:
                        needed.append(_text(strings, value))
        versions = [
            tuple(map(int, item.split(b".")))
            for item in re.findall(rb"\0GLIBC_([0-9.]+)(?=\0)", strings)
        ]
        glibc = ".".join(map(str, max(versions))) if versions else ""
        return Library(machine, frozenset(exported), tuple(needed), glibc)
    except (struct.error, IndexError, ValueError, OverflowError) as error:
        raise NotElf(f"its tables cannot be read ({error})") from error


def _text(strings: bytes, at: int) -> str:
    return strings[at : strings.index(b"\0", at)].decode("utf-8")


_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# Libraries that every Linux has; with others the FMU runs only where they are installed, or in the
# FMU.
_EVERYWHERE = (
    "libc.so",
    "libm.so",
    "libpthread.so",
    "libdl.so",
    "librt.so",
    "libgcc_s.so",
    "libstdc++.so",
    "ld-linux",
    "linux-vdso",
)


_TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"


@check("archive", Scope.FILE, clauses=("2.3", "2.5.1"))
def archive(path: Path) -> Finding:
    """A zip file of deflated or stored entries with forward slashes, no links, nothing that leaves its folder."""
    # Looks at the file only: comes before anything is unpacked.
    wrong = [
        str(problem).removeprefix(f"FMU {path}: ").rstrip(".")
        for problem in problems(path)
        if problem.check in ARCHIVE_CHECKS
    ]
    with zipfile.ZipFile(path) as packed:
        items = packed.infolist()
    wrong += [
        f"the entry {item.filename!r} is packed by a method other than deflate"
        for item in items
        if item.compress_type not in _METHODS
    ]
    unpacked = sum(item.file_size for item in items)
    return unless(wrong, f"{len(items)} entries, {path.stat().st_size} bytes, {unpacked} unpacked.")


def library_path(subject: Subject, kind: str) -> Path:
    """Where the binary for this machine must be."""
    return subject.folder / binary_name(
        subject.description.fmiVersion, subject.interface(kind).modelIdentifier
    )


# Seconds of compilation.
_LONGEST = 300.0


def _sources_of(subject: Subject, kind: str) -> tuple[list[str], list[str], list[str]]:
    """What an interface is compiled from: files and folders below sources/, and definitions, NAME or NAME=VALUE.

    Raises FmuError for XML that cannot be read.
    """
    try:
        described = read_build_description(str(subject.folder), validate=False)
    except Exception as error:  # FMPy raises anything
        raise FmuError(f"sources/buildDescription.xml cannot be read ({error})") from error
    configurations, identifier = (
        (*described, *subject.description.buildConfigurations),
        subject.interface(kind).modelIdentifier,
    )
    sets = next(
        (item.sourceFileSets for item in configurations if item.modelIdentifier == identifier), []
    )
    definitions = (item for one in sets for item in one.preprocessorDefinitions)
    return (
        [name or "" for one in sets for name in one.sourceFiles],
        [name or "" for one in sets for name in one.includeDirectories],
        [
            item.name if item.value is None else f"{item.name}={item.value}"
            for item in definitions
            if not item.optional
        ],
    )


def _compile(
    subject: Subject, files: list[str], folders: list[str], definitions: list[str], library: Path
) -> str:
    """Compile an unpacked FMU's binary to `library`; by which compiler.

    Raises FmuError with what the compiler says, MachineError without one.
    """
    from models.fmu.description import (
        find_standard,
        standard_headers,
    )  # SymPy with it, 0.6 s, which few FMUs need

    place, compiler = (subject.folder / "sources").resolve(), find_compiler()
    paths = [(place / name).resolve() for name in (*files, *folders)]
    for path, name in zip(paths, (*files, *folders), strict=True):
        if not path.is_relative_to(place) or not path.exists():
            raise FmuError(f"sources/{name} is named, and is not there")
    headers = library.parent / "headers"
    for name, text in standard_headers(find_standard(f"{subject.major}.0")).items():
        (headers / name).parent.mkdir(parents=True, exist_ok=True)
        (headers / name).write_text(text, encoding="utf-8")
    includes = {
        place,
        *paths[len(files) :],
        headers,
        *(path.parent for path in headers.rglob("*.h")),
    }
    command = [
        *(*compiler.command, "-O2", "-w", "-fPIC", "-shared"),
        f"-DFMI{subject.major}_OVERRIDE_FUNCTION_PREFIX",  # names as a shared library has them
        *(f"-I{path}" for path in sorted(includes)),
        *(f"-D{text}" for text in definitions),
        *map(str, paths[: len(files)]),
        *("-o", str(library), "-lm"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST, check=False)
    if done.returncode:
        lines = (
            [line for line in done.stderr.splitlines() if "error" in line]
            or done.stderr.splitlines()
            or ["no word"]
        )
        raise FmuError(
            f"{compiler.command[0]} cannot compile it: {lines[0].replace(str(place), 'sources')}"
        )
    return Path(compiler.command[0]).name


@check("sources compile", Scope.EACH, clauses=("2.3", "2.5.1.3"))
def compiled(subject: Subject, kind: str) -> Finding:
    """Where there is no binary for this machine, the sources that the FMU brings give one."""
    path = library_path(subject, kind)
    if path.is_file():
        return not_offered("there is a binary for this machine.")
    try:
        files, folders, definitions = _sources_of(subject, kind)
        if not files:
            return not_offered("there is no binary for this machine, and no source.")
        path.parent.mkdir(parents=True, exist_ok=True)
        compiler = _compile(subject, files, folders, definitions, path)
    except FmuError as error:
        return failed(f"{error}.")
    except MachineError as error:
        return not_offered(str(error))
    return passed(f"{len(files)} files, by {compiler}.")


@check("exported functions", Scope.EACH, clauses=("2.1.1", "2.2.2"))
def exports(subject: Subject, kind: str) -> Finding:
    """The binary exports every function of its type, as the standard demands of optional ones, too."""
    path = library_path(subject, kind)
    if not path.is_file():
        return not_offered(f"there is no {path.relative_to(subject.folder)}.")
    if sys.platform != "linux":
        return not_offered("binaries are read on Linux only.")
    try:
        library = read_library(path.read_bytes())
    except NotElf as error:
        return failed(f"{path.relative_to(subject.folder)}: {error}.")
    machine = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    if library.machine != machine:
        return failed(
            f"{path.relative_to(subject.folder)} is for {library.machine}, but this platform is {machine}."
        )
    required = {
        name
        for name in dir(CLASSES[subject.major, kind])
        if name.startswith(f"fmi{subject.major}") and name[4:5].isupper()
    }
    if missing := sorted(required - library.exported):
        return failed(
            f"{len(missing)} missing: {', '.join(missing[:6])}{' and more' if len(missing) > 6 else ''}."
        )
    foreign = [
        name
        for name in library.needed
        if not name.startswith(_EVERYWHERE) and not (path.parent / name).exists()
    ]
    needs = f", needs {', '.join(foreign)} of the machine" if foreign else ""
    return passed(
        f"all {len(required)} are there{f', glibc {library.glibc} or newer' if library.glibc else ''}{needs}."
    )


@check("description is valid", Scope.FILE, clauses=("2.2", "2.4"))
def valid(path: Path) -> Finding:
    """modelDescription.xml obeys its schema and the rules of FMI (FMPy's validation).

    The binary is called by a C identifier; terminals name variables that there are.
    """
    # Looks at the unpacked folder; comes before the description is read without validation.
    with without_garbage():
        problems = [
            " ".join(str(problem).split()).rstrip(".") for problem in _by_fmpy(path)
        ] + _of_terminals(path)
    return unless(problems, "0 problems.")


def _by_fmpy(path: Path) -> list[str]:
    """What FMPy's validation says.

    Of names only those go through its parser, a millisecond each, that are no plain ones.
    """
    problems, description = [], None
    try:
        description = read_model_description(
            str(path), validate=True, validate_model_structure=True
        )
    except ValidationError as error:
        problems = list(error.problems)
        with contextlib.suppress(FmuError):  # it has said why
            description = understood(path)
    except Exception as error:  # noqa: BLE001 - FMPy raises anything
        return [in_words(error)]
    if description is not None:
        names = copy.copy(description)
        names.modelVariables = [
            item for item in description.modelVariables if not _PLAIN.fullmatch(item.name)
        ]
        found = (
            validate_model_description(names, validate_variable_names=True)
            if names.modelVariables
            else []
        )
        problems += [problem for problem in found if problem not in problems] + unfit(description)
    return problems


def _of_terminals(folder: Path) -> list[str]:
    """What is wrong with the terminals of an unpacked FMU: names that are there twice, or are of no variable."""
    file = folder / _TERMINALS
    if not file.is_file():
        return []
    try:
        root = ElementTree.parse(file).getroot()  # no DOCTYPE: such an archive is not unpacked
    except (ElementTree.ParseError, ValueError) as error:
        return [f"{_TERMINALS} is no XML that can be read ({error})"]
    with contextlib.suppress(ElementTree.ParseError):  # told by FMPy's validation
        known = {
            item.get("name")
            for item in ElementTree.parse(folder / "modelDescription.xml").iter()
            if "valueReference" in item.attrib
        }
        named = [item.get("variableName") for item in root.iter("TerminalMemberVariable")]
        wrong = [
            f"{_TERMINALS} names the variable {name!r}, which there is not"
            for name in named
            if name not in known
        ]
        for parent in root.iter():
            for kind, attribute in (("Terminal", "name"), ("TerminalMemberVariable", "memberName")):
                names = [
                    item.get(attribute) for item in parent.findall(kind) if item.get(attribute)
                ]
                wrong += [
                    f"{_TERMINALS} has the {attribute} {name!r} twice"
                    for name in dict.fromkeys(names)
                    if names.count(name) > 1
                ]
        return wrong
    return []


# Factors of units that are the same but for the digits with which they are written.
_SAME_FACTOR = 1e-6


@check("variables are consistent", Scope.FILE, clauses=("2.2.7", "2.4.7"))
def consistent(subject: Subject) -> Finding:
    """Starts lie within ranges, ranges are not empty, nominals positive, units of derivatives those of states per second."""
    # An alias of FMI 3.0 is another name and nothing else; one of FMI 2.0 has a range of its own.
    described = subject.values if subject.major >= 3 else subject.variables
    wrong = [
        *itertools.chain.from_iterable(map(_of_variable, described)),
        *_of_aliases(subject),
        *_of_derivatives(subject),
    ]
    if not subject.description.guid:
        wrong.append("the GUID or instantiation token is empty")
    return unless(wrong, f"{len(subject.values)} variables.")


def _of_variable(item: FmuVariable) -> list[str]:
    wrong = []
    if item.lower > item.upper:
        wrong.append(f"{item.name} has the empty range {item.lower:g} .. {item.upper:g}")
    elif item.start is not None and ((item.start < item.lower) | (item.start > item.upper)).any():
        wrong.append(
            f"{item.name} starts at {item.start[0]:g}, outside its range {item.lower:g} .. {item.upper:g}"
        )
    if item.start is not None and not all(map(math.isfinite, item.start)):
        wrong.append(f"{item.name} starts at {item.start[0]:g}")
    if item.nominal is not None and not (item.nominal > 0.0 and math.isfinite(item.nominal)):
        wrong.append(f"{item.name} has the nominal {item.nominal:g}; it must be positive")
    return wrong


def _of_aliases(subject: Subject) -> list[str]:
    """Variables that share a value must share its start."""
    first: dict[tuple[int, str], FmuVariable] = {}
    wrong = []
    for item in subject.variables:
        other = first.setdefault(item.key, item)
        if (
            other.start is not None
            and item.start is not None
            and not (other.start == item.start).all()
        ):
            wrong.append(
                f"{other.name} and {item.name} have one value reference, {item.reference}, but different starts"
            )
    return wrong


def _of_derivatives(subject: Subject) -> list[str]:
    """A derivative's unit must be that of its state per second, where both are defined by base units."""
    units = {
        unit.name: unit.baseUnit
        for unit in subject.description.unitDefinitions
        if unit.baseUnit is not None
    }
    wrong = []
    for rate, state in subject.rates:
        one, other = units.get(rate.unit), units.get(state.unit)
        if one is None or other is None:
            continue
        said = f"{rate.name} has the unit {rate.unit}, but is the derivative of {state.name} in {state.unit}"
        if _exponents(one) != _exponents(other, seconds=-1):
            wrong.append(said)
        elif not math.isclose(float(one.factor), float(other.factor), rel_tol=_SAME_FACTOR):
            wrong.append(f"{said}: their factors are {one.factor:g} and {other.factor:g}")
    return wrong


def _exponents(base: Any, seconds: int = 0) -> tuple[int, ...]:
    """Exponents of the base units; an angle counts as a number, as many models mix the two."""
    return tuple(
        int(getattr(base, name)) + (seconds if name == "s" else 0)
        for name in ("kg", "m", "s", "A", "K", "mol", "cd")
    )

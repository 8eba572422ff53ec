"""The files of an FMU: its archive, its binary for this machine, and its description.

A missing binary is compiled from the sources that sources/buildDescription.xml lists in FMI 3.0 and
2.0.4, or modelDescription.xml in FMI 2.0. Compiler options are ignored: each names its own compiler.
"""

from __future__ import annotations

import contextlib
import copy
import ctypes
import itertools
import math
import re
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import fmpy
from fmpy.model_description import ValidationError, read_build_description, read_model_description
from fmpy.validation import validate_model_description

from models.codegen.compiler import find_compiler
from models.errors import MachineError
from validate.fmi.archive import ARCHIVE_CHECKS, DESCRIPTION, FmuError, binary_name, problems
from validate.fmi.description import in_words, understood, unfit, without_garbage
from validate.fmi.instance import CLASSES
from validate.fmi.surroundings import listed
from validate.fmi.units import defined_units
from validate.fmu_check.check import Finding, Scope, check, failed, not_offered, passed, unless
from validate.fmu_check.subject import FmuVariable, Subject

# Names that are legal by either naming convention (FMI 2.0.4, 2.2.9; 3.0.2, 2.4.7.5.1).
_PART = r"[A-Za-z_][A-Za-z_0-9]*(\[[0-9]+(,[0-9]+)*\])?"
_PLAIN = re.compile(rf"{_PART}(\.{_PART})*|der\({_PART}(\.{_PART})*(,[0-9]+)?\)")
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
_BUILD = "sources/buildDescription.xml"
# Headers of the FMI standard, of both versions.
_HEADERS = Path(fmpy.__path__[0], "c-code")
# Time limit of the compiler [s]: large generated models take minutes.
_COMPILE_SECONDS = 300.0


@check("archive", Scope.FILE, clauses=("2.3", "2.5.1"))
def archive(path: Path) -> Finding:
    """A zip file of deflated or stored entries with forward slashes, no links, nothing that leaves its folder."""
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
    """Return the path of the binary for this machine."""
    identifier = subject.interface(kind).modelIdentifier
    return subject.folder / binary_name(subject.description.fmiVersion, identifier)


def _sources_of(subject: Subject, kind: str) -> tuple[list[str], list[str], list[str]]:
    """Return the files and folders below sources/ of a type, and definitions NAME or NAME=VALUE.

    Raises FmuError for XML that cannot be read.
    """
    try:
        described = read_build_description(str(subject.folder), validate=False)
    except Exception as error:  # FMPy raises anything
        raise FmuError(f"{_BUILD} cannot be read ({error})") from error
    identifier = subject.interface(kind).modelIdentifier
    sets = next(
        (
            item.sourceFileSets
            for item in (*described, *subject.description.buildConfigurations)
            if item.modelIdentifier == identifier
        ),
        [],
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
    """Compile an unpacked FMU's binary to `library`; return the name of the compiler.

    Raises FmuError with an error of the compiler, MachineError without a compiler.
    """
    place, compiler = (subject.folder / "sources").resolve(), find_compiler()
    paths = [(place / name).resolve() for name in (*files, *folders)]
    for path, name in zip(paths, (*files, *folders), strict=True):
        if not path.is_relative_to(place) or not path.exists():
            raise FmuError(f"sources/{name} is listed, but missing")
    includes = {place, *paths[len(files) :], _HEADERS}
    command = [
        *(*compiler.command, "-O2", "-w", "-fPIC", "-shared"),
        f"-DFMI{subject.major}_OVERRIDE_FUNCTION_PREFIX",  # names as in a shared library
        *(f"-I{path}" for path in sorted(includes)),
        *(f"-D{text}" for text in definitions),
        *map(str, paths[: len(files)]),
        *("-o", str(library), "-lm"),
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=_COMPILE_SECONDS, check=False
    )
    if done.returncode:
        lines = done.stderr.splitlines() or ["no message"]
        first = next((line for line in lines if "error" in line), lines[0])
        first = first.replace(str(place), "sources")
        raise FmuError(f"{compiler.command[0]} cannot compile it: {first}")
    return Path(compiler.command[0]).name


@check("sources compile", Scope.EACH, clauses=("2.3", "2.5.1.3"))
def compiled(subject: Subject, kind: str) -> Finding:
    """The sources of an FMU without a binary for this machine give one."""
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
    """The binary exports every function of its type, including optional ones."""
    path = library_path(subject, kind)
    name = path.relative_to(subject.folder)
    if not path.is_file():
        return not_offered(f"there is no {name}.")
    try:
        with contextlib.chdir(path.parent):  # as FMPy: it may load libraries beside it
            library = ctypes.CDLL(str(path))
    except OSError:
        return not_offered(f"{name} cannot be loaded: see `starts and ends`.")
    prefix = f"fmi{subject.major}"
    required = {
        name
        for name in dir(CLASSES[subject.major, kind])
        if name.startswith(prefix) and name.removeprefix(prefix)[:1].isupper()
    }
    if missing := sorted(name for name in required if not hasattr(library, name)):
        return failed(f"{len(missing)} missing: {listed(missing)}.")
    return passed(f"all {len(required)} are there.")


@check("description is valid", Scope.FILE, clauses=("2.2", "2.4"))
def valid(path: Path) -> Finding:
    """modelDescription.xml obeys its schema and the rules of FMI (FMPy's validation).

    The binary is called by a C identifier; terminals name variables of the FMU.
    """
    with without_garbage():
        wrong = [" ".join(str(problem).split()).rstrip(".") for problem in _by_fmpy(path)]
        wrong += _of_terminals(path)
    return unless(wrong, "0 problems.")


def _by_fmpy(path: Path) -> list[str]:
    """Return the problems that FMPy's validation finds in an unpacked FMU.

    Only names that are not plain go through its parser, which takes a millisecond each.
    """
    found, description = [], None
    try:
        description = read_model_description(
            str(path), validate=True, validate_model_structure=True
        )
    except ValidationError as error:
        found = list(error.problems)
        with contextlib.suppress(FmuError):  # the reason is in `found`
            description = understood(path)
    except Exception as error:  # noqa: BLE001 - FMPy raises anything
        return [in_words(error)]
    if description is None:
        return found
    named = copy.copy(description)
    named.modelVariables = [
        item for item in description.modelVariables if not _PLAIN.fullmatch(item.name)
    ]
    if named.modelVariables:
        names = validate_model_description(named, validate_variable_names=True)
        found += [problem for problem in names if problem not in found]
    return found + unfit(description)


def _of_terminals(folder: Path) -> list[str]:
    """Return clauses about terminals of an unpacked FMU: duplicate names, unknown variables."""
    file = folder / _TERMINALS
    if not file.is_file():
        return []
    try:
        root = ElementTree.parse(file).getroot()  # an archive with a DOCTYPE is not unpacked
    except (ElementTree.ParseError, ValueError) as error:
        return [f"{_TERMINALS} is no XML that can be read ({error})"]
    try:
        described = ElementTree.parse(folder / DESCRIPTION)
    except ElementTree.ParseError:  # reported by FMPy's validation
        return []
    known = {item.get("name") for item in described.iter() if "valueReference" in item.attrib}
    members = [item.get("variableName") for item in root.iter("TerminalMemberVariable")]
    wrong = [
        f"{_TERMINALS} names the variable {name!r}, which there is not"
        for name in members
        if name not in known
    ]
    for parent in root.iter():
        for kind, attribute in (("Terminal", "name"), ("TerminalMemberVariable", "memberName")):
            names = [item.get(attribute) for item in parent.findall(kind) if item.get(attribute)]
            wrong += [
                f"{_TERMINALS} has the {attribute} {name!r} twice"
                for name in dict.fromkeys(names)
                if names.count(name) > 1
            ]
    return wrong


@check("variables are consistent", Scope.FILE, clauses=("2.2.7", "2.4.7"))
def consistent(subject: Subject) -> Finding:
    """Starts lie within ranges, ranges are not empty, nominals positive, units of derivatives those of states per second."""
    # An alias of FMI 3.0 is only another name; one of FMI 2.0 has a range of its own.
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
    limits = f"range {item.lower:g} .. {item.upper:g}"
    if item.lower > item.upper:
        wrong.append(f"{item.name} has the empty {limits}")
    elif item.start is not None and ((item.start < item.lower) | (item.start > item.upper)).any():
        wrong.append(f"{item.name} starts at {item.start[0]:g}, outside its {limits}")
    if item.start is not None and not all(map(math.isfinite, item.start)):
        wrong.append(f"{item.name} starts at {item.start[0]:g}")
    if item.nominal is not None and not (item.nominal > 0.0 and math.isfinite(item.nominal)):
        wrong.append(f"{item.name} has the nominal {item.nominal:g}; it must be positive")
    return wrong


def _of_aliases(subject: Subject) -> list[str]:
    """Return clauses about variables that share a value, but not its start."""
    first: dict[tuple[int, str], FmuVariable] = {}
    wrong = []
    for item in subject.variables:
        other = first.setdefault(item.key, item)
        if other is item or other.start is None or item.start is None:
            continue
        if (other.start != item.start).any():
            names = f"{other.name} and {item.name}"
            wrong.append(
                f"{names} have one value reference, {item.reference}, but different starts"
            )
    return wrong


def _of_derivatives(subject: Subject) -> list[str]:
    """Return clauses about derivatives whose unit is not that of their state per second."""
    units, wrong = defined_units(subject.description), []
    for rate, state in subject.rates:
        if rate.unit not in units or state.unit not in units:
            continue
        one, expected = units[rate.unit], units[state.unit].per_second()
        clause = f"{rate.name} has the unit {rate.unit}, but is the derivative of {state.name} in {state.unit}"
        if one.powers != expected.powers:
            wrong.append(clause)
        elif not one._replace(offset=0.0).is_same(expected):
            wrong.append(f"{clause}: their factors are {one.factor:g} and {expected.factor:g}")
    return wrong

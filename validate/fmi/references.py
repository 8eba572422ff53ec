"""Files of reference solutions: tables of numbers over time, settings, and the manifest of LS-REF by which an FMU carries them.

    table = read_table("model_ref.csv", text)     # Table(times, {name: (rows, entries)})
    settings = read_settings("model_ref.opt", text)
    # results in the LS-REF folder of an unpacked FMU, and beside the FMU
    found = stored_results(folder, path)

LS-REF is the FMI project's layered standard for files related to an FMU (1.0.0-alpha.1);
`*_ref.csv`, `*_ref.opt`, `*_in.csv` and `*_cc.csv` are how the FMI cross-check named them. Beside
both, `*_ref_error.csv` has the error bar of each number of `*_ref.csv`.
"""

from __future__ import annotations

import csv
import io
import math
import zipfile
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np

from validate.fmi.archive import FmuError, XmlReader

LS_REF = "LS-REF 1.0.0-alpha.1"
FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = "fmi-ls-manifest.xml"
_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
_DESCRIPTION = "Layered Standard providing information on related files included in an FMU."
_ATTRIBUTES = {
    "fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    "fmi-ls-version": "1.0.0-alpha.1",
    "fmi-ls-description": _DESCRIPTION,
}
RESULT = "_ref.csv"
ERROR = "_ref_error.csv"
SETTINGS = "_ref.opt"
INPUT = "_in.csv"
CHECKED = "_cc.csv"
EXPERIMENT = ".exp"
# What each of our files is, for the manifest: MIME type, role, words.
_FILES = {
    RESULT: (
        "text/csv",
        "result",
        "Reference solution of the experiment, with the settings of the .opt file and, where there is one, the input of the _in.csv file",
    ),
    ERROR: ("text/csv", "result", "Error bar of each number of the reference solution"),
    SETTINGS: (
        "text/plain",
        "configuration",
        "Start, stop, step and tolerance of the reference solution",
    ),
    INPUT: ("text/csv", "other", "Input of the reference solution"),
    EXPERIMENT: (
        "application/x-ma-ls-experiments",
        "experiment/validation",
        "The experiment of the reference solution",
    ),
}
# Settings that there must be, as the FMI cross-check named them, and as LS-REF does.
_SETTINGS = {
    "StartTime": "startTime",
    "StopTime": "stopTime",
    "StepSize": "stepSize",
    "RelTol": "tolerance",
}
# Bytes of a file of these that is read.
_MOST_BYTES = 256 * 1024**2
# Lines of a result that is written: each has a time and a value at least, of up to 25 bytes with
# what parts them.
MOST_ROWS = _MOST_BYTES // 50


class Table(NamedTuple):
    """times: (rows,) [s]; columns: name -> (rows, entries) [unit of the variable]."""

    times: np.ndarray
    columns: dict[str, np.ndarray]


@dataclass(frozen=True)
class StoredResult:
    """A result that an FMU carries, or that lies beside it: where, and what belongs to it (None: there is none). experiment: what the .exp file says, else `settings` is the .opt file."""

    where: str
    result: Path
    error: Path | None
    settings: Path | None
    inputs: Path | None
    experiment: dict[str, float] | None = None


def read_table(where: str, text: str, leave_out: Container[str] = ()) -> Table:
    """A table of numbers whose first column is the time.

    The entries of an array are separated by blanks.

    leave_out: columns of other things than numbers. Raises FmuError.
    """
    rows = [row for row in csv.reader(io.StringIO(text)) if any(cell.strip() for cell in row)]
    if rows:
        kept = [place for place, name in enumerate(rows[0]) if name.strip() not in leave_out]
        rows = [[row[place] for place in kept] if len(row) == len(rows[0]) else row for row in rows]
    names = [cell.strip() for cell in rows[0]] if rows else []
    if len(names) < 2 or len(rows) < 2:
        raise FmuError(
            f"{where}: it is no table of numbers; expected a line with `time` and names of variables, and a line of numbers for each time."
        )
    if len(set(names)) < len(names):
        raise FmuError(
            f"{where}: the column {next(name for name in names if names.count(name) > 1)!r} is there twice."
        )
    columns: list[list[list[float]]] = [[] for _ in names]
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(names):
            raise FmuError(
                f"{where}: line {number} has {len(row)} cells, the first line has {len(names)}."
            )
        for name, cell, column in zip(names, row, columns, strict=True):
            place = f"{where}: line {number}, column {name!r}"
            column.append(_numbers(place, cell))
            if len(column[-1]) != len(column[0]):
                raise FmuError(
                    f"{place} has {len(column[-1])} numbers, the line before has {len(column[0])}."
                )
    times = np.array(columns[0])[:, 0]
    backward = np.flatnonzero(~(np.diff(times) >= 0.0))
    if backward.size or not np.isfinite(times).all():
        one, other = times[[backward[0], backward[0] + 1] if backward.size else [0, -1]]
        raise FmuError(
            f"{where}: the first column, {names[0]!r}, is no time that goes on: after {one:g} comes {other:g}."
        )
    return Table(times, dict(zip(names[1:], map(np.array, columns[1:]), strict=True)))


def _numbers(where: str, cell: str) -> list[float]:
    words = {"true": "1", "false": "0"}
    try:
        return [float(words.get(word.lower(), word)) for word in cell.split()] or [float(cell)]
    except ValueError:
        raise FmuError(f"{where} is {cell[:40]!r}, no number.") from None


def table_text(table: Table) -> str:
    """The table as `read_table` reads it, every bit of each number."""
    file = io.StringIO()
    out = csv.writer(file, lineterminator="\n")
    out.writerow(["time", *table.columns])
    for row, time in enumerate(table.times):
        out.writerow(
            [
                repr(float(time)),
                *(
                    " ".join(repr(float(value)) for value in column[row])
                    for column in table.columns.values()
                ),
            ]
        )
    return file.getvalue()


def read_settings(where: str, text: str) -> dict[str, float]:
    """StartTime, StopTime, StepSize [s] (0: the solver's) and RelTol [-] of a cross-check.

    Raises FmuError.
    """
    found: dict[str, float] = {}
    for line in text.splitlines():
        name, _, value = line.partition(",")
        if name.strip() in _SETTINGS:
            found[name.strip()] = _numbers(f"{where}: {name.strip()}", value)[0]
    for name in _SETTINGS:
        if name not in found:
            raise FmuError(f"{where}: {name} is missing; expected a line `{name}, NUMBER`.")
        if not math.isfinite(found[name]) or (name in ("StepSize", "RelTol") and found[name] < 0.0):
            raise FmuError(f"{where}: {name} is {found[name]:g}.")
    if found["StopTime"] <= found["StartTime"]:
        raise FmuError(
            f"{where}: StopTime is {found['StopTime']:g}, not after StartTime, {found['StartTime']:g}."
        )
    return found


def settings_text(settings: Mapping[str, float]) -> str:
    """The settings as `read_settings` reads them."""
    return "".join(f"{name}, {settings[name]!r}\n" for name in _SETTINGS)


def read_text(path: Path) -> str:
    """Raises FmuError."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise FmuError(
                f"{path.name}: it is larger than {_MOST_BYTES // 1024**2} MB, and is not read."
            )
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise FmuError(f"{path.name}: it cannot be read ({error}).") from error


def beside(path: Path) -> StoredResult:
    """What lies, or would lie, beside a file `NAME.fmu` as the cross-check names it."""
    return _result(path.with_name(path.stem + RESULT), path.stem + RESULT)


def _result(result: Path, where: str) -> StoredResult:
    stem = result.stem.removesuffix("_ref").removesuffix("_out")
    paths = (
        result.with_name(name)
        for name in (f"{result.stem}_error.csv", f"{stem}{SETTINGS}", f"{stem}{INPUT}")
    )
    error, settings, inputs = (path if path.is_file() else None for path in paths)
    return StoredResult(where, result, error, settings, inputs)


def stored_results(folder: Path, path: Path) -> Iterator[StoredResult | FmuError]:
    """Results of an FMU: of experiments in its LS-REF manifest, others there, and `NAME_ref.csv` beside it; an FmuError where one that is named cannot be had.

    folder: the unpacked FMU; path: its file. Raises FmuError for a manifest that cannot be read.
    """
    manifest = folder / FOLDER / MANIFEST
    related = (
        [dict(item.attrib) for item in _parsed(manifest).iter("Related")]
        if manifest.is_file()
        else []
    )
    tried: set[Path] = set()
    for item in related:
        if item.get("role", "").startswith("experiment") and item.get("source", "").endswith(
            EXPERIMENT
        ):
            try:
                for result in _experiments(folder, item["source"]):
                    tried.add(result.result)
                    yield result
            except FmuError as error:
                yield error
    for item in related:
        source = item.get("source", "")
        if (
            item.get("role") == "result"
            and source.endswith(".csv")
            and not source.endswith("_error.csv")
        ):
            try:
                named = _named(folder, manifest, "result", source)
            except FmuError as error:
                yield error
                continue
            if named not in tried:
                yield _result(named, _where(folder, named))
    if beside(path).result.is_file():
        yield beside(path)


def _experiments(folder: Path, source: str) -> Iterator[StoredResult]:
    """Those of a file that name results. Raises FmuError."""
    place = _named(folder, folder / FOLDER / MANIFEST, "experiment", source)
    for item in _parsed(place, "Experiments").iter("Experiment"):
        where = f"{_where(folder, place)}, {item.get('name', 'an experiment')!r}"
        stimuli, references = item.find("Stimuli"), item.find("References")
        if references is None:
            continue
        result = _named(folder, place, "reference", references.get("source", ""))
        text = {
            name: item.get(attribute, "1e-4" if name == "RelTol" else "0")
            for name, attribute in _SETTINGS.items()
        }
        settings = read_settings(
            where, "".join(f"{name}, {value}\n" for name, value in text.items())
        )
        inputs = (
            None if stimuli is None else _named(folder, place, "stimuli", stimuli.get("source", ""))
        )
        yield replace(
            _result(result, _where(folder, result)),
            settings=None,
            inputs=inputs,
            experiment=settings,
        )


def _named(folder: Path, by: Path, what: str, source: str) -> Path:
    """The file that a file of an unpacked FMU names. Raises FmuError where it is not there."""
    named = (by.parent / unquote(source)).resolve()
    if not named.is_relative_to(folder.resolve()) or not named.is_file():
        raise FmuError(f"{_where(folder, by)} names the {what} {source!r}, which is not in the FMU")
    return named


def _where(folder: Path, path: Path) -> str:
    return path.resolve().relative_to(folder.resolve()).as_posix()


def _parsed(
    path: Path, root_name: str = "fmiReferences", text: bytes | None = None
) -> ElementTree.Element:
    """The root of an XML file, or of its text. Raises FmuError."""
    text = path.read_bytes() if text is None else text
    try:
        XmlReader().read(text)  # no DOCTYPE
        root = ElementTree.fromstring(text)
    except Exception as error:  # of expat, of an encoding, HasDoctype
        raise FmuError(
            f"{FOLDER}/{path.name} is no XML that can be read ({error or 'it has a DOCTYPE'})"
        ) from error
    if root.tag != root_name:
        raise FmuError(f"{FOLDER}/{path.name} begins with <{root.tag}> instead of <{root_name}>")
    return root


def missing_attributes(folder: Path) -> list[str]:
    """Which attributes that LS-REF demands the manifest of an unpacked FMU does not have.

    Raises FmuError.
    """
    manifest = folder / FOLDER / MANIFEST
    if not manifest.is_file():
        return []
    root = _parsed(manifest)
    return [name for name in _ATTRIBUTES if not root.get(f"{{{_NAMESPACE}}}{name}")]


def held(fmu: Path, stem: str) -> list[str]:
    """Files that `with_references` would replace, by their names in the FMU."""
    with zipfile.ZipFile(fmu) as packed:
        names = set(packed.namelist())
    return [name for name in (f"{FOLDER}/{stem}{ending}" for ending in _FILES) if name in names]


def with_references(fmu: Path, stem: str, texts: Mapping[str, str]) -> bytes:
    """The FMU's file with texts in its LS-REF folder, and named in its manifest, where whatever else it names stays.

    stem: how the files' names begin; texts: ending (RESULT, ERROR, SETTINGS, INPUT) -> content.
        Raises FmuError.
    """
    ElementTree.register_namespace("fmi-ls", _NAMESPACE)
    made = io.BytesIO()
    with zipfile.ZipFile(fmu) as packed, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as out:
        items = {item.filename: item for item in packed.infolist()}
        manifest = f"{FOLDER}/{MANIFEST}"
        root = (
            _parsed(Path(manifest), text=packed.read(manifest))
            if manifest in items
            else ElementTree.Element("fmiReferences")
        )
        for name, value in _ATTRIBUTES.items():
            root.set(f"{{{_NAMESPACE}}}{name}", value)
        sources = [f"{stem}{ending}" for ending in _FILES]
        for old in [item for item in root.findall("Related") if item.get("source") in sources]:
            root.remove(old)
        for ending in texts:
            kind, role, words = _FILES[ending]
            related = ElementTree.Element(
                "Related", type=kind, source=f"{stem}{ending}", role=role, description=words
            )
            root.insert(len(root.findall("Related")), related)
        ElementTree.indent(root)
        new = {manifest: ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)}
        new |= {f"{FOLDER}/{stem}{ending}": text.encode() for ending, text in texts.items()}
        gone = {*new, *(f"{FOLDER}/{source}" for source in sources)}
        for name, item in items.items():
            if name not in gone:
                out.writestr(item, packed.read(item))
        for name, data in new.items():
            out.writestr(name, data)
    return made.getvalue()


def experiment_text(stem: str, settings: Mapping[str, float], with_inputs: bool) -> str:
    """The experiment as LS-REF's .exp files have it."""
    root = ElementTree.Element("Experiments", name=stem)
    item = ElementTree.SubElement(
        root,
        "Experiment",
        {"name": stem, **{_SETTINGS[name]: repr(value) for name, value in settings.items()}},
    )
    if with_inputs:
        ElementTree.SubElement(item, "Stimuli", source=f"{stem}{INPUT}", type="text/csv")
    ElementTree.SubElement(item, "References", source=f"{stem}{RESULT}", type="text/csv")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)


def columns_of(
    names: Sequence[str], sizes: Sequence[int], values: np.ndarray
) -> dict[str, np.ndarray]:
    """(rows, entries) values, split into the columns of a Table [unit of each variable].

    Raises ValueError where the sizes do not add up.
    """
    return dict(zip(names, np.split(values, np.cumsum(sizes)[:-1], axis=1), strict=True))

"""The archive of an FMU: checks before anything of it is unpacked or loaded.

    archive = check_archive(path)     # raises ArchiveError for the first problem
    problems(path)                    # all problems that can be found
    unpack(archive, folder)           # bounded by the checked sizes

A problem is one sentence. A DOCTYPE is refused: its entities can read files and fill the memory.
"""

from __future__ import annotations

import hashlib
import platform
import re
import stat
import sys
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from lzma import LZMAError
from pathlib import Path, PurePosixPath
from xml.parsers import expat

from models.errors import MachineError, TouchstoneError

# Unpacked bytes of all entries.
MOST_UNPACKED = 2 * 1024**3
# Entries of an archive.
MOST_ENTRIES = 20_000
# Bytes of one XML text.
MOST_XML = 64 * 1024**2
# Unpacked over packed size; deflate of text reaches 20.
MOST_RATIO = 100.0
# Unpacked bytes from which the ratio is checked: less harms no machine.
RATIO_MATTERS_FROM = 32 * 1024**2
_ROOT = "fmiModelDescription"
# Short name of an interface -> its name in FMI.
INTERFACES = {"ME": "ModelExchange", "CS": "CoSimulation"}


class HasDoctype(Exception):  # noqa: N818 - it ends the reading
    """The XML text has a DOCTYPE."""


class XmlReader:
    """Reads the root of an XML text and the interfaces of a model description."""

    def __init__(self) -> None:
        self.root: dict[str, str] = {}
        self.root_name = ""
        self.kinds: dict[str, dict[str, str]] = {}

    def read(self, text: bytes) -> None:
        """Parse one XML text.

        Raises HasDoctype, ExpatError for a text that is not well-formed, LookupError for an unknown
        encoding.
        """
        parser = self._parser = expat.ParserCreate()
        parser.StartDoctypeDeclHandler = self._doctype
        parser.StartElementHandler = self._element
        parser.Parse(text, True)

    def _doctype(self, *_: object) -> None:
        raise HasDoctype

    def _element(self, name: str, attributes: dict[str, str]) -> None:
        if not self.root_name:
            self.root_name, self.root = name, attributes
        elif name in INTERFACES.values():
            self.kinds.setdefault(name, attributes)
        # Interfaces come before the variables, of which there may be hundreds of thousands.
        if name == "ModelVariables" or self.root_name != _ROOT:
            self._parser.StartElementHandler = None


def interfaces(text: bytes) -> dict[str, dict[str, str]]:
    """Return the attributes of each interface of a model description; FMPy does not read all."""
    reader = XmlReader()
    reader.read(text)
    return reader.kinds


DESCRIPTION = "modelDescription.xml"
# Endings of texts that we or FMPy parse as XML.
_XML_SUFFIXES = (".xml", ".ssd", ".ssv", ".ssm", ".ssb")
# Exceptions of Python for a damaged entry.
_DAMAGED = (NotImplementedError, EOFError, RuntimeError, ValueError, zlib.error, LZMAError)
_MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
_ENDINGS = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}


# Checks of the archive's entries. Other checks are zip, description, version, kind, identifier and
# binary.
ARCHIVE_CHECKS = ("size", "ratio", "entries", "names", "links", "duplicates", "encryption", "xml")


class FmuError(TouchstoneError):
    """An FMU cannot be opened or does not offer what is needed."""


class ArchiveError(FmuError):
    """A problem for which an FMU file is refused; check: the name of the failed check."""

    def __init__(self, check: str, sentence: str) -> None:
        super().__init__(sentence)
        self.check = check


@dataclass(frozen=True, kw_only=True)
class FmuArchive:
    """An FMU file that was accepted.

    digest: SHA-256 of the file.
    version: of FMI, for example 2.0.
    kinds: interface -> its attributes, of those with a binary for this platform.
    unpacked: size of all entries [bytes].
    """

    path: Path
    digest: str
    version: str
    kinds: dict[str, dict[str, str]]
    unpacked: int


def check_archive(path: Path, *, but_for: Sequence[str] = ()) -> FmuArchive:
    """Check an FMU file; but_for: checks that may fail.

    Raises ArchiveError for the first problem, MachineError if the file cannot be read.
    """
    check = _ArchiveCheck(path)
    for problem in check.problems():
        if problem.check not in but_for:
            raise problem
    return check.archive()


def problems(path: Path) -> tuple[ArchiveError, ...]:
    """Return all problems that can be found; one that makes the rest unreadable is last."""
    return tuple(_ArchiveCheck(path).problems())


def unpack(archive: FmuArchive, folder: Path, leave_out: tuple[str, ...] = ()) -> None:
    """Unpack a checked file, without entries whose names begin with one of `leave_out`.

    Raises ArchiveError if the file has changed, MachineError if the disk refuses.
    """
    try:
        with zipfile.ZipFile(archive.path) as packed:
            if sum(item.file_size for item in packed.infolist()) != archive.unpacked:
                raise ArchiveError(
                    "zip", f"FMU {archive.path}: the file changed while it was read; try again."
                )
            members = [
                item for item in packed.infolist() if not item.filename.startswith(leave_out)
            ]
            packed.extractall(folder, members)  # reads at most the stated size of an entry
    except (zipfile.BadZipFile, *_DAMAGED) as error:
        raise ArchiveError(
            "zip", f"FMU {archive.path}: it cannot be unpacked ({_first(error)}); it is damaged."
        ) from error
    except OSError as error:
        raise MachineError(
            f"FMU {archive.path}: it cannot be unpacked to {folder} ({error.strerror or error}); make room there or permit it, or set TMPDIR."
        ) from error


class _ArchiveCheck:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._items: list[zipfile.ZipInfo] = []
        self._root: dict[str, str] = {}
        self._kinds: dict[str, dict[str, str]] = {}
        self._names: set[str] = set()

    def archive(self) -> FmuArchive:
        """Return the archive, if there are no problems."""
        present = {
            kind: interface
            for kind, interface in self._kinds.items()
            if self._library(interface) in self._names
        }
        with open(self._path, "rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        unpacked = sum(item.file_size for item in self._items)
        return FmuArchive(
            path=self._path,
            digest=digest,
            version=self._root.get("fmiVersion", ""),
            kinds=present,
            unpacked=unpacked,
        )

    def problems(self) -> Iterator[ArchiveError]:
        """Yield all problems; unsafe entries end the reading."""
        try:
            if not self._path.is_file():
                yield self._problem(
                    "zip",
                    "it is a folder; an FMU is a file."
                    if self._path.exists()
                    else "there is no such file.",
                )
                return
            with zipfile.ZipFile(self._path) as archive:
                self._items = archive.infolist()
                unsafe = list(self._of_entries())
                yield from unsafe
                if all(problem.check == "duplicates" for problem in unsafe):
                    yield from self._of_content(archive)
        except zipfile.BadZipFile:
            yield self._problem("zip", "it is not a zip file, as every FMU is (or it is cut off).")
        except _DAMAGED as error:
            yield self._problem("zip", f"it is a zip file that cannot be read ({_first(error)}).")
        except OSError as error:
            raise MachineError(
                f"FMU {self._path}: it cannot be read ({error.strerror or error})."
            ) from error

    def _problem(self, check: str, text: str) -> ArchiveError:
        return ArchiveError(check, f"FMU {self._path}: {text}")

    def _of_entries(self) -> Iterator[ArchiveError]:
        items = self._items
        unpacked = sum(item.file_size for item in items)
        packed = max(1, self._path.stat().st_size)
        if len(items) > MOST_ENTRIES:
            yield self._problem(
                "entries",
                f"it holds {len(items)} files, more than the {MOST_ENTRIES} that are allowed.",
            )
        if unpacked > MOST_UNPACKED:
            yield self._problem(
                "size",
                f"unpacked it has {_size(unpacked)}, more than the {_size(MOST_UNPACKED)} that are allowed.",
            )
        if unpacked > RATIO_MATTERS_FROM and unpacked > MOST_RATIO * packed:
            yield self._problem(
                "ratio",
                f"{_size(packed)} unpack to {_size(unpacked)}, {unpacked / packed:.0f} times as much; from {MOST_RATIO:.0f} times on it is taken for a zip bomb.",
            )
        for item in items:
            yield from self._of_entry(item)
        names = Counter(item.filename.rstrip("/") for item in items)
        for name, count in names.items():
            if count > 1:
                yield self._problem(
                    "duplicates", f"the entry {name!r} is there {count} times; the last one counts."
                )
        files = {item.filename for item in items if not item.filename.endswith("/")}
        for name in files:
            inside = next(
                (str(parent) for parent in PurePosixPath(name).parents if str(parent) in files),
                None,
            )
            if inside is not None:
                yield self._problem(
                    "names", f"the entry {inside!r} is both a file and the folder of {name!r}."
                )

    def _of_entry(self, item: zipfile.ZipInfo) -> Iterator[ArchiveError]:
        name = item.orig_filename
        kind = stat.S_IFMT(item.external_attr >> 16)
        if "\\" in name:
            yield self._problem(
                "names",
                f"the entry {name!r} has a backslash in its name; FMI wants forward slashes.",
            )
        elif not name or "\0" in name:
            yield self._problem("names", f"the entry {name!r} has no proper name.")
        elif name.startswith("/") or re.match(r"[A-Za-z]:", name):
            yield self._problem(
                "names",
                f"the entry {name!r} has an absolute path; it would be unpacked outside its folder.",
            )
        elif ".." in PurePosixPath(name).parts:
            yield self._problem("names", f"the entry {name!r} leads out of its folder.")
        if stat.S_ISLNK(kind):
            yield self._problem("links", f"the entry {name!r} is a symbolic link.")
        elif kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            yield self._problem("links", f"the entry {name!r} is neither a file nor a folder.")
        if item.flag_bits & 0x1:
            yield self._problem("encryption", f"the entry {name!r} is encrypted.")

    def _of_content(self, archive: zipfile.ZipFile) -> Iterator[ArchiveError]:
        self._names = {item.filename for item in self._items}
        texts = (item for item in self._items if item.filename.lower().endswith(_XML_SUFFIXES))
        dangerous = False
        for problem in (problem for item in texts for problem in self._of_xml(archive, item)):
            dangerous = True
            yield problem  # before the next text is read, which may be damaged
        if dangerous:
            return
        if DESCRIPTION in self._names:
            yield from self._of_description()
        else:
            hint = next((name for name in self._names if name.endswith(f"/{DESCRIPTION}")), None)
            also = f"; there is one at {hint!r}, but it must lie at the top" if hint else ""
            yield self._problem("description", f"it has no {DESCRIPTION}, so it is no FMU{also}.")

    def _of_xml(self, archive: zipfile.ZipFile, item: zipfile.ZipInfo) -> Iterator[ArchiveError]:
        if item.file_size > MOST_XML:
            yield self._problem(
                "size",
                f"{item.filename} has {_size(item.file_size)}, more than the {_size(MOST_XML)} that are allowed.",
            )
            return
        is_description = item.filename == DESCRIPTION
        reader = XmlReader()
        try:
            reader.read(archive.read(item))
        except HasDoctype:
            yield self._problem(
                "xml",
                f"{item.filename} has a DOCTYPE, which FMI does not allow (its entities can read files and fill the memory).",
            )
        except (expat.ExpatError, LookupError) as error:  # LookupError: an unknown encoding
            if is_description:
                yield self._problem(
                    "description", f"{DESCRIPTION} is not well-formed XML ({error})."
                )
        if is_description:
            self._root, self._kinds = reader.root, reader.kinds
            if reader.root_name not in ("", _ROOT):
                yield self._problem(
                    "description",
                    f"{DESCRIPTION} begins with <{reader.root_name}> instead of <{_ROOT}>.",
                )

    def _of_description(self) -> Iterator[ArchiveError]:
        version = self._root.get("fmiVersion", "")
        if version != "2.0" and not is_version(version, 3):
            yield self._problem(
                "version", f"it says FMI version {version!r}; 2.0 and 3.0 can be run."
            )
            return
        if not self._kinds:
            yield self._problem("kind", "it offers neither Model Exchange nor Co-Simulation.")
            return
        for wrong in wrong_identifiers(
            interface.get("modelIdentifier") for interface in self._kinds.values()
        ):
            yield self._problem("identifier", f"{wrong}.")
        if not any(self._library(interface) in self._names for interface in self._kinds.values()):
            interface = next(iter(self._kinds.values()))
            there = sorted(
                {
                    PurePosixPath(name).parts[1]
                    for name in self._names
                    if re.match(r"binaries/[^/]+/.", name)
                }
            )
            has = ", ".join(there) or "none at all"
            yield self._problem(
                "binary",
                f"it has no binary for this machine ({self._library(interface)}); it has {has}.",
            )

    def _library(self, interface: dict[str, str]) -> str:
        return binary_name(self._root.get("fmiVersion", ""), interface.get("modelIdentifier", ""))


# The name of a file has 255 bytes at most (NAME_MAX of Linux, NTFS and APFS); the longest ending is
# .dylib.
_LONGEST_IDENTIFIER = 249


def wrong_identifiers(identifiers: Iterable[str | None]) -> list[str]:
    """Return clauses about modelIdentifiers that are no file names: paths are made of them."""
    wrong = []
    for text in dict.fromkeys(identifiers):
        if not re.fullmatch(rf"[A-Za-z_]\w{{,{_LONGEST_IDENTIFIER - 1}}}", text or "", re.ASCII):
            shown = (
                "missing"
                if text is None
                else ascii(text)
                if len(text) < 100
                else f"{text[:40]!a}.., {len(text)} letters"
            )
            wanted = f"a C identifier of at most {_LONGEST_IDENTIFIER} letters, as the binary is called by it"
            wrong.append(
                f"{DESCRIPTION}: modelIdentifier is {shown}; expected {wanted} (FMI 2.0.4, 2.3; 3.0.2, 2.5.1); export it again"
            )
    return wrong


def binary_name(version: str, identifier: str) -> str:
    """Return the path of the binary for this machine; FMI 3 changed the names of machines."""
    system, machine = platform.system().lower(), platform.machine().lower()
    if is_version(version, 3):
        folder = f"{_MACHINES.get(machine, machine)}-{system}"
    else:
        folder = (
            f"{'win' if system == 'windows' else system}{'64' if sys.maxsize > 2**32 else '32'}"
        )
    return f"binaries/{folder}/{identifier}{_ENDINGS.get(system, '.so')}"


def is_version(text: str, major: int) -> bool:
    """Return whether a version of FMI, as 3.0.2, is one of the standard; 3.0-beta.3 is none."""
    return re.fullmatch(rf"{major}\.0(\.\d+)?", text) is not None


def _size(count: int) -> str:
    return f"{count / 1024**3:.3g} GB" if count >= 1024**3 else f"{count / 1024**2:.3g} MB"


def _first(error: BaseException) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)

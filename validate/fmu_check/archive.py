"""The file: what the intake has to say, how it is packed, and the binary for this machine."""

from __future__ import annotations

import platform
import sys
import zipfile
from pathlib import Path

from validate.fmu_check.elf import NotElf, read_library
from validate.fmu_check.result import Finding, Scope, check, failed, listed, not_offered, passed
from validate.fmu_check.subject import Subject
from validate.isolation.intake import platform_folder, problems

# Of the intake's checks: those about the archive as such.
ARCHIVE_CHECKS = ("size", "ratio", "entries", "names", "links", "duplicates", "encryption", "xml")
_METHODS = {zipfile.ZIP_STORED: "stored", zipfile.ZIP_DEFLATED: "deflated"}
# Libraries that every Linux has; with others the FMU runs only where they are installed, or in the FMU.
_EVERYWHERE = ("libc.so", "libm.so", "libpthread.so", "libdl.so", "librt.so", "libgcc_s.so", "libstdc++.so", "ld-linux", "linux-vdso")


@check("archive", "a zip file of deflated or stored entries with forward slashes, no links, nothing that leaves its folder", Scope.FILE)
def archive(path: Path) -> Finding:
    """Looks at the file only: comes before anything is unpacked."""
    wrong = [problem.sentence.removeprefix(f"FMU {path}: ").rstrip(".") for problem in problems(path) if problem.check in ARCHIVE_CHECKS]
    with zipfile.ZipFile(path) as packed:
        items = packed.infolist()
    wrong += [
        f"the entry {item.filename!r} is packed by a method other than deflate" for item in items if item.compress_type not in _METHODS
    ]
    if wrong:
        return failed(f"{listed(wrong)}.")
    unpacked = sum(item.file_size for item in items)
    return passed(f"{len(items)} entries, {path.stat().st_size} bytes, {unpacked} unpacked.")


def library_path(subject: Subject, kind: str) -> Path:
    """Where the binary for this machine must be."""
    ending = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    folder = platform_folder(subject.description.fmiVersion)
    return subject.folder / "binaries" / folder / f"{subject.interface(kind).modelIdentifier}{ending}"


@check("exported functions", "the binary exports every function of its type, as the standard demands of optional ones, too", Scope.EACH)
def exports(subject: Subject, kind: str) -> Finding:
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
        return failed(f"{path.relative_to(subject.folder)} is for {library.machine}, but this platform is {machine}.")
    missing = sorted(_required(subject, kind) - library.exported)
    if missing:
        return failed(f"{len(missing)} missing: {', '.join(missing[:6])}{' and more' if len(missing) > 6 else ''}.")
    foreign = [name for name in library.needed if not name.startswith(_EVERYWHERE) and not (path.parent / name).exists()]
    needs = f", needs {', '.join(foreign)} of the machine" if foreign else ""
    return passed(f"all {len(_required(subject, kind))} are there{f', glibc {library.glibc} or newer' if library.glibc else ''}{needs}.")


def _required(subject: Subject, kind: str) -> set[str]:
    """Names of the functions of a type of FMI."""
    from fmpy.fmi2 import FMU2Model, FMU2Slave
    from fmpy.fmi3 import FMU3Model, FMU3Slave

    interface = {(2, "ME"): FMU2Model, (2, "CS"): FMU2Slave, (3, "ME"): FMU3Model, (3, "CS"): FMU3Slave}[subject.major, kind]
    return {name for name in dir(interface) if name.startswith(f"fmi{subject.major}") and name[4:5].isupper()}

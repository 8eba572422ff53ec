"""The versions of FMI that are offered, and the headers of the standard."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

from models.errors import MachineError, UnknownNameError


@dataclass(frozen=True)
class Standard:
    """One version of FMI and how its files differ.

    prefix: of its functions and of the shell's files; headers: names of the standard's files; header_folder: where they lie
    within `sources` ("" or with a slash at its end); first_index: number of the first variable in the ModelStructure.
    """

    version: str
    prefix: str
    headers: tuple[str, ...]
    header_folder: str
    first_index: int


# FMI 3.0 wants its headers from the importer: ours stay in a folder of their own, which an importer may leave out.
STANDARDS = {
    standard.version: standard
    for standard in (
        Standard("2.0", "fmi2", ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"), "", 1),
        Standard("3.0", "fmi3", ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"), "standard/", 0),
    )
}


def find_standard(version: str) -> Standard:
    """The standard of a version, "2.0" or "3.0". Raises UnknownNameError for another one."""
    if version not in STANDARDS:
        raise UnknownNameError(f"FMI version {version!r} is not offered; choose {' or '.join(STANDARDS)}.")
    return STANDARDS[version]


def standard_headers(standard: Standard) -> dict[str, str]:
    """The headers of the FMI standard, taken from the FMPy package. Raises MachineError if it is not installed."""
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise MachineError("the headers of the FMI standard are missing: they come with FMPy; install it with: pip install fmpy")
    folder = Path(spec.origin).parent / "c-code"
    try:
        return {name: (folder / name).read_text(encoding="utf-8") for name in standard.headers}
    except OSError as error:
        raise MachineError(
            f"the headers of the FMI standard cannot be read from FMPy ({error}); reinstall it with: pip install --force-reinstall fmpy"
        ) from error

"""An accepted FMU: FMPy's description, its abilities, and its unpacked folder.

package = read_package(path)
package.description.modelVariables
package.can("ModelExchange", "providesDirectionalDerivatives")
with unpacked(package) as package: ...
"""

from __future__ import annotations

import gc
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from validate.fmi.archive import (
    DESCRIPTION,
    FmuArchive,
    FmuError,
    check_archive,
    unpack,
    wrong_identifiers,
)
from validate.processes.disk import temporary_folder

# The types of a number in FMI 2.0 and 3.0.
REAL = ("Real", "Float64")
# Folders that an FMU does not read when it runs: it gets the path of its resources alone.
NOT_RUN = ("documentation/", "sources/", "terminalsAndIcons/")


@dataclass(frozen=True, kw_only=True)
class Package(FmuArchive):
    """An accepted FMU; description: FMPy's; folder: where it is unpacked, if it is."""

    description: Any
    folder: Path | None = None

    @property
    def is_three(self) -> bool:
        """Return whether the FMU is of FMI 3.0."""
        return self.version.startswith("3.")

    def can(self, kind: str, ability: str) -> bool:
        """Return whether "ModelExchange" or "CoSimulation" claims an ability.

        ability: name in this version of FMI.
        """
        return self.kinds.get(kind, {}).get(ability) in ("true", "1")

    @property
    def exchange(self) -> Any | None:
        """FMPy's description of Model Exchange; None if it cannot run here."""
        return self.description.modelExchange if "ModelExchange" in self.kinds else None

    @property
    def cosimulation(self) -> Any | None:
        """FMPy's description of Co-Simulation; None if it cannot run here."""
        return self.description.coSimulation if "CoSimulation" in self.kinds else None


def experiment(description: Any, name: str) -> float | None:
    """Return a number of the default experiment, as "tolerance" [-], or None if it is unusable.

    Times are finite; tolerance and stepSize are also positive.
    """
    text = getattr(description.defaultExperiment, name, None)
    try:
        value = float(text) if text is not None else math.nan
    except ValueError:
        return None
    is_usable = math.isfinite(value) and (value > 0.0 or name in ("startTime", "stopTime"))
    return value if is_usable else None


def interface_of(description: Any, kind: str) -> Any:
    """Return FMPy's description of an interface, "ME" or "CS", or None if it is not offered."""
    return {"ME": description.modelExchange, "CS": description.coSimulation}[kind]


@contextmanager
def without_garbage() -> Iterator[None]:
    """Switch off garbage collection.

    Garbage collection took a third of the time for 400,000 variables, and found nothing.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def in_words(error: Exception) -> str:
    """Return a clause about FMPy's error for a description; FMPy raises Python's exceptions."""
    text = " ".join(str(error).split()).rstrip(".")
    match error:
        case KeyError(args=[int(reference)]):
            return f"{DESCRIPTION} names the value reference {reference}, which no variable has"
        case IndexError():
            return f"{DESCRIPTION} names a variable by an index that is none: its ModelStructure counts more variables than there are"
        case ValueError() if quoted := re.search(r": ('.*')$", text):
            return f"{DESCRIPTION} has {quoted[1]} where a number must be"
        case TypeError() | AttributeError() | UnboundLocalError():
            return f"{DESCRIPTION} lacks an element or attribute that must be there"
        case KeyError():
            return f"{DESCRIPTION} has {text}, which FMI does not know"
        case _:
            return f"{DESCRIPTION} cannot be understood: {text}"


def understood(path: Path) -> Any:
    """Return FMPy's description of an FMU or an unpacked folder, without validation.

    Raises FmuError, a clause without full stop.
    """
    import fmpy  # 0.04 s

    try:
        with without_garbage():
            return fmpy.read_model_description(str(path), validate=False)
    except Exception as error:  # noqa: BLE001 - FMPy raises anything for what it does not understand
        # FMPy's frames would hold the file open.
        raise FmuError(in_words(error)) from error.with_traceback(None)


def unfit(description: Any) -> list[str]:
    """Return clauses about a description by which an FMU cannot be run.

    C takes the last 32 bits of a value reference, which are another variable's. FMPy takes the last
    of two elements of one interface, the archive the first: both identifiers are checked.
    """
    offered = (interface_of(description, kind) for kind in ("ME", "CS"))
    wrong = wrong_identifiers(
        interface.modelIdentifier for interface in offered if interface is not None
    )
    wide = next(
        (item for item in description.modelVariables if not 0 <= item.valueReference < 2**32), None
    )
    if wide is not None:
        wrong.append(
            f"{DESCRIPTION}: {wide.name!r} has the value reference {wide.valueReference}; expected a number from 0 to {2**32 - 1}"
        )
    return wrong


def read_description(path: Path) -> Any:
    """Return FMPy's description of an FMU that is to be run.

    Raises FmuError, a clause without full stop, if it is `unfit`; as `understood`.
    """
    description = understood(path)
    for wrong in unfit(description):
        raise FmuError(wrong)
    return description


def read_package(path: Path) -> Package:
    """Check and describe an FMU, without unpacking it.

    Raises ArchiveError, FmuError, MachineError.
    """
    archive = check_archive(path)
    try:
        description = read_description(path)
    except FmuError as error:
        raise FmuError(f"FMU {path}: {error}.") from error
    package = Package(**vars(archive), description=description)
    if package.exchange is None and package.cosimulation is None:
        raise FmuError(f"FMU {path}: it offers neither Model Exchange nor Co-Simulation.")
    return package


@contextmanager
def unpacked(package: Package) -> Iterator[Package]:
    """Unpack a package, without folders that a running FMU does not read; remove them afterwards.

    An unpacked package is returned unchanged.
    """
    if package.folder is not None:
        yield package
        return
    with temporary_folder("touchstone-replay-") as folder:
        unpack(package, folder, leave_out=NOT_RUN)
        yield replace(package, folder=folder)

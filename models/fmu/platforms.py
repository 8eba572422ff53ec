"""Platforms an FMU may carry binaries for, and the compiler that makes them.

The binaries of this machine's platform need any C compiler; those of others, and Linux binaries that run on any glibc since
2.17, need the cross-compiler of the `[compiler]` extra.
"""

from __future__ import annotations

import importlib.util
import os
import platform as machine
import sys
from collections.abc import Iterable
from dataclasses import dataclass

from models.codegen.compiler import FLAGS, Compiler, find_compiler, zig_compiler
from models.errors import MachineError, UnknownNameError
from models.fmu.description import Standard


@dataclass(frozen=True)
class Platform:
    """name: FMI 3.0's platform tuple; fmi2: FMI 2.0's name; suffix of shared libraries; target: in the cross-compiler's words."""

    name: str
    fmi2: str
    suffix: str
    target: str

    def folder(self, standard: Standard) -> str:
        """Its folder within `binaries`."""
        return self.fmi2 if standard.version == "2.0" else self.name

    @property
    def flags(self) -> tuple[str, ...]:
        """Compiler flags; on Windows all code is position-independent, and the flag that says so is an error."""
        return tuple(flag for flag in FLAGS if flag != "-fPIC") if self.suffix == ".dll" else FLAGS


PLATFORMS = (
    Platform("x86_64-linux", "linux64", ".so", "x86_64-linux-gnu.2.17"),
    Platform("aarch64-linux", "aarch64-linux", ".so", "aarch64-linux-gnu.2.17"),
    Platform("x86_64-windows", "win64", ".dll", "x86_64-windows-gnu"),
    Platform("x86_64-darwin", "darwin64", ".dylib", "x86_64-macos.11.0"),
    Platform("aarch64-darwin", "aarch64-darwin", ".dylib", "aarch64-macos.11.0"),
)
_SYSTEMS = {"linux": "linux", "win32": "windows", "darwin": "darwin"}
_ARCHITECTURES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


def this_platform() -> str | None:
    """FMI 3.0's name of this machine, or None if it is not one of PLATFORMS."""
    system, architecture = _SYSTEMS.get(sys.platform), _ARCHITECTURES.get(machine.machine().lower())
    name = f"{architecture}-{system}"
    return name if name in {known.name for known in PLATFORMS} else None


def find_platforms(names: Iterable[str]) -> tuple[Platform, ...]:
    """The platforms of these names (of FMI 2.0 or 3.0), each once, in the order of PLATFORMS; this machine's if none is named.

    Raises UnknownNameError for an unknown name, MachineError if this machine is none of them and none is named.
    """
    wanted = list(names)
    if not wanted:
        own = this_platform()
        if own is None:
            raise MachineError(f"this machine ({sys.platform} {machine.machine()}) is no platform of FMI; name one with --platform.")
        wanted = [own]
    for name in wanted:
        if not any(name in (known.name, known.fmi2) for known in PLATFORMS):
            choice = ", ".join(f"{known.name} ({known.fmi2})" if known.name != known.fmi2 else known.name for known in PLATFORMS)
            raise UnknownNameError(f"platform {name!r} is not offered; choose from {choice}.")
    return tuple(known for known in PLATFORMS if known.name in wanted or known.fmi2 in wanted)


def platform_compiler(platform: Platform) -> Compiler:
    """The compiler for a platform: $CC for this machine's own, else the cross-compiler, else any compiler of this machine.

    Raises MachineError with what to install.
    """
    own = platform.name == this_platform()
    if own and os.environ.get("CC"):
        return find_compiler()
    if importlib.util.find_spec("ziglang") is not None:
        return zig_compiler(platform.target)
    if own:
        return find_compiler()
    raise MachineError(f"binaries for {platform.name} need a cross-compiler; install one with: pip install ziglang")

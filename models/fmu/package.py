"""Build the FMU file of a scene: collect sources, compile, pack, cache by content.

    build_fmu(scene)  # .../a1b2....three_cart.fmu
    build_fmu(scene, version="3.0", platforms=("x86_64-linux", "win64"))

Equal scenes give equal bytes: fixed time stamps, sorted names, no local paths. Binaries of this
platform need a C compiler; other platforms, and Linux binaries for glibc since 2.17, need the
cross-compiler of the `[compiler]` extra.
"""

from __future__ import annotations

import importlib.util
import os
import platform as machine
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from models.codegen.cache import cached
from models.codegen.compiler import FLAGS, Compiler, compile_shared, find_compiler, zig_compiler
from models.codegen.emit import for_scene, force_sources, model_source
from models.codegen.text_cache import generators
from models.errors import MachineError, UnknownNameError
from models.fmu.description import (
    Standard,
    describe,
    find_standard,
    render,
    source_epoch,
    standard_headers,
)
from models.fmu.sensitivity import sensitivity_source
from models.scene import Scene
from models.scene.text import scene_text


@dataclass(frozen=True)
class Platform:
    """A platform: FMI 3.0's name, FMI 2.0's name, library suffix, cross-compiler target."""

    name: str
    fmi2: str
    suffix: str
    target: str

    def folder(self, standard: Standard) -> str:
        """Return the folder within `binaries`."""
        return self.fmi2 if standard.version == "2.0" else self.name

    @property
    def flags(self) -> tuple[str, ...]:
        """Return the compiler flags; Windows rejects -fPIC."""
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
    """Return FMI 3.0's name of this machine, or None if it is not in PLATFORMS."""
    system, architecture = _SYSTEMS.get(sys.platform), _ARCHITECTURES.get(machine.machine().lower())
    name = f"{architecture}-{system}"
    return name if name in {known.name for known in PLATFORMS} else None


def find_platforms(names: Iterable[str]) -> tuple[Platform, ...]:
    """Return the named platforms (FMI 2.0 or 3.0 names) in order, by default this machine's.

    Raises UnknownNameError for an unknown name, MachineError if this machine is no platform.
    """
    wanted = list(names) or [this_platform()]
    if None in wanted:
        raise MachineError(
            f"this machine ({sys.platform} {machine.machine()}) is no platform of FMI; name one with --platform."
        )
    for name in wanted:
        if not any(name in (known.name, known.fmi2) for known in PLATFORMS):
            choice = ", ".join(
                f"{known.name} ({known.fmi2})" if known.name != known.fmi2 else known.name
                for known in PLATFORMS
            )
            raise UnknownNameError(f"platform {name!r} is not offered; choose from {choice}.")
    return tuple(known for known in PLATFORMS if known.name in wanted or known.fmi2 in wanted)


def platform_compiler(platform: Platform) -> Compiler:
    """Return $CC for this machine's platform, else the cross-compiler, else any compiler here.

    Raises MachineError with advice.
    """
    own = platform.name == this_platform()
    if own and os.environ.get("CC"):
        return find_compiler()
    if importlib.util.find_spec("ziglang") is not None:
        return zig_compiler(platform.target)
    if own:
        return find_compiler()
    raise MachineError(
        f"binaries for {platform.name} need a cross-compiler; install one with: pip install ziglang"
    )


def pack(path: Path, content: Mapping[str, bytes], first: str) -> None:
    """Write `content` (name -> bytes) as a zip, with the file `first` at the beginning."""
    stamp = datetime.fromtimestamp(source_epoch(), UTC).timetuple()[:6]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(content, key=lambda name: (name != first, name)):
            entry = zipfile.ZipInfo(name, date_time=stamp)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            entry.create_system = 3  # Unix, on every machine
            archive.writestr(entry, content[name])


_HERE = Path(__file__).parent
_SHELL = _HERE / "shell"
_ICON = _HERE / "icon"


def build_fmu(scene: Scene, version: str = "2.0", platforms: Sequence[str] = ()) -> Path:
    """Return the FMU of a scene in continuous time, with Co-Simulation and Model Exchange.

    The file comes from the cache, or is built there. platforms: names of FMI 2.0 or 3.0 (`linux64`
        or
    `x86_64-linux`), by default this machine's. Raises UnknownNameError for an unknown FMI version
    or platform, SceneError for names that an FMU cannot have, MachineError without a compiler or a
    writable cache.
    """
    standard = find_standard(version)
    scene = scene.continuous()
    compilers = {platform: platform_compiler(platform) for platform in find_platforms(platforms)}
    made_by = [
        f"{platform.name} {' '.join(platform.flags)} {compiler.version}"
        for platform, compiler in compilers.items()
    ]
    made_by += [f"FMI {version}, dated {source_epoch()}"]
    made_by += [generators(), *standard_headers(standard).values(), scene_text(scene)]

    def build(path: Path) -> None:
        files = fmu_texts(scene, standard)
        content = {name: text.encode() for name, text in files.items()}
        pack(
            path,
            content
            | icons(standard)
            | binaries(files, standard, scene.name, compilers, path.parent),
            first="modelDescription.xml",
        )

    return cached("\n".join(made_by), f".{scene.name}.fmu", build)


def fmu_texts(scene: Scene, standard: Standard) -> dict[str, str]:
    """Return the text files of the FMU, by path."""
    sources = {
        path.name: for_scene(scene, path.read_text(encoding="utf-8"))
        for path in sorted(_SHELL.iterdir())
        if belongs(path, standard)
    }
    sources |= {
        f"{standard.header_folder}{name}": text for name, text in standard_headers(standard).items()
    }
    laws = force_sources(scene)
    absent = {f"{law}_modes.h" for law in ("friction", "damping") if f"{law}.h" not in laws}
    sources = {name: text for name, text in sources.items() if name not in absent} | laws
    sources |= {
        "scene_model.h": model_source(scene),
        "scene_sensitivity.h": sensitivity_source(scene),
    }
    return {
        **describe(scene, sources, standard),
        "documentation/licenses/license.txt": render(
            "licenses.txt.j2", header_names=standard.headers
        ),
        "terminalsAndIcons/terminalsAndIcons.xml": render("terminalsAndIcons.xml.j2", scene=scene),
        **{f"sources/{name}": text for name, text in sources.items()},
    }


def belongs(path: Path, standard: Standard) -> bool:
    """Return whether a file of the shell is C for this version."""
    return path.suffix in (".c", ".h") and (
        not path.name.startswith("fmi") or path.name.startswith(standard.prefix)
    )


def icons(standard: Standard) -> dict[str, bytes]:
    """Return the icon as drawing and as pixels."""
    pixels, drawing = ((_ICON / name).read_bytes() for name in ("icon.png", "icon.svg"))
    files = {"terminalsAndIcons/icon.png": pixels, "terminalsAndIcons/icon.svg": drawing}
    return files | ({"model.png": pixels} if standard.version == "2.0" else {})


def binaries(
    files: Mapping[str, str],
    standard: Standard,
    identifier: str,
    compilers: Mapping[Platform, Compiler],
    place: Path,
    extra_flags: Sequence[str] = (),
) -> dict[str, bytes]:
    """Return the FMU's libraries by path, compiled in a temporary folder below `place`."""
    sources = {
        name.removeprefix("sources/"): text
        for name, text in files.items()
        if name.startswith("sources/")
    }
    libraries = {}
    with tempfile.TemporaryDirectory(prefix="touchstone-fmu-", dir=place) as temporary:
        for platform, compiler in compilers.items():
            library = Path(temporary) / f"{platform.name}{platform.suffix}"
            compile_shared(
                compiler,
                sources,
                library,
                extra_flags,
                include_dirs=[Path(standard.header_folder)],
                flags=platform.flags,
            )
            libraries[f"binaries/{platform.folder(standard)}/{identifier}{platform.suffix}"] = (
                library.read_bytes()
            )
    return libraries

"""Scene -> FMU file: the sources are put together, compiled, packed and kept by content.

    build_fmu(scene)  ->  .../a1b2....three_cart.fmu

Equal scenes give equal bytes: fixed time stamps, sorted names, no path of this machine inside.
"""

from __future__ import annotations

import importlib.util
import platform
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from models.codegen.cache import cached
from models.codegen.compiler import FLAGS, Compiler, compile_shared, find_compiler
from models.codegen.emit import emit_model
from models.errors import MachineError, SceneError, UnknownNameError
from models.fmu.description import describe, model_identifier, source_epoch
from models.fmu.rendering import render
from models.fmu.sensitivity import emit_sensitivity
from models.scene import Scene

_SHELL = Path(__file__).parent / "shell"
_VERSIONS = ("2.0",)
_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")


def build_fmu(scene: Scene, version: str = "2.0") -> Path:
    """The FMU of a scene: Co-Simulation and Model Exchange in one file; found in the cache or built there.

    Raises UnknownNameError for an FMI version that is not offered, SceneError for a scene whose names an FMU cannot carry,
    MachineError without a compiler or a cache folder that can be written.
    """
    if version not in _VERSIONS:
        raise UnknownNameError(f"FMI version {version!r} is not offered; choose {' or '.join(_VERSIONS)}.")
    folder = _platform_folder()
    identifier = model_identifier(scene)
    files = fmu_texts(scene)
    compiler = find_compiler()
    key = "\n".join([compiler.describe(), " ".join(FLAGS), folder, *(f"{name}\0{text}" for name, text in sorted(files.items()))])
    return cached(key, f".{identifier}.fmu", lambda path: _pack(path, files, folder, identifier, compiler))


def fmu_texts(scene: Scene) -> dict[str, str]:
    """Every text file of the FMU, by its path inside."""
    if scene.nf:
        raise SceneError(f"scene {scene.name}: it has friction, which FMUs do not carry yet.")
    sources = {path.name: path.read_text(encoding="utf-8") for path in sorted(_SHELL.iterdir()) if path.suffix in (".c", ".h")}
    sources |= standard_headers()
    sources |= {"scene_model.h": emit_model(scene, defaults=False), "scene_sensitivity.h": emit_sensitivity(scene)}
    description = describe(scene, sources)
    sources["model_config.h"] = description.config
    return {
        "modelDescription.xml": description.xml,
        "documentation/index.html": description.documentation,
        "documentation/licenses/license.txt": render("licenses.txt.j2", header_names=_HEADERS),
        **{f"sources/{name}": text for name, text in sources.items()},
    }


def standard_headers() -> dict[str, str]:
    """The headers of the FMI standard, taken from the FMPy package. Raises MachineError if it is not installed."""
    spec = importlib.util.find_spec("fmpy")
    if spec is None or spec.origin is None:
        raise MachineError("the headers of the FMI standard are missing: they come with FMPy; install it with: pip install fmpy")
    folder = Path(spec.origin).parent / "c-code"
    try:
        return {name: (folder / name).read_text(encoding="utf-8") for name in _HEADERS}
    except OSError as error:
        raise MachineError(
            f"the headers of the FMI standard cannot be read from FMPy ({error}); reinstall it with: pip install --force-reinstall fmpy"
        ) from error


def _platform_folder() -> str:
    """FMI's name of this platform."""
    if sys.platform.startswith("linux") and platform.machine() in ("x86_64", "AMD64"):
        return "linux64"
    raise MachineError(f"FMUs are built on Linux x86-64 only; this machine is {sys.platform} {platform.machine()}.")


def _pack(path: Path, files: Mapping[str, str], folder: str, identifier: str, compiler: Compiler) -> None:
    sources = {name.removeprefix("sources/"): text for name, text in files.items() if name.startswith("sources/")}
    with tempfile.TemporaryDirectory(prefix="touchstone-fmu-") as temporary:
        library = Path(temporary) / f"{identifier}.so"
        compile_shared(compiler, sources, library)
        content = {name: text.encode() for name, text in files.items()}
        content[f"binaries/{folder}/{identifier}.so"] = library.read_bytes()
    stamp = datetime.fromtimestamp(source_epoch(), UTC).timetuple()[:6]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        # modelDescription.xml first: a reader of the stream finds it at once.
        for name in sorted(content, key=lambda name: (name != "modelDescription.xml", name)):
            entry = zipfile.ZipInfo(name, date_time=stamp)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.endswith(".so") else 0o644) << 16
            entry.create_system = 3  # Unix, whatever machine packs it
            archive.writestr(entry, content[name])

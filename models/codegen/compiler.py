"""Find and run a C compiler: $CC, cc, gcc, clang, or `python -m ziglang cc`; load libraries."""

from __future__ import annotations

import ctypes
import errno
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from models.codegen.cache import cached
from models.errors import MachineError

# -O2 always: at -O0 zig traps undefined behaviour. Without fused multiply-add an expression gives
# equal bits in rollout, score and on every machine. -s keeps files small and free of paths.
FLAGS = (
    "-O2",
    "-s",
    "-std=c99",
    "-fPIC",
    "-shared",
    "-ffp-contract=off",
    "-fvisibility=hidden",
    "-Wall",
    "-Wextra",
    "-Werror",
)

# Types of C functions: n count, d double, p address of doubles. Addresses are integers, because
# ctypes pointers would cost more than a rollout.
_TYPES = {"n": ctypes.c_int, "d": ctypes.c_double, "p": ctypes.c_void_p, "": None}


@dataclass(frozen=True)
class Compiler:
    """A C compiler and the first line of its version, which decide the compiled bytes."""

    command: tuple[str, ...]
    version: str


def find_compiler() -> Compiler:
    """Return the first compiler that runs; raise MachineError with advice."""
    return _find(os.environ.get("CC", ""), os.environ.get("PATH", ""))


@lru_cache(maxsize=8)
def _find(cc: str, path: str) -> Compiler:
    if cc:
        try:
            command = tuple(shlex.split(cc))
        except ValueError as error:
            raise MachineError(
                f"no C compiler: the environment variable CC is {cc!r}, which no shell reads ({error}); correct it or unset it."
            ) from None
        version = _version(command)
        if version is None:
            raise MachineError(
                f"no C compiler: the environment variable CC is {cc!r}, which does not run; correct it or unset it."
            )
        return Compiler(command, version)
    candidates: list[tuple[str, ...]] = [
        (found,)
        for found in (shutil.which(name, path=path or None) for name in ("cc", "gcc", "clang"))
        if found
    ]
    if importlib.util.find_spec("ziglang") is not None:
        candidates.append((sys.executable, "-m", "ziglang", "cc"))
    for command in candidates:
        version = _version(command)
        if version is not None:
            return Compiler(command, version)
    raise MachineError(
        "no C compiler was found; install one with: pip install ziglang (or set CC to a compiler you have)."
    )


def zig_compiler(target: str) -> Compiler:
    """Return the cross-compiler of the `[compiler]` extra for a target, e.g. x86_64-linux-gnu.2.17.

    Raises MachineError if it does not run.
    """
    command = (sys.executable, "-m", "ziglang", "cc")
    version = _version(command)
    if version is None:
        raise MachineError(
            "the cross-compiler does not run; reinstall it with: pip install --force-reinstall ziglang"
        )
    return Compiler((*command, "-target", target), f"{version} for {target}")


@lru_cache(maxsize=8)
def _version(command: tuple[str, ...]) -> str | None:
    try:
        done = subprocess.run(
            [*command, "--version"], capture_output=True, text=True, timeout=120, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    lines = done.stdout.strip().splitlines()
    return lines[0] if done.returncode == 0 and lines else None


def compile_shared(
    compiler: Compiler,
    sources: Mapping[str, str],
    output: Path,
    extra_flags: Sequence[str] = (),
    include_dirs: Sequence[Path] = (),
    flags: Sequence[str] = FLAGS,
) -> None:
    """Compile the .c files among `sources` (name -> text) into the shared library `output`.

    include_dirs are absolute, or relative to the sources. Raises MachineError with the compiler's
    first errors.
    """
    # Inside the output's folder, so that it is removed with it if this process is killed.
    with tempfile.TemporaryDirectory(prefix="touchstone-", dir=output.parent) as folder:
        for name, text in sources.items():
            place = Path(folder) / name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(text, encoding="utf-8")
        units = sorted(name for name in sources if name.endswith(".c"))
        paths = [f"-I{path}" for path in include_dirs]
        command = [
            *compiler.command,
            *flags,
            *extra_flags,
            "-I.",
            *paths,
            *units,
            "-o",
            str(output),
            "-lm",
        ]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not output.exists():
        messages = done.stderr.strip().splitlines()
        errors = [line for line in messages if "error:" in line]
        lines = "; ".join((errors or messages)[:3]) or "it ended without writing a library"
        if os.strerror(errno.ENOSPC) in done.stderr:
            raise MachineError(
                f"the C compiler ({compiler.version}) had no room for its files ({lines}); make room there."
            )
        raise MachineError(
            f"the C compiler ({compiler.version}) refused the generated code of {', '.join(units)}: {lines}"
        )


def cached_library(sources: Mapping[str, str], extra_flags: Sequence[str] = ()) -> Path:
    """Return the library of `compile_shared` from the cache, which machines may share.

    Raises MachineError without a compiler or a writable cache.
    """
    compiler, machine = find_compiler(), f"{sys.platform} {platform.machine()}"
    texts = [f"{name}\n{text}" for name, text in sorted(sources.items())]
    key = "\n".join([compiler.version, machine, " ".join((*FLAGS, *extra_flags)), *texts])
    return cached(key, ".so", lambda path: compile_shared(compiler, sources, path, extra_flags))


def load_library(path: Path, signatures: Mapping[str, tuple[str, str]]) -> ctypes.CDLL:
    """Load a library; a signature is the result ("": none) and the arguments, letters n, d or p."""
    library = ctypes.CDLL(str(path))
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype, function.argtypes = (
            _TYPES[result],
            [_TYPES[letter] for letter in arguments],
        )
    return library

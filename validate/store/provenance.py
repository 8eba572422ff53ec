"""Provenance of a result: sources, library versions, machine, command.

`content_key` (runs) and `function_key` (checks) hash everything that decides a task's numbers, but
no times, paths or hosts. Equal content has an equal key on every machine.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import shlex
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from models.codegen.compiler import find_compiler
from models.errors import MachineError
from models.results.run import ProvenanceRecord
from models.scene import Scene
from models.scene.text import scene_text
from validate.processes.process import ROOT, THREADS, usable_cores

SEED = 0
LIBRARIES = (
    "numpy",
    "scipy",
    "sympy",
    "pyomo",
    "cyipopt-wheels",
    "clarabel",
    "torch",
    "fmpy",
    "scikit-sundae",
)
# Sources that cannot change the numbers of a task.
_NO_INFLUENCE = (
    "validate/cli",
    "validate/__main__.py",
    "validate/campaign/",
    "validate/judge/engines/",
    "models/results/engines.py",
    "models/results/stored.py",
)
# Sources that decide checks, but no run.
_OF_CHECKS = (
    "formulations/ampl/",
    "formulations/mpec/",
    "validate/tasks/check.py",
    "validate/tasks/fmu_checks.py",
    "validate/fmu_check/",
    "validate/stress/",
    "models/results/check.py",
)
# Sources of surveys, which decide no run.
_OF_SURVEYS = ("validate/judge/robustness/", "models/results/robustness.py")
# The source of reports that decides the content of a record.
_PAPER = "reports/paper.py"
# A task depends on its own files of these folders only.
_ONE_BY_ONE = ("models/scenes", "formulations/methods")

_SOURCE_SUFFIXES = frozenset({".py", ".c", ".h", ".template", ".jinja", ".j2", ".xml"})


@lru_cache(maxsize=1)
def _source_digests() -> dict[str, str]:
    digests = {}
    for room in ("models", "formulations", "validate"):
        for path in sorted((ROOT / room).rglob("*")):
            name = path.relative_to(ROOT).as_posix()
            if (
                path.suffix in _SOURCE_SUFFIXES
                and "__pycache__" not in path.parts
                and not name.startswith(_NO_INFLUENCE)
            ):
                digests[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    digests[_PAPER] = hashlib.sha256((ROOT / _PAPER).read_bytes()).hexdigest()
    return digests


def source_digests(methods: Iterable[str]) -> dict[str, str]:
    """Return the digest of each source that a run by these methods depends on."""
    return {
        name: digest
        for name, digest in _digests_with(methods).items()
        if not name.startswith((*_OF_CHECKS, *_OF_SURVEYS))
    }


@lru_cache(maxsize=1)
def survey_sources() -> str:
    """Return the digest of the sources of surveys."""
    sources = {
        name: digest for name, digest in _source_digests().items() if name.startswith(_OF_SURVEYS)
    }
    return _hash({"sources": sources})


def _digests_with(methods: Iterable[str]) -> dict[str, str]:
    used = {f"formulations/methods/{method}.py" for method in methods}
    return {
        name: digest
        for name, digest in _source_digests().items()
        if name in used or not name.startswith(_ONE_BY_ONE)
    }


@lru_cache(maxsize=1)
def library_versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries that decide numbers."""
    return {
        "python": platform.python_version(),
        **{name: installed(name, "not installed") for name in LIBRARIES},
    }


def installed(package: str, otherwise: str) -> str:
    """Return the version of a package, `otherwise` if missing."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return otherwise


def content_key(scene: Scene, stages: Any, methods: Iterable[str], extra: str = "") -> str:
    """Return the key of a task; stages: method, eps and options in order (JSON data)."""
    sources = _digest_of_sources(frozenset(methods))
    return _hash({"scene": scene_text(scene), "stages": stages, "sources": sources, "extra": extra})


# A repeated campaign calls this 1,700 times, without a cache 0.4 of 3 s.
@lru_cache
def _digest_of_sources(methods: frozenset[str]) -> str:
    return hashlib.sha256(json.dumps(source_digests(methods)).encode()).hexdigest()


def function_key(
    asked: Sequence[Any], content: str, methods: Iterable[str], sources: Sequence[str]
) -> str:
    """Return the key of a function's result.

    - asked: JSON data.
    - content: text that decides the result.
    - methods: names.
    - sources: prefixes of relevant source paths, () for all.
    """
    digests = _digests_with(methods)
    return _hash(
        {
            "asked": asked,
            "content": content,
            "sources": {
                name: digest
                for name, digest in digests.items()
                if not sources or name.startswith(tuple(sources))
            },
        }
    )


def _hash(content: Mapping[str, Any]) -> str:
    """Return the sha256 of content and of this machine's influences."""
    around = {
        "seed": SEED,
        "threads": THREADS,
        "libraries": library_versions(),
        "linear_solver": os.environ.get("TOUCHSTONE_LINEAR_SOLVER", ""),
        "compiler": compiler_text(),
        "machine": platform.machine(),
    }
    return hashlib.sha256(
        json.dumps({**around, **content}, sort_keys=True, default=repr).encode()
    ).hexdigest()


def fingerprint() -> str:
    """Return a digest of all influences on numbers; equal machines give tasks equal keys."""
    return _hash({"sources": _source_digests()})


@lru_cache(maxsize=1)
def compiler_text() -> str:
    """Return the C compiler's name and version, or why there is none."""
    try:
        return find_compiler().version
    except MachineError as error:
        return str(error)


def commit() -> str:
    """Return the commit of our sources, `+` if changed, "" without git."""
    if not (ROOT / ".git").exists():
        return ""
    command = [
        "git",
        "-C",
        str(ROOT),
        "describe",
        "--always",
        "--exclude=*",
        "--abbrev=40",
        "--dirty=+",
    ]
    try:
        return subprocess.run(
            command, capture_output=True, text=True, timeout=20, check=True
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def _cpu() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def now() -> str:
    """Return the current time, ISO 8601 UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def gather(command: str) -> ProvenanceRecord:
    """Return the provenance of a campaign that starts now."""
    return ProvenanceRecord(
        touchstone=installed("touchstone-contact", "0 (not installed)"),
        commit=commit(),
        python=f"{platform.python_implementation()} {platform.python_version()}",
        threads=THREADS,
        packages={name: text for name, text in library_versions().items() if name != "python"},
        compiler=compiler_text(),
        seed=SEED,
        started=now(),
        command=command,
        **machine(),
    )


def machine() -> dict[str, Any]:
    """Return the system, the processor, and the number of usable cores."""
    return {"platform": platform.platform(), "cpu": _cpu(), "cores": usable_cores()}


def command_line(arguments: Iterable[str], program: str = "python -m validate") -> str:
    """Return the command quoted for any shell; zsh expands an unquoted =word."""
    words = (
        f"'{word}'" if word.startswith("=") and shlex.quote(word) == word else shlex.quote(word)
        for word in arguments
    )
    return " ".join([program, *words])

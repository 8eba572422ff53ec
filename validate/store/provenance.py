"""Where a result comes from: our commit and sources, the versions of what we stand on, the machine, the command.

`content_key` (runs) and `function_key` (checks) hash everything that decides the numbers of a task:
scene, pipeline, options, seed, our sources, library versions, compiler. They hash no times, paths
or hosts: equal content has an equal key on every machine.
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
from models.scene import Scene
from models.scene.text import scene_text
from reports.records.record import ProvenanceRecord
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
# Parts of us that cannot change a number of a task: how tasks are chosen, run side by side, listed
# and reported.
_NO_INFLUENCE = (
    "validate/cli",
    "validate/__main__.py",
    "validate/campaign/",
)
# Parts that decide what checks find, and nothing of a run.
_OF_CHECKS = (
    "validate/tasks/check.py",
    "validate/tasks/fmu_checks.py",
    "validate/fmu_check/",
    "validate/stress/",
    "reports/records/check_record.py",
)
# What tries plans that hold in perturbed worlds: it decides nothing of how they are found and
# judged.
_OF_SURVEYS = "validate/judge/robustness/"
# Parts of the room of reports that decide what is in a record: its form, how columns are written,
# and the paper's numbers beside ours.
_RECORDS = ("records/record", "records/check_record", "paper")
# Scenes and methods count one by one: a task depends on its own.
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
    for name in (f"reports/{module}.py" for module in _RECORDS):
        digests[name] = hashlib.sha256((ROOT / name).read_bytes()).hexdigest()
    return digests


def source_digests(methods: Iterable[str]) -> dict[str, str]:
    """Digest of each of our files that a task of these methods depends on."""
    return {
        name: digest
        for name, digest in _digests_with(methods).items()
        if not name.startswith((*_OF_CHECKS, _OF_SURVEYS))
    }


@lru_cache(maxsize=1)
def survey_sources() -> str:
    """Return the digest of the source files of the survey in perturbed worlds."""
    own = {
        name: digest for name, digest in _source_digests().items() if name.startswith(_OF_SURVEYS)
    }
    return _hash({"sources": own})


def _digests_with(methods: Iterable[str]) -> dict[str, str]:
    own = {f"formulations/methods/{method}.py" for method in methods}
    return {
        name: digest
        for name, digest in _source_digests().items()
        if name in own or not name.startswith(_ONE_BY_ONE)
    }


@lru_cache(maxsize=1)
def library_versions() -> dict[str, str]:
    """Installed versions of the libraries that decide numbers, and of Python."""
    return {
        "python": platform.python_version(),
        **{name: installed(name, "not installed") for name in LIBRARIES},
    }


def installed(package: str, otherwise: str) -> str:
    """The version of a package, or what is said where it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return otherwise


def content_key(scene: Scene, stages: Any, methods: Iterable[str], extra: str = "") -> str:
    """The key of a task: sha256 over its content. stages: method, eps and filled options in order (JSON data)."""
    sources = _digest_of_sources(frozenset(methods))
    return _hash({"scene": scene_text(scene), "stages": stages, "sources": sources, "extra": extra})


# a campaign asks for some thirty sets of methods 1,700 times: 0.4 of the 3 s that a repeated one
# takes
@lru_cache
def _digest_of_sources(methods: frozenset[str]) -> str:
    return hashlib.sha256(json.dumps(source_digests(methods)).encode()).hexdigest()


def function_key(
    asked: Sequence[Any], content: str, methods: Iterable[str], sources: Sequence[str]
) -> str:
    """Return the key of a function's answer.

    asked: JSON data; content: text that decides the answer; methods: names of the methods that the
    function runs; sources: beginnings of the paths of our sources that matter, () for all.
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
    """sha256 over some content and what decides every number on this machine."""
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
    """Digest of all that decides numbers here, whatever the task: two machines that agree on it give a task the same key."""
    return _hash({"sources": _source_digests()})


@lru_cache(maxsize=1)
def compiler_text() -> str:
    """Name and version of the C compiler, or the sentence that says there is none."""
    try:
        return find_compiler().version
    except MachineError as error:
        return str(error)


def commit() -> str:
    """The commit of our sources, with `+` if they were changed since.

    Empty if they are not in a git work tree or git is missing.
    """
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
    """The present moment, ISO 8601 UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def gather(command: str) -> ProvenanceRecord:
    """The provenance of a campaign that starts now."""
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
    """What a record says of the machine: the system, the processor, and how many cores this process may use."""
    return {"platform": platform.platform(), "cpu": _cpu(), "cores": usable_cores()}


def command_line(arguments: Iterable[str], program: str = "python -m validate") -> str:
    """The command as the user can type it again, into any shell: zsh takes an unquoted =word for the path of a program."""
    words = (
        f"'{word}'" if word.startswith("=") and shlex.quote(word) == word else shlex.quote(word)
        for word in arguments
    )
    return " ".join([program, *words])

"""The command line as a user starts it, each time a process of its own: `list`, `report` of a stored campaign, `all --quick` twice."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

from validate.bench.case import Size, Work, scratch

# Libraries that neither listing nor reporting may import.
_HEAVY = ("torch", "pyomo")
_CODE = """
import sys
from validate.cli.group import run
code = run(sys.argv[1:])
sys.stdout.flush()
print(*[name for name in {heavy!r} if name in sys.modules], file=sys.stderr)
sys.exit(code)
"""
# Where in the folder that measurements are given the records of a campaign are, if there is one.
STORED = "stored"


def list_command(size: Size, folder: Path) -> Work:
    """`python -m validate list`."""
    return lambda: _light(["list"])


def report_command(size: Size, folder: Path) -> Work:
    """`python -m validate report` of the stored campaign."""
    return lambda: _light(["report", str(folder / STORED)])


def quick_campaign(size: Size, folder: Path) -> Work:
    """`python -m validate all --quick -j 2`, nothing stored; wall seconds."""
    return lambda: _campaign(scratch(folder))


def stored_campaign(size: Size, folder: Path) -> Work:
    """The same again, everything stored; wall seconds."""
    out = scratch(folder)
    _campaign(out)
    return lambda: _campaign(out)


def _light(arguments: Sequence[str]) -> Mapping[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", _CODE.format(heavy=_HEAVY), *arguments], capture_output=True, text=True, check=False, errors="replace"
    )
    if done.returncode != 0:
        raise RuntimeError(f"python -m validate {arguments[0]} ended with {done.returncode}: {done.stderr.strip()[-300:]}")
    imported = done.stderr.strip().splitlines()[-1:] or [""]
    return {"outcome": f"imports {imported[0]}" if imported[0] else "ok"}


def _campaign(out: Path) -> Mapping[str, Any]:
    began = perf_counter()
    command = [sys.executable, "-m", "validate", "all", "--quick", "-j", "2", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, errors="replace")
    if done.returncode not in (0, 1):
        raise RuntimeError(f"python -m validate all --quick ended with {done.returncode}: {done.stderr.strip()[-300:]}")
    return {"cpu_s": perf_counter() - began, "outcome": "ok" if done.returncode == 0 else "not all that must hold holds"}


def copy_records(campaign: Path, folder: Path) -> None:
    """The records of a campaign, without its trajectories, to where `report_command` looks for them."""
    shutil.copytree(campaign, folder / STORED, ignore=shutil.ignore_patterns("*.nc", ".*", "*.html"))

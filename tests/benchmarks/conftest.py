"""Fixtures for the tests of the benchmarks: the command line, records as benchmarks leave them, and the factory of the report's tests."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks import ROOT, module_at


@pytest.fixture(scope="session")
def factory() -> ModuleType:
    return module_at("tests/reports/record_factory.py")


@pytest.fixture(scope="session")
def benches() -> ModuleType:
    return module_at("tests/benchmarks/record_files.py")


@pytest.fixture(scope="session")
def cli() -> Callable[..., subprocess.CompletedProcess[str]]:
    """cli("list") runs `python -m benchmarks list` to its end, in the checkout or elsewhere.

    program: another of ours.
    """

    def run(
        *arguments: str, cwd: Path = ROOT, program: str = "benchmarks"
    ) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "NO_COLOR": "1"}
        return subprocess.run(
            [sys.executable, "-m", program, *arguments],
            capture_output=True,
            text=True,
            env=environment,
            cwd=cwd,
            check=False,
        )

    return run

"""The command line of the benchmarks, as a fixture."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks import ROOT


@pytest.fixture(scope="session")
def cli() -> Callable[..., subprocess.CompletedProcess[str]]:
    """cli("house") runs `python -m benchmarks house` to its end, in the checkout or elsewhere.

    program: another module to run.
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

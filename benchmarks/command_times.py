"""CPU seconds of the commands that one waits for, of all their processes, with everything cached that can be.

    python -m benchmarks commands
    # another checkout, in turns: what a change was worth on a busy machine
    python -m benchmarks commands --beside ../before

Each checkout first makes what its commands are about: a campaign of one run, that run's plan as
CSV, the scene's FMU. Every command has run once before it is measured, so that bytecode is kept,
too. The median of some rounds, in each of which every command of every checkout runs once.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import click

from benchmarks import ROOT
from benchmarks.measure import cpu_seconds
from benchmarks.options import COUNT, out_option
from benchmarks.records import Table
from benchmarks.results import store_tables

_SCENE = "three_cart"
_RUN = "three_cart x strict"
# What is asked for [CPU s]; the others have no target.
_TARGETS = {"replay": 0.8, "list": 0.1, "--help": 0.06}
_PLAN_AS_CSV = """
import sys
from pathlib import Path
from models.catalog import load_scene
from models.trajectory import write_csv
from models.trajectory_netcdf import read_netcdf
folder, target = map(Path, sys.argv[1:])
scene = load_scene("three_cart")
write_csv(target, read_netcdf(next(folder.glob("legs/*/trajectory_1.nc")), scene), scene)
"""


class Checkout:
    """A checkout of the sources, and a folder with what its commands are about."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.folder = folder
        self.folder.mkdir()
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        self._environment = {**os.environ, **threads, "PYTHONPATH": str(root)}
        self._environment.pop("PYTHONDONTWRITEBYTECODE", None)

    def prepare(self) -> dict[str, list[str]]:
        """Make what the commands are about, and give them by what they are called here."""
        self.run(
            [
                "-m",
                "validate",
                "all",
                "--scene",
                _SCENE,
                "-k",
                f'="{_RUN}"',
                "-j",
                "1",
                "--out",
                "campaign",
            ]
        )
        self.run(["-c", _PLAN_AS_CSV, "campaign", "plan.csv"])
        self.run(["-m", "validate", "fmu", _SCENE, "-o", f"{_SCENE}.fmu"])
        return {
            "replay": ["replay", "plan.csv", "--scene", _SCENE],
            "show": ["show", _RUN, "--in", "campaign"],
            "plan": ["plan", "--scene", _SCENE, "--out", "campaign"],
            "check": ["check", f"{_SCENE}.fmu"],
            "list": ["list"],
            "--help": ["--help"],
        }

    def run(self, arguments: Sequence[str]) -> float:
        """CPU seconds of a Python of its own and of the processes that it started [s]."""
        before = cpu_seconds()
        command, where = (
            [sys.executable, *arguments],
            {"cwd": self.folder, "env": self._environment},
        )
        done = subprocess.run(
            command, **where, capture_output=True, text=True, check=False, errors="replace"
        )
        if done.returncode not in (0, 1):
            raise click.ClickException(
                f"python {' '.join(arguments)} ended with {done.returncode}: {done.stderr.strip()[-300:]}"
            )
        return cpu_seconds() - before


def _root(context: click.Context, parameter: click.Parameter, folder: Path | None) -> Path | None:
    if folder is not None and not (folder / "validate" / "__main__.py").is_file():
        raise click.BadParameter(
            f"{folder} is no checkout of touchstone; it has no validate/__main__.py.",
            context,
            parameter,
        )
    return None if folder is None else folder.resolve()


@click.command()
@click.option("--rounds", type=COUNT, default=7, show_default=True)
@click.option(
    "--beside", type=click.Path(path_type=Path, file_okay=False), callback=_root, metavar="DIR",
    help="Another checkout, measured in turns with this one."
)  # fmt: skip
@out_option
def command(rounds: int, beside: Path | None, out: Path) -> int:
    """CPU seconds of `replay`, `show`, `plan`, `check`, `list` and `--help` in all their processes, warm cache: medians of ROUNDS."""
    with tempfile.TemporaryDirectory() as name:
        roots = [ROOT] if beside is None else [ROOT, beside]
        checkouts = [Checkout(root, Path(name) / str(number)) for number, root in enumerate(roots)]
        prepared = [checkout.prepare() for checkout in checkouts]
        seconds: dict[str, list[list[float]]] = {
            label: [[] for _ in checkouts] for label in prepared[0]
        }
        for number in range(-1, rounds):  # the first warms up
            for label, arguments in prepared[0].items():
                for checkout, found in zip(checkouts, seconds[label], strict=True):
                    spent = checkout.run(["-m", "validate", *arguments])
                    if number >= 0:
                        found.append(spent)
    columns = (
        "command",
        "CPU s",
        "least",
        "at most",
        *(() if beside is None else ("CPU s beside", "ratio")),
    )
    rows = []
    for label, (own, *other) in seconds.items():
        compared = [
            value for found in other for value in (median(found), median(own) / median(found))
        ]
        figures = [
            None if value is None else round(value, 3)
            for value in (median(own), min(own), _TARGETS.get(label), *compared)
        ]
        rows.append((" ".join(prepared[0][label]), *figures))
    told = Table(
        caption=f"CPU seconds of all processes of a command, warm cache, medians of {rounds}",
        columns=columns,
        rows=tuple(rows),
    )
    about = "What one waits for, with everything cached that can be: imports, reading, judging."
    store_tables(out, "commands", "Commands", about, [told])
    return 0

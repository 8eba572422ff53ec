"""Trials of this machine, the first lines of `--dry-run`.

for finding in try_machine(Path("runs/all")):
    print(finding.name, finding.works, finding.sentence)

Each trial runs a small piece of a campaign in a child process and compares a number with its known
value. Each trial function imports what it tries, so that a failing import is the finding.
"""

from __future__ import annotations

import ctypes
import math
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from models.catalog import load_scene
from models.codegen.cache import cache_folder
from models.codegen.compiler import compile_shared, find_compiler
from models.errors import MachineError
from validate.processes.disk import write_durably
from validate.processes.isolated import Ending, Limits, run_isolated

# Free disk space that a campaign of all scenes needs, with its FMUs and trajectories [MiB].
_ROOM_MIB = 500
# Limits of the child process of a trial.
_LIMITS = Limits(seconds=300.0, memory=16 * 1024**3)


class Trial(NamedTuple):
    """A function of this module.

    - advice: for a failure that is not a MachineError, which has its own advice
    - compiles: whether the trial needs the C compiler and the cache; it is left out if one of these
      failed
    """

    name: str
    function: str
    advice: str = ""
    compiles: bool = False


class Finding(NamedTuple):
    """The result of a trial. sentence: versions found, or the fault and the advice."""

    name: str
    works: bool
    sentence: str


_COMPILER = "C compiler"
_CACHE = "cache"
TRIALS = (
    Trial("disk", "store"),
    Trial(_COMPILER, "compiler", "Set CC to another compiler."),
    Trial(_CACHE, "cache"),
    Trial(
        "Ipopt", "ipopt", "Run `pip install --force-reinstall pyomo cyipopt-wheels==1.7.0.dev0`."
    ),
    Trial("PyTorch", "gradient", "Run `pip install --force-reinstall 'torch>=2.4'`.", True),
    Trial(
        "FMU",
        "fmu",
        "Run `pip install --force-reinstall fmpy scikit-sundae`, and set TMPDIR to a folder that "
        "allows execution.",
        True,
    ),
)


def try_machine(out: Path, trials: tuple[Trial, ...] | None = None) -> Iterator[Finding]:
    """Yield one finding a trial (default: TRIALS). out: the folder of the campaign."""
    failed: set[str] = set()
    for trial in TRIALS if trials is None else trials:
        if trial.compiles and failed & {_COMPILER, _CACHE}:
            continue
        done = run_isolated(
            f"{__name__}:{trial.function}",
            str(out.absolute()),
            limits=_LIMITS,
            what=trial.name,
        )
        if done.ok:
            yield Finding(trial.name, True, str(done.value))
        else:
            failed.add(trial.name)
            advice = "" if done.ending is Ending.MACHINE else f" {trial.advice}"
            yield Finding(trial.name, False, done.sentence.removeprefix(f"{trial.name}: ") + advice)


# The square root of 2 by Newton's iteration.
_NEWTON = """\
__attribute__((visibility("default"))) double trial(double x)
{
    double y = x;
    for (int i = 0; i < 8; i++) y = (y + x / y) / 2;
    return y;
}
"""


def _compare(what: str, found: float, expected: float, tolerance: float) -> None:
    if not abs(found - expected) <= tolerance * max(1.0, abs(expected)):
        raise ArithmeticError(f"{what} is {found:.12g}, expected {expected:.12g}")


def _write_in(folder: Path, advice: str) -> None:
    """Write a file in this folder, read it back and delete it. Raise MachineError if that fails."""
    try:
        with tempfile.TemporaryDirectory(prefix=".touchstone-trial-", dir=folder) as inside:
            write_durably(Path(inside) / "file", "touchstone")
            if (Path(inside) / "file").read_text() != "touchstone":
                raise OSError(5, "the text reads back differently")
    except (OSError, MachineError) as error:
        cause = error.__cause__ or error
        raise MachineError(
            f"{folder} cannot be written to ({getattr(cause, 'strerror', cause)}); {advice}."
        ) from error


def store(out: str, arrays: Any) -> str:
    """Write in the folder of the campaign, or in its nearest parent, and check the free space."""
    place = next(folder for folder in (Path(out), *Path(out).parents) if folder.exists())
    _write_in(place, "name another folder with --out")
    room = shutil.disk_usage(place).free / 1024**2
    if room < _ROOM_MIB:
        raise MachineError(
            f"{place} has {room:.0f} MiB free, and all scenes need about {_ROOM_MIB} MiB; make room, or name another folder with --out."
        )
    return f"{place} can be written to and has {room / 1024:.1f} GiB free"


def compiler(out: str, arrays: Any) -> str:
    """Compile, load and call a C function."""
    found = find_compiler()
    with tempfile.TemporaryDirectory(prefix="touchstone-trial-") as folder:
        library = Path(folder) / "trial.so"
        compile_shared(found, {"trial.c": _NEWTON}, library)
        function = ctypes.CDLL(str(library)).trial
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
        _compare("the square root of 2 by compiled C", function(2.0), math.sqrt(2.0), 1e-15)
    return found.version


def cache(out: str, arrays: Any) -> str:
    """Write in the folder of compiled scenes and FMUs."""
    folder = cache_folder()
    _write_in(folder, "set TOUCHSTONE_CACHE to another folder")
    return f"compiled scenes and FMUs are kept in {folder}"


def ipopt(out: str, arrays: Any) -> str:
    """Solve problem 71 of Hock and Schittkowski through Pyomo."""
    import pyomo.environ as pyo

    import formulations  # noqa: F401 - registers the solver
    from formulations.ipopt.linear_solver import linear_solver
    from formulations.ipopt.solve import version

    model = pyo.ConcreteModel()
    model.x = pyo.Var(range(4), bounds=(1.0, 5.0), initialize={0: 1.0, 1: 5.0, 2: 5.0, 3: 1.0})
    x = model.x
    model.cost = pyo.Objective(expr=x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2])
    model.product = pyo.Constraint(expr=x[0] * x[1] * x[2] * x[3] >= 25.0)
    model.length = pyo.Constraint(expr=sum(x[i] ** 2 for i in range(4)) == 40.0)
    pyo.SolverFactory("touchstone_ipopt").solve(model)
    _compare(
        "the optimum of problem 71 of Hock and Schittkowski",
        pyo.value(model.cost),
        17.014017289156,
        1e-7,
    )
    return f"{version()} with linear solver {linear_solver()}; the optimum of a known problem is right to 1e-7"


def gradient(out: str, arrays: Any) -> str:
    """Compare a gradient of PyTorch through a compiled rollout with a difference quotient."""
    import torch

    from formulations.shooting.rollout import rollout

    scene = load_scene("three_cart").with_task(steps=40)

    def loss(u: torch.Tensor) -> torch.Tensor:
        return (rollout(scene, u).q[-1] ** 2).sum()

    u = torch.full((40, scene.nu), 0.5, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(loss(u), u)
    with torch.no_grad():
        ahead, behind, step = u.clone(), u.clone(), 1e-4
        ahead[3, 0] += step
        behind[3, 0] -= step
        quotient = float((loss(ahead) - loss(behind)) / (2 * step))
    _compare("a gradient through the compiled rollout", float(slope[3, 0]), quotient, 1e-7)
    return (
        f"{torch.__version__}; a gradient through a compiled rollout equals its difference quotient"
    )


def fmu(out: str, arrays: Any) -> str:
    """Export a scene, simulate its FMU and compare a falling mass with the closed form."""
    from validate.stress.motion import replayed, rolled

    scene = load_scene("bouncing_mass").with_task(steps=5)
    result = replayed(scene, rolled(scene))
    if len(result.t) == 0:
        raise RuntimeError(
            f"the FMU of a scene cannot be simulated: {result.message or result.outcome.value}"
        )
    gravity = scene.parameter_values[next(p.symbol for p in scene.parameters if p.name == "g")]
    time = float(result.t[-1])
    expected = scene.task.start[0] + scene.task.start[1] * time - gravity * time**2 / 2
    _compare("the height of a falling mass in its FMU", float(result.q[-1, 0]), expected, 1e-9)
    return (
        "built, and simulated by Model Exchange and Co-Simulation; a falling mass is right to 1e-9"
    )

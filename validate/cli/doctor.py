"""`doctor`: what this machine can do, tried and not guessed.

Each trial runs a small piece of the real thing in a child (`run_isolated`), returns a sentence of
what was found, and raises where it cannot. It ends with a number that is known beforehand: an
installation that computes something else has failed it. Each imports what it tries by itself: what
cannot be imported is its finding, and nobody else's.

for finding in examine_machine(Path("runs/all")):
    print(finding.name, finding.state, finding.sentence, finding.remedy)
"""

from __future__ import annotations

import ctypes
import json
import math
import platform
import shutil
import tempfile
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import click

from models.catalog import load_scene
from models.codegen.cache import cache_folder
from models.codegen.compiler import compile_shared, find_compiler
from models.errors import MachineError
from validate.cli.options import folder_of
from validate.cli.table import say
from validate.execution.isolated import Isolated, Limits, run_isolated
from validate.execution.process import usable_cores
from validate.store.disk import write_durably

_EPILOG = """\b
Examples:
  python -m validate doctor
  python -m validate doctor --out /data/campaign

Exit codes: 0 `all` works here; 3 something that it needs does not.
"""
# A folder with less room than this [bytes] does not hold a campaign with its FMUs and trajectories.
_ROOM = 500 * 1024**2
_SECONDS = 300.0


class State(Enum):
    """OK; ABSENT: an extra that is not installed, and nothing else is wrong.

    BROKEN: something the main job needs does not work.
    """

    OK = "works"
    ABSENT = "not installed"
    BROKEN = "does not work"


_COLOURS = {State.OK: "green", State.ABSENT: "yellow", State.BROKEN: "red"}


@click.command(epilog=_EPILOG)
@folder_of("--out", "The folder a campaign would use.")
@click.option("--json", "as_json", is_flag=True, help="The findings as JSON on stdout.")
def command(folder: Path, as_json: bool) -> int:
    """Try each thing that `all` needs - compiler, cache, Ipopt, PyTorch, an FMU in a child, the store - and say how to mend what fails."""
    findings = []
    for finding in examine_machine(folder):
        findings.append(finding)
        if not as_json:
            begin, indent = f"{finding.state.value:13}  ", " " * 15
            say(
                f"{finding.name}: {finding.sentence}",
                begin=begin,
                indent=indent,
                colour=_COLOURS[finding.state],
            )
            if finding.remedy:
                say(f"to mend it: {finding.remedy}", begin=indent, indent=indent)
    code = 3 if any(finding.state is State.BROKEN for finding in findings) else 0
    if as_json:
        rows = [finding._asdict() | {"state": finding.state.value} for finding in findings]
        click.echo(json.dumps({"findings": rows, "exit_code": code}, indent=1))
    elif code:
        say("`all` will not work here until what is marked 'does not work' is mended")
    else:
        say("`all` works here: python -m validate all")
    return code


class MachineFinding(NamedTuple):
    """sentence: what was found; remedy: what to do about it ("" if nothing).

    Seconds of the clock.
    """

    name: str
    state: State
    sentence: str
    remedy: str = ""
    seconds: float = 0.0


class Trial(NamedTuple):
    """A small piece of the real thing, run in a child.

    needed: the main job does not work without it; absent: what an empty answer means; remedy: how
        to mend it; rests_on: trials that it cannot pass if
    they fail.
    """

    name: str
    function: str
    remedy: str
    needed: bool = True
    absent: str = ""
    rests_on: tuple[str, ...] = ()


_COMPILED = ("C compiler", "cache")
_MAKE_ROOM = f"choose another folder with --out, or make room in this one: a campaign of all scenes wants about {_ROOM // 1024**2} MiB"
_FOR_FMUS = "pip install --force-reinstall fmpy scikit-sundae; a temporary folder that allows execution (TMPDIR)"
TRIALS = (
    Trial("Python", "interpreter", ""),
    Trial("store", "store", _MAKE_ROOM),
    Trial("C compiler", "compiler", "pip install ziglang, or set CC to a compiler you have"),
    Trial("cache", "cache", "set TOUCHSTONE_CACHE to a folder you can write"),
    Trial("Ipopt", "ipopt", "pip install --force-reinstall cyipopt-wheels==1.7.0.dev0"),
    Trial("PyTorch", "gradient", "pip install --force-reinstall 'torch>=2.4'", rests_on=_COMPILED),
    Trial("FMU", "fmu", _FOR_FMUS, rests_on=_COMPILED),
    Trial(
        "MuJoCo (extra [engines])",
        "other_simulator",
        "pip install mujoco",
        False,
        "engine mujoco and fmu --mjcf will say that they cannot run",
    ),
)


def examine_machine(out: Path, trials: tuple[Trial, ...] = TRIALS) -> Iterator[MachineFinding]:
    """One finding after the other, as they are made. out: the folder a campaign would write to."""
    broken = set()
    for trial in trials:
        limits = Limits(seconds=_SECONDS, memory=16 * 1024**3)
        done = run_isolated(
            f"validate.cli.doctor:{trial.function}",
            str(out.absolute()),
            limits=limits,
            what=trial.name,
        )
        if done.ok and done.value:
            yield MachineFinding(
                name=trial.name, state=State.OK, sentence=str(done.value), seconds=done.wall
            )
            continue
        state, remedy = State.ABSENT, trial.remedy
        if trial.needed and not done.ok:
            first = [name for name in trial.rests_on if name in broken]
            state, remedy = State.BROKEN, f"mend {' and '.join(first)} first" if first else remedy
            broken.add(trial.name)
        sentence = trial.absent if done.ok else _why(done)
        yield MachineFinding(
            name=trial.name, state=state, sentence=sentence, remedy=remedy, seconds=done.wall
        )


def _why(done: Isolated) -> str:
    last = done.output.strip().splitlines()[-1:] or [""]
    return " ".join(
        [
            done.sentence.rstrip("."),
            *(f"(last line of its output: {line.strip()[:200]})" for line in last if line.strip()),
        ]
    )


# The square root of 2 by Newton's iteration.
_NEWTON = """\
__attribute__((visibility("default"))) double trial(double x)
{
    double y = x;
    for (int i = 0; i < 8; i++) y = (y + x / y) / 2;
    return y;
}
"""


class TrialError(MachineError):
    """A trial that ran and found the wrong thing."""


def _compare(what: str, found: float, expected: float, tolerance: float) -> None:
    if not abs(found - expected) <= tolerance * max(1.0, abs(expected)):
        raise TrialError(f"{what} is {found:.12g}, but {expected:.12g} is right.")


def interpreter(out: str, arrays: Any) -> str:
    """Which Python runs, on how many cores."""
    cores = usable_cores()
    return f"Python {platform.python_version()} on {cores} {'core' if cores == 1 else 'cores'}"


def store(out: str, arrays: Any) -> str:
    """Write durably and read back where the campaign would, and leave nothing."""
    place = next(folder for folder in (Path(out), *Path(out).parents) if folder.exists())
    try:
        if not place.is_dir():
            raise NotADirectoryError(20, "there is a file of that name")
        with tempfile.TemporaryDirectory(prefix=".touchstone-doctor-", dir=place) as folder:
            write_durably(Path(folder) / "whole", "touchstone")
            if (Path(folder) / "whole").read_text() != "touchstone":
                raise OSError(5, "what was written reads back differently")
        room = shutil.disk_usage(place).free
    except (OSError, MachineError) as error:
        cause = error.__cause__ or error
        raise TrialError(
            f"{place} cannot be written to ({getattr(cause, 'strerror', cause)})"
        ) from error
    if room < _ROOM:
        raise TrialError(f"{place} can be written to, but has {room / 1024**2:.0f} MiB free.")
    return f"{place} can be written to and has {room / 1024**3:.1f} GiB free"


def compiler(out: str, arrays: Any) -> str:
    """Compile and load a C function."""
    found = find_compiler()
    with tempfile.TemporaryDirectory(prefix="touchstone-doctor-") as folder:
        library = Path(folder) / "trial.so"
        compile_shared(found, {"trial.c": _NEWTON}, library)
        function = ctypes.CDLL(str(library)).trial
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
        _compare("the square root of 2 by compiled C", function(2.0), math.sqrt(2.0), 1e-15)
    return found.version


def cache(out: str, arrays: Any) -> str:
    """Write where compiled scenes and FMUs are kept, and leave nothing."""
    folder = cache_folder()
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix="touchstone-doctor-") as inside:
            Path(inside, "file").write_bytes(b"touchstone")
    except OSError as error:
        raise MachineError(
            f"the cache folder {folder} cannot be written to ({error.strerror})."
        ) from error
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
    return (
        f"{version()}, linear systems by {linear_solver()}; the optimum of a known problem to 1e-7"
    )


def gradient(out: str, arrays: Any) -> str:
    """One gradient of PyTorch through the compiled rollout of the paper's scene, against a difference quotient."""
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
    return f"PyTorch {torch.__version__}, a gradient through the compiled rollout equals its difference quotient"


def fmu(out: str, arrays: Any) -> str:
    """Export a scene, run it by Model Exchange and Co-Simulation, and hold the fall against the closed form."""
    from validate.stress.motion import replayed, rolled

    scene = load_scene("bouncing_mass").with_task(steps=5)
    result = replayed(scene, rolled(scene))
    if len(result.t) == 0:
        raise TrialError(
            f"the FMU of a scene could not be run: {result.message or result.outcome.value}"
        )
    gravity = scene.parameter_values[next(p.symbol for p in scene.parameters if p.name == "g")]
    time = float(result.t[-1])
    expected = scene.task.start[0] + scene.task.start[1] * time - gravity * time**2 / 2
    _compare("the height of a falling mass in its FMU", float(result.q[-1, 0]), expected, 1e-9)
    return (
        "an FMU was exported and run by Model Exchange and Co-Simulation; the fall is right to 1e-9"
    )


def other_simulator(out: str, arrays: Any) -> str:
    """Whether the extra [engines] is there and lets a ball fall."""
    try:
        import mujoco
    except ImportError:
        return ""
    ball = '<body><freejoint/><geom size="0.1"/></body>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option integrator="RK4" gravity="0 0 -8"/><worldbody>{ball}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    _compare(
        "the height of a ball falling in MuJoCo", float(data.qpos[2]), -4.0 * data.time**2, 1e-9
    )
    return f"MuJoCo {mujoco.__version__}; a ball falls right to 1e-9"

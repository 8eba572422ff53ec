"""What an engine is told, what it gives back, and how it is called: in a child with limits, so that a crash, a hang or a missing package is a row.

    name in engine_names(); describe_engine("mujoco").title            # nothing of it is imported
    answer = run_engine("mujoco", scene, drives)  # one motion a drive, or a sentence
    answer.motions[0].q, answer.motions[0].seconds, answer.why

An engine is a file in `engines` (found by its name), which defines `ENGINE` and `simulate`. It
steps a scene from the scene's own parameters; what it cannot express it says by CannotExpressError.
"""

from __future__ import annotations

import importlib
import importlib.util
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from models.errors import MachineError, TouchstoneError, UnknownNameError, did_you_mean
from models.loading import declared
from validate.judge.replay.wiring import Feedback, HeldInputs
from validate.processes.isolated import Ending, Limits, packed, run_isolated, unpacked_from

if (
    TYPE_CHECKING
):  # the child of an engine that needs no scene's equations imports no SymPy before it reads one
    from models.scene import Scene
    from models.trajectory import Trajectory

FOLDER = Path(__file__).parent / "engines"
# The engine that the others are compared with.
REFERENCE = "fmu"
# What a run of an engine may use; the largest of the truth suite, 1000 bounces by SAP, takes some
# 200 s of a quiet core.
LIMITS = Limits(seconds=900.0)


class CannotExpressError(TouchstoneError):
    """An engine has no such thing as a part of a scene; the sentence says which."""


@dataclass(frozen=True, kw_only=True)
class Simulator:
    """What an engine says of itself, in literals.

    title: what it is called; package: what it imports, empty for our own; extra: what brings it;
        tolerances: four that it is told, the loosest first, where it takes no step;
    law: how it makes contact, in a few words.
    """

    title: str
    package: str = ""
    extra: str = "engines"
    tolerances: tuple[float, ...] = ()
    law: str = ""

    @property
    def adaptive(self) -> bool:
        """Whether it chooses its steps."""
        return bool(self.tolerances)


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """A scene to be stepped.

    plan: times (nodes,) [s], inputs (steps, nu) [N, N m] and their hold; the rest of it is not
        looked at. start (2 nq,): positions, then velocities [m, rad,
    m/s, rad/s]. parts: steps of the engine between two nodes; rows: how many of them, evenly, are
        given back; tolerance: relative, of an adaptive engine;
    feedback: what corrects the inputs at each node.
    """

    scene: Scene
    plan: Trajectory
    start: np.ndarray
    parts: int = 1
    rows: int = 1
    tolerance: float = 1e-9
    feedback: Feedback | None = None

    @property
    def step(self) -> float:
        """Of the engine, where it has one [s]: the mean of the plan's over `parts`."""
        return float(np.diff(self.plan.t).mean()) / self.parts


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedMotion:
    """What an engine made of a drive.

    q, v (rows, nq) [m, rad, m/s, rad/s], not finite from where it diverged; applied (steps made,
    nu): inputs with feedback [N, N m]; seconds: of CPU time [s].
    """

    q: np.ndarray
    v: np.ndarray
    seconds: float
    applied: np.ndarray | None = None

    @property
    def finite(self) -> bool:
        """Whether it came to the end."""
        return bool(np.isfinite(self.q).all() and np.isfinite(self.v).all())


class Came(Enum):
    """What came of asking an engine."""

    DONE = "done"
    CANNOT = "cannot express it"
    MISSING = "not installed"
    FAILED = "failed"


@dataclass(frozen=True, kw_only=True, eq=False)
class EngineAnswer:
    """motions: one a drive where it came to its end, else none and a sentence that says why."""

    came: Came
    motions: tuple[SimulatedMotion, ...] = ()
    why: str = ""


def engine_names() -> tuple[str, ...]:
    """Names of the engines, ours first; reads file names only."""
    found = (path.stem for path in FOLDER.glob("*.py") if not path.stem.startswith("_"))
    return tuple(sorted(found, key=lambda name: (not name.startswith("fmu"), name)))


def describe_engine(name: str) -> Simulator:
    """What an engine says of itself, without importing it. Raises UnknownNameError."""
    if name not in engine_names():
        known = f"there are {', '.join(engine_names())}."
        raise UnknownNameError(
            f"there is no engine {name!r}; {did_you_mean(name, engine_names(), known)}"
        )
    return declared(FOLDER / f"{name}.py", "ENGINE", Simulator)


def missing(name: str) -> str:
    """Why an engine cannot run here, and what to do; empty: it can. Raises UnknownNameError."""
    about = describe_engine(name)
    package = about.package
    if not package or importlib.util.find_spec(package) is not None:
        return ""
    return (
        f"engine {name}: the package {package} is not installed; pip install -e '.[{about.extra}]'"
    )


def named_engines(text: str) -> tuple[str, ...]:
    """The engines of a comma-separated list, each once; `all`: those that are installed.

    Raises UnknownNameError, MachineError for one whose package is missing.
    """
    if text.strip() == "all":
        return tuple(name for name in engine_names() if not missing(name))
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise UnknownNameError(
            f"--engine: name at least one engine; there are {', '.join(engine_names())}."
        )
    absent = [sentence for name in names if (sentence := missing(name))]
    if absent:
        raise MachineError(f"{'; '.join(absent)}.")
    return names


def load_engine(name: str) -> Callable[[Drive], SimulatedMotion]:
    """What steps a scene by that engine. Raises ImportError where its package is missing."""
    return importlib.import_module(f"validate.judge.engines.{name}").simulate


def run_engine(name: str, drives: Sequence[Drive], *, limits: Limits = LIMITS) -> EngineAnswer:
    """Make all motions of one scene in a child.

    Parameters
    ----------
    name
        Of the engine.
    drives
        Of one scene, plan and start; they differ in parts and tolerance.
    limits
        Of the child, for all of them together.

    Returns
    -------
    EngineAnswer
        Motions, or a sentence: of what the engine cannot express, of a missing package, of how the
        child ended.

    Raises
    ------
    UnknownNameError
        For an engine that there is not.
    MachineError
        If the temporary folder cannot be written.
    """
    if absent := missing(name):
        return EngineAnswer(came=Came.MISSING, why=absent)
    # A scene has no other form that keeps what a case changed of it.
    done = run_isolated(
        "validate.judge.simulator:answer",
        name,
        packed(*drives),
        limits=limits,
        what=f"engine {name}",
    )
    if done.ending is Ending.ERROR:
        return EngineAnswer(came=Came.CANNOT, why=done.sentence)
    if not done.ok:
        return EngineAnswer(came=Came.FAILED, why=done.sentence)
    found = done.arrays
    motions = tuple(
        SimulatedMotion(
            q=found[f"{number}_q"],
            v=found[f"{number}_v"],
            applied=found.get(f"{number}_applied"),
            seconds=seconds,
        )
        for number, seconds in enumerate(done.value)
    )
    return EngineAnswer(came=Came.DONE, motions=motions)


def answer(
    name: str, arrays: Mapping[str, np.ndarray]
) -> tuple[list[float], dict[str, np.ndarray]]:
    """In the child: all motions of the engine.

    Parameters
    ----------
    name
        Of the engine.
    arrays
        The drives, packed (n,) [-].

    Returns
    -------
    tuple
        CPU seconds of each motion [s]; q, v (rows, nq) of each [m, rad, m/s, rad/s].

    Raises
    ------
    CannotExpressError
        Of the engine.
    """
    simulate, value, found = load_engine(name), [], {}
    for number, drive in enumerate(unpacked_from(arrays)):
        motion = simulate(drive)
        value.append(motion.seconds)
        found |= {
            f"{number}_{part}": array
            for part in ("q", "v", "applied")
            if (array := getattr(motion, part)) is not None
        }
    return value, found


def stepped(
    drive: Drive,
    advance: Callable[[np.ndarray, np.ndarray, int, float], tuple[np.ndarray, np.ndarray]],
) -> SimulatedMotion:
    """The motion row by row, by an engine that holds its state.

    Parameters
    ----------
    drive
        What is to be done.
    advance
        Under inputs (nu,) [N, N m] that change by so much a second (nu,) makes so many steps of so many seconds [s], and gives positions and velocities
        (nq,) [m, rad, m/s, rad/s].

    Returns
    -------
    SimulatedMotion
        NaN from where a number was not finite.

    Raises
    ------
    CannotExpressError
        Whatever `advance` raises.
    """
    nq, inputs, count = (
        drive.scene.nq,
        HeldInputs(drive.plan, drive.feedback),
        drive.parts // drive.rows,
    )
    steps, u = np.diff(drive.plan.t), np.zeros(drive.scene.nu)
    states = np.full((drive.plan.steps * drive.rows + 1, 2 * nq), np.nan)
    states[0] = drive.start
    began = time.process_time()
    for row in range(len(states) - 1):
        interval, part = divmod(row, drive.rows)
        if part == 0:
            u = inputs.begin(interval, states[row])
        h, slope = float(steps[interval]), inputs.slopes[interval]
        state = np.concatenate(
            advance(u + slope * (h * part / drive.rows), slope, count, h / drive.parts)
        )
        if not np.isfinite(state).all():
            break
        states[row + 1] = state
    applied = None if drive.feedback is None else inputs.values
    return SimulatedMotion(
        q=states[:, :nq], v=states[:, nq:], seconds=time.process_time() - began, applied=applied
    )

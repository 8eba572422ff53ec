"""Run an engine (another simulator) in a child process with limits.

    name in engine_names(); describe_engine("mujoco").title       # imports no engine
    answer = run_engine("mujoco", drives)  # one motion per drive, or a sentence
    answer.motions[0].q, answer.motions[0].seconds, answer.why

An engine is a file in `adapters` that defines `ENGINE` and `simulate`; unsupported parts of a scene
raise CannotExpressError. A crash, a hang or a missing package becomes a row.
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

if TYPE_CHECKING:  # SymPy is imported only by engines that read equations
    from models.scene import Scene
    from models.trajectory import Trajectory

FOLDER = Path(__file__).parent / "adapters"
# Engine that all others are compared with.
REFERENCE = "fmu"
# The largest run of the truth suite, 1000 bounces by SAP, takes some 200 s of a quiet core.
LIMITS = Limits(seconds=900.0)


class CannotExpressError(TouchstoneError):
    """The engine does not support a part of the scene."""


@dataclass(frozen=True, kw_only=True)
class Simulator:
    """Description of an engine, in literals.

    - package: imported package, empty for ours.
    - extra: dependency group that installs the package.
    - tolerances: four, the loosest first, of an engine that takes no step.
    - law: contact law.
    """

    title: str
    package: str = ""
    extra: str = "engines"
    tolerances: tuple[float, ...] = ()
    law: str = ""

    @property
    def adaptive(self) -> bool:
        """Return whether the engine chooses its steps."""
        return bool(self.tolerances)


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """A scene to step under a plan's times (nodes,) [s], inputs (steps, nu) [N, N m] and hold.

    - start: (2 nq,) positions, then velocities [m, rad, m/s, rad/s].
    - parts: engine steps between nodes.
    - rows: number of them to return, evenly spaced.
    - tolerance: relative, of an adaptive engine.
    - feedback: correction of the inputs at each node.
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
        """Return the engine's step [s]: the plan's mean step over `parts`."""
        return float(np.diff(self.plan.t).mean()) / self.parts


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedMotion:
    """Motion of a drive: q, v (rows, nq) [m, rad, m/s, rad/s], not finite once diverged.

    applied: (steps, nu) inputs with feedback [N, N m]. seconds: CPU time [s].
    """

    q: np.ndarray
    v: np.ndarray
    seconds: float
    applied: np.ndarray | None = None

    @property
    def finite(self) -> bool:
        """Return whether all numbers are finite."""
        return bool(np.isfinite(self.q).all() and np.isfinite(self.v).all())


class Came(Enum):
    """Status of an engine's run."""

    DONE = "done"
    CANNOT = "cannot express it"
    MISSING = "not installed"
    FAILED = "failed"


@dataclass(frozen=True, kw_only=True, eq=False)
class EngineAnswer:
    """One motion per drive, or none and a reason."""

    came: Came
    motions: tuple[SimulatedMotion, ...] = ()
    why: str = ""


def engine_names() -> tuple[str, ...]:
    """Return the names of the engines, ours first; reads file names only."""
    names = (path.stem for path in FOLDER.glob("*.py") if not path.stem.startswith("_"))
    return tuple(sorted(names, key=lambda name: (not name.startswith("fmu"), name)))


def describe_engine(name: str) -> Simulator:
    """Return an engine's description without importing the engine. Raises UnknownNameError."""
    if name not in engine_names():
        known = f"there are {', '.join(engine_names())}."
        raise UnknownNameError(
            f"there is no engine {name!r}; {did_you_mean(name, engine_names(), known)}"
        )
    return declared(FOLDER / f"{name}.py", "ENGINE", Simulator)


def missing(name: str) -> str:
    """Return why an engine cannot run here, or "". Raises UnknownNameError."""
    about = describe_engine(name)
    package = about.package
    if not package or importlib.util.find_spec(package) is not None:
        return ""
    return (
        f"engine {name}: the package {package} is not installed; pip install -e '.[{about.extra}]'"
    )


def named_engines(text: str) -> tuple[str, ...]:
    """Return the engines of a comma-separated list, each once; `all`: every installed engine.

    Raises UnknownNameError, and MachineError for a missing package.
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
    """Return the engine's `simulate`. Raises ImportError if its package is missing."""
    return importlib.import_module(f"validate.judge.engines.adapters.{name}").simulate


def run_engine(name: str, drives: Sequence[Drive], *, limits: Limits = LIMITS) -> EngineAnswer:
    """Run all drives of one scene in one child process.

    Parameters
    ----------
    name
        Engine.
    drives
        Equal but for parts and tolerance.
    limits
        Limits for all drives together.

    Returns
    -------
    EngineAnswer
        Motions, or why there are none.

    Raises
    ------
    UnknownNameError
        For an unknown engine.
    MachineError
        If the temporary folder cannot be written.
    """
    if absent := missing(name):
        return EngineAnswer(came=Came.MISSING, why=absent)
    # Pickled: no file format keeps the changes that a case makes to a scene.
    done = run_isolated(
        "validate.judge.engines.simulator:answer",
        name,
        packed(*drives),
        limits=limits,
        what=f"engine {name}",
    )
    if done.ending is Ending.ERROR:
        return EngineAnswer(came=Came.CANNOT, why=done.sentence)
    if not done.ok:
        return EngineAnswer(came=Came.FAILED, why=done.sentence)
    arrays = done.arrays
    motions = tuple(
        SimulatedMotion(
            q=arrays[f"{number}_q"],
            v=arrays[f"{number}_v"],
            applied=arrays.get(f"{number}_applied"),
            seconds=seconds,
        )
        for number, seconds in enumerate(done.value)
    )
    return EngineAnswer(came=Came.DONE, motions=motions)


def answer(
    name: str, arrays: Mapping[str, np.ndarray]
) -> tuple[list[float], dict[str, np.ndarray]]:
    """Run all drives, packed (n,) [-], in the child process.

    Returns the CPU seconds [s] and q, v (rows, nq) [m, rad, m/s, rad/s] of each motion. Raises
    CannotExpressError.
    """
    simulate, value, results = load_engine(name), [], {}
    for number, drive in enumerate(unpacked_from(arrays)):
        motion = simulate(drive)
        value.append(motion.seconds)
        results |= {
            f"{number}_{part}": array
            for part in ("q", "v", "applied")
            if (array := getattr(motion, part)) is not None
        }
    return value, results


def stepped(
    drive: Drive,
    advance: Callable[[np.ndarray, np.ndarray, int, float], tuple[np.ndarray, np.ndarray]],
) -> SimulatedMotion:
    """Return the motion of a drive by an engine that keeps its own state; NaN once diverged.

    advance: takes inputs (nu,) [N, N m], their slopes (nu,) [N/s, N m/s], a number of steps and the
    step [s]; returns positions and velocities (nq,) [m, rad, m/s, rad/s]. Raises errors of
    `advance`.
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

"""What an engine is told, what it gives back, and how it is called: in a child with limits, so that a crash, a hang or a missing package is a row.

    name in engine_names(); describe_engine("mujoco").title            # nothing of it is imported
    answer = run_engine("mujoco", scene, drives)                       # one motion a drive, or a sentence
    answer.motions[0].q, answer.motions[0].seconds, answer.why

An engine is a file in `engines` (found by its name), which defines `ENGINE` and `simulate`. It steps a scene from the scene's own parameters; what it
cannot express it says by CannotExpressError.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.errors import MachineError, TouchstoneError, UnknownNameError, did_you_mean
from models.trajectory import Hold, Trajectory
from validate.execution.isolated import Ending, Limits, run_isolated

if TYPE_CHECKING:  # the child of an engine that needs no scene's equations imports no SymPy before it reads one
    from models.scene import Scene

FOLDER = Path(__file__).parent / "engines"
_INSTALL = "pip install -e '.[engines]'"
# What a run of an engine may use; the largest of the truth suite takes some 20 s of it on a quiet core.
LIMITS = Limits(seconds=300.0)


class CannotExpressError(TouchstoneError):
    """An engine has no such thing as a part of a scene; the sentence says which."""


@dataclass(frozen=True, kw_only=True)
class Simulator:
    """What an engine says of itself, in literals.

    title: what it is called; package: what it imports, empty for our own; adaptive: whether a tolerance and no step is what it is told; law: how it makes
    contact, in a few words; softens: what is its own and no part of any scene, that `Drive.soft` scales, empty where there is nothing.
    """

    title: str
    package: str = ""
    adaptive: bool = False
    law: str = ""
    softens: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """A scene to be stepped.

    plan: times (nodes,) [s], inputs (steps, nu) [N, N m] and their hold; the rest of it is not looked at. start (2 nq,): positions, then velocities [m, rad,
    m/s, rad/s]. parts: steps of the engine between two nodes; tolerance: relative, of an adaptive engine; soft: what its own regularisation is scaled by.
    """

    scene: Scene
    plan: Trajectory
    start: np.ndarray
    parts: int = 1
    tolerance: float = 1e-9
    soft: float = 1.0

    def inputs(self, step: int, share: float) -> np.ndarray:
        """Inputs within a step.

        Parameters
        ----------
        step
            Its number.
        share
            How far into it, from 0 to 1.

        Returns
        -------
        np.ndarray
            (nu,) [N, N m].

        Raises
        ------
        IndexError
            For a step that the plan does not have.
        """
        begin = self.plan.u[step]
        if self.plan.hold is Hold.ZERO_ORDER:
            return begin
        last = begin if self.plan.u_end is None else self.plan.u_end
        return begin + share * ((self.plan.u[step + 1] if step + 1 < self.plan.steps else last) - begin)


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedMotion:
    """What an engine made of a drive: q, v (nodes, nq) [m, rad, m/s, rad/s], not finite from where it diverged; its steps, 0 where it does not count them, and CPU seconds [s]."""

    q: np.ndarray
    v: np.ndarray
    steps: int
    seconds: float

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
    found = sorted(path.stem for path in FOLDER.glob("*.py") if not path.stem.startswith("_"))
    return tuple(sorted(found, key=lambda name: not name.startswith("fmu")))


def describe_engine(name: str) -> Simulator:
    """What an engine says of itself, without importing it. Raises UnknownNameError."""
    if name not in engine_names():
        known = f"there are {', '.join(engine_names())}."
        raise UnknownNameError(f"there is no engine {name!r}; {did_you_mean(name, engine_names(), known)}")
    tree = ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and getattr(node.targets[0], "id", "") == "ENGINE":
            return Simulator(**{word.arg: ast.literal_eval(word.value) for word in node.value.keywords if word.arg})
    raise UnknownNameError(f"engine file {name}.py: it must define ENGINE = Simulator(...) with literals.")


def missing(name: str) -> str:
    """Why an engine cannot run here, and what to do; empty: it can. Raises UnknownNameError."""
    package = describe_engine(name).package
    if not package or importlib.util.find_spec(package) is not None:
        return ""
    return f"engine {name}: the package {package} is not installed; {_INSTALL}"


def load_engine(name: str) -> Callable[[Drive], SimulatedMotion]:
    """What steps a scene by that engine. Raises UnknownNameError, MachineError where its package is missing."""
    absent = missing(name)
    if absent:
        raise MachineError(f"{absent}.")
    return importlib.import_module(f"validate.judge.engines.{name}").simulate


def run_engine(name: str, drives: Sequence[Drive], *, limits: Limits = LIMITS) -> EngineAnswer:
    """Make all motions of one scene in a child.

    Parameters
    ----------
    name
        Of the engine.
    drives
        Of one scene, plan and start; they differ in parts, tolerance and softness.
    limits
        Of the child, for all of them together.

    Returns
    -------
    EngineAnswer
        Motions, or a sentence: of what the engine cannot express, of a missing package, of how the child ended.

    Raises
    ------
    UnknownNameError
        For an engine that there is not.
    MachineError
        If the temporary folder cannot be written.
    """
    absent, first = missing(name), drives[0]
    if absent:
        return EngineAnswer(came=Came.MISSING, why=absent)
    plan = first.plan
    request = {
        "engine": name,
        "hold": plan.hold.value,
        "drives": [{"parts": drive.parts, "tolerance": drive.tolerance, "soft": drive.soft} for drive in drives],
    }
    # Our own bytes, in a folder of our own: a scene has no other form that keeps what a case changed of it.
    arrays = {"scene": np.frombuffer(pickle.dumps(first.scene), dtype=np.uint8), "t": plan.t, "u": plan.u, "start": first.start}
    arrays |= {} if plan.u_end is None else {"u_end": plan.u_end}
    done = run_isolated("validate.judge.simulator:answer", request, arrays, limits=limits, what=f"engine {name}")
    if done.ending is Ending.ERROR:
        return EngineAnswer(came=Came.CANNOT, why=done.sentence)
    if not done.ok:
        return EngineAnswer(came=Came.FAILED, why=done.sentence)
    motions = tuple(
        SimulatedMotion(q=done.arrays[f"{number}_q"], v=done.arrays[f"{number}_v"], steps=told["steps"], seconds=told["seconds"])
        for number, told in enumerate(done.value)
    )
    return EngineAnswer(came=Came.DONE, motions=motions)


def answer(request: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
    """In the child: all motions of the request.

    Parameters
    ----------
    request
        As `run_engine` writes it.
    arrays
        scene: its bytes; t (nodes,) [s], u (steps, nu) [N, N m], start (2 nq,) [m, rad, m/s, rad/s], u_end (nu,) where there is one.

    Returns
    -------
    tuple
        What JSON holds of each motion; q, v (nodes, nq) of each [m, rad, m/s, rad/s].

    Raises
    ------
    CannotExpressError
        Of the engine.
    """
    simulate, scene = load_engine(request["engine"]), pickle.loads(arrays["scene"].tobytes())
    nothing = np.zeros((len(arrays["t"]), 0))
    plan = Trajectory(
        t=arrays["t"], q=nothing, v=nothing, u=arrays["u"], lam=nothing[1:], hold=Hold(request["hold"]), u_end=arrays.get("u_end")
    )
    value, found = [], {}
    for number, told in enumerate(request["drives"]):
        motion = simulate(Drive(scene=scene, plan=plan, start=arrays["start"], **told))
        value.append({"steps": motion.steps, "seconds": motion.seconds})
        found |= {f"{number}_q": motion.q, f"{number}_v": motion.v}
    return value, found


def stepped(drive: Drive, advance: Callable[[int], tuple[np.ndarray, np.ndarray]], *, steps: int) -> SimulatedMotion:
    """The motion node by node, by an engine that holds its state.

    Parameters
    ----------
    drive
        What is to be done.
    advance
        Steps over an interval, by its number, and gives positions and velocities (nq,) at its end [m, rad, m/s, rad/s].
    steps
        How many the engine makes in all.

    Returns
    -------
    SimulatedMotion
        NaN from where a number was not finite.

    Raises
    ------
    CannotExpressError
        Whatever `advance` raises.
    """
    nq = drive.scene.nq
    states = np.full((len(drive.plan.t), 2 * nq), np.nan)
    states[0] = drive.start
    began = time.process_time()
    for interval in range(drive.plan.steps):
        state = np.concatenate(advance(interval))
        if not np.isfinite(state).all():
            break
        states[interval + 1] = state
    return SimulatedMotion(q=states[:, :nq], v=states[:, nq:], steps=steps, seconds=time.process_time() - began)


def finer(drive: Drive, factor: int) -> Drive:
    """The same with so many times as many steps, and a tolerance smaller by its square."""
    return replace(drive, parts=drive.parts * factor, tolerance=drive.tolerance / factor**2)

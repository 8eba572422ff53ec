"""Time steps, by a scheme of ours or a Python function, and their energy test in free motion.

    step = load_step("their_step.py:step")  # step(q, v, u, h, parameters) -> (q, v)
    step_defect(scene, step, plan)  # does the plan solve this step: at most 1 if it does
    print(energy_test(scene, step).sentence)  # does the step follow the scene's energies

`parameters` has the numbers of the scene by name and, if the plan claims contact and friction
forces, these forces over the step. In free motion inputs and forces are 0.

Free motion at the steps h, h/5 and h/25 must keep the balance of the scene's energies better and
better, since the motion itself keeps the balance exactly. A step that converges to other equations
leaves an error that does not vanish with h.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np

from models.dynamics import derive
from models.errors import TouchstoneError
from models.loading import Afresh, loading
from models.scene import Scene
from models.schemes import Scheme, tableau
from models.trajectory import Trajectory
from validate.judge.printed import columns_rounding
from validate.judge.score.measures import LEAST_ORDER

Step: TypeAlias = Callable[
    [np.ndarray, np.ndarray, np.ndarray, float, Mapping[str, float]], tuple[Any, Any]
]

# A defect of this share of the nominal is allowed in a step, as in the metric `defect`.
_ALLOWED = 1e-6
# The steps of the energy test are the task's step divided by these.
_DIVISORS = (1, 5, 25)
# Free motion lasts this many of the task's steps: a second or more at the usual steps, in which
# coordinates move by their nominals.
_STEPS = 40
# Starts of the energy test, each with other positions and velocities.
_STARTS = 3
# An energy error below this share of the energy turned over is the error of a nonlinear solve.
_ROUNDING = 1e-9


class StepError(TouchstoneError):
    """A time step that cannot be loaded, or returns no state."""


@dataclass(frozen=True)
class EnergyTest:
    """The energy error of free motion at three step sizes.

    Attributes
    ----------
    steps
        (3,) [s].
    errors
        (3,) largest energy error over the starts [J].
    turnover
        Kinetic energy and range of the potential energy [J].
    order
        Order of the error between the two smallest steps; infinite if the error is rounding.
    """

    scene: str
    steps: tuple[float, ...]
    errors: tuple[float, ...]
    turnover: float
    order: float

    @property
    def vanishes(self) -> bool:
        """Return whether the energy error vanishes with the step."""
        return self.order >= LEAST_ORDER

    @property
    def sentence(self) -> str:
        """Return the answer in one sentence."""
        errors = ", ".join(f"{error:.3g}" for error in self.errors)
        steps = ", ".join(f"{step:.3g}" for step in self.steps)
        what = f"errors {errors} J at steps of {steps} s, {self.turnover:.3g} J turned over"
        if math.isinf(self.order):
            return f"The step keeps the energy of {self.scene} to rounding ({what})."
        if self.vanishes:
            return f"The energy error vanishes with the step, with order {self.order:.2g} ({what})."
        return (
            f"The energy error does not vanish with the step: the step solves other equations than "
            f"those of {self.scene} ({what})."
        )


def load_step(reference: str) -> Step:
    """Return the function of `FILE.py:NAME`. Raises StepError."""
    file, _, name = reference.rpartition(":")
    path = Path(file)
    if not file or not name.isidentifier():
        raise StepError(
            f"time step {reference!r}: expected FILE.py:FUNCTION or one of {', '.join(scheme.value for scheme in Scheme)}."
        )
    if not path.is_file():
        raise StepError(f"time step {reference}: there is no file {path}; check its path.")
    module_name = f"_touchstone_step_{path.stem}"
    spec = importlib.util.spec_from_file_location(
        module_name, path, loader=Afresh(module_name, str(path))
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        with loading(path.resolve()):
            spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a file may raise what it likes
        raise StepError(
            f"time step {reference}: {type(error).__name__} while the file was read: {error}"
        ) from error
    function = getattr(module, name, None)
    if not callable(function):
        raise StepError(f"time step {reference}: the file has no function {name!r}.")
    return cast(Step, function)


def take_step(
    scene: Scene,
    step: Step,
    q: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    h: float,
    parameters: Mapping[str, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Call a time step once.

    Parameters
    ----------
    q, v : (nq,) positions [m or rad] and velocities [m/s or rad/s].
    u : (nu,) inputs [N or N m].
    h : step [s].
    parameters : numbers by name, in the scene's units.

    Returns
    -------
    q, v : (nq,) at the end of the step [m or rad, m/s or rad/s].

    Raises
    ------
    StepError : if the function raises, or does not return two finite arrays of shape (nq,).
    """
    where = f"time step on scene {scene.name}"
    try:
        answer = step(q.copy(), v.copy(), u.copy(), float(h), dict(parameters))
        following = [np.asarray(part, dtype=float) for part in answer]
    except TouchstoneError:
        raise
    except Exception as error:
        raise StepError(f"{where}: {type(error).__name__}: {error}; see step(q, v, u, h, parameters) -> (q, v).") from error  # fmt: skip
    if [part.shape for part in following] != [(scene.nq,)] * 2:
        shapes = " and ".join(str(part.shape) for part in following)
        raise StepError(
            f"{where}: it returned arrays of shape {shapes}, expected q and v of shape ({scene.nq},)."
        )
    if not all(np.isfinite(part).all() for part in following):
        raise StepError(f"{where}: it returned a number that is not finite at h = {h:g} s.")
    return following[0], following[1]


def numbers_of(scene: Scene) -> dict[str, float]:
    """Return the parameters of the scene by name, and its contact and friction forces as 0."""
    forces = dict.fromkeys(scene.force_names, 0.0)
    return {**forces, **{item.name: item.value for item in scene.parameters}}


def step_defect(scene: Scene, step: Step, plan: Trajectory) -> float:
    """Return the largest miss of a plan in this time step, over what is allowed.

    Parameters
    ----------
    scene, step : the scene, whose parameters the step is given.
    plan : steps of (steps, nu) inputs and (steps, nl) forces between (nodes, nq) states [SI].

    Returns
    -------
    miss : 1 is a miss of 1e-6 of the nominal beyond the rounding of the plan's digits [-].

    Raises
    ------
    StepError : if the step is not evaluated.
    """
    nominal = np.array([item.nominal for item in scene.coordinates])
    of_q, of_v = (columns_rounding(part, nominal).max(axis=0) for part in (plan.q, plan.v))
    numbers, worst = numbers_of(scene), 0.0
    for k, h in enumerate(np.diff(plan.t)):
        forces = dict(zip(scene.force_names, plan.lam[k].tolist(), strict=True))
        q, v = take_step(scene, step, plan.q[k], plan.v[k], plan.u[k], h, numbers | forces)
        # Velocities of a step are differences of positions over h, or the other way.
        allowed_q = _ALLOWED * nominal + 2.0 * (of_q + h * of_v)
        allowed_v = _ALLOWED * nominal + 2.0 * (of_v + of_q / h)
        worst = max(
            worst,
            float((np.abs(q - plan.q[k + 1]) / allowed_q).max()),
            float((np.abs(v - plan.v[k + 1]) / allowed_v).max()),
        )
    return worst


def energy_test(scene: Scene, step: Step | Scheme | str) -> EnergyTest:
    """Test whether the energy error of free motion vanishes with the time step.

    Inputs, contacts and friction are left out. Work of the scene's own passive forces, such as
    damping, is accounted for. Raises StepError.
    """
    if isinstance(step, str) and step in [scheme.value for scheme in Scheme]:
        step = Scheme(step)
    if isinstance(step, Scheme):
        step = scheme_step(scene, step)
    elif isinstance(step, str):
        step = load_step(step)
    energy = _Energy(scene)
    turned = 0.0
    steps = tuple(scene.task.step / divisor for divisor in _DIVISORS)
    errors = np.zeros((_STARTS, len(steps)))
    for row, (q, v) in enumerate(_starts(scene)):
        for column, divisor in enumerate(_DIVISORS):
            path = _free_motion(scene, step, q, v, steps[column], _STEPS * divisor)
            errors[row, column], turnover = energy.error(path, steps[column])
            turned = max(turned, turnover)
    largest = errors.max(axis=0)
    if turned <= 0.0:
        raise StepError(f"energy test: free motion of scene {scene.name} turns over no energy.")
    if largest[-1] <= _ROUNDING * turned:
        order = math.inf
    else:
        order = math.log(largest[-2] / largest[-1]) / math.log(_DIVISORS[-1] / _DIVISORS[-2])
    return EnergyTest(
        scene=scene.name,
        steps=steps,
        errors=tuple(map(float, largest)),
        turnover=turned,
        order=order,
    )


def _starts(scene: Scene) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return states near the task's start in which every coordinate moves, equal on every run."""
    nominal = np.array([item.nominal for item in scene.coordinates])
    first = np.array(scene.task.start[: scene.nq], dtype=float)
    random = np.random.default_rng(0)
    return [
        (
            first + nominal * random.uniform(-1, 1, scene.nq),
            nominal * random.uniform(1, 2, scene.nq),
        )
        for _ in range(_STARTS)
    ]


def _free_motion(
    scene: Scene, step: Step, q: np.ndarray, v: np.ndarray, h: float, steps: int
) -> np.ndarray:
    """Return the states (steps + 1, 2 nq) of free motion [SI]. Raises StepError."""
    numbers, u = numbers_of(scene), np.zeros(scene.nu)
    path = [np.concatenate([q, v])]
    for _ in range(steps):
        q, v = take_step(scene, step, q, v, u, h, numbers)
        path.append(np.concatenate([q, v]))
    return np.array(path)


class _Energy:
    """The energies of a scene without its contacts, as functions of states."""

    def __init__(self, scene: Scene) -> None:
        dynamics = derive(scene)
        self._values = dynamics.function(
            [dynamics.kinetic_energy, dynamics.potential_energy, dynamics.dissipated_power],
            dynamics.q,
            dynamics.v,
        )
        self._nq = scene.nq

    def error(self, path: np.ndarray, h: float) -> tuple[float, float]:
        """Return the largest error of the energy balance and the energy turned over [J]."""
        rows = [self._values(state[: self._nq], state[self._nq :]).ravel() for state in path]
        kinetic, potential, power = np.array(rows).T
        work = np.concatenate([[0.0], np.cumsum(h * (power[1:] + power[:-1]) / 2.0)])
        balance = kinetic + potential + work
        return float(np.abs(balance - balance[0]).max()), float(kinetic.max() + np.ptp(potential))


def scheme_step(scene: Scene, scheme: Scheme) -> Step:
    """Return the step of one of our schemes on this scene, without contacts and friction.

    The step uses the scene's own parameters. Raises StepError if a stage has no solution.
    """
    dynamics = derive(scene)
    mass = dynamics.function(dynamics.mass_matrix, dynamics.q)
    force = dynamics.function(dynamics.tau, dynamics.q, dynamics.v, dynamics.u)
    nq = scene.nq

    def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        q, v = x[:nq], x[nq:]
        return np.concatenate([v, np.linalg.solve(mass(q), force(q, v, u).ravel())])

    def semi_implicit(q, v, u, h, parameters):
        v = v + h * rate(np.concatenate([q, v]), u)[nq:]
        return q + h * v, v

    if scheme is Scheme.SEMI_IMPLICIT_EULER:
        return semi_implicit
    from scipy.optimize import root  # every run imports this module, and few need a solver

    table = tableau(scheme)

    def collocated(q, v, u, h, parameters):
        x = np.concatenate([q, v])

        def residual(slopes: np.ndarray) -> np.ndarray:
            slopes = slopes.reshape(table.stages, 2 * nq)
            stages = x + h * table.a @ slopes
            return (slopes - np.array([rate(stage, u) for stage in stages])).ravel()

        solved = root(residual, np.tile(rate(x, u), table.stages), tol=1e-13)
        # A solve whose last step is at rounding reports no progress.
        if np.abs(solved.fun).max() > 1e-9 * max(1.0, np.abs(solved.x).max()):
            raise StepError(f"scheme {scheme.value} on scene {scene.name}: a step has no solution.")
        x = x + h * table.b @ solved.x.reshape(table.stages, 2 * nq)
        return x[:nq], x[nq:]

    return collocated

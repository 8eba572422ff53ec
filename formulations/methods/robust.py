"""A plan for several worlds at once: the same inputs drive copies of the scene in which a number is otherwise, in one model of exact contact.

    copy 0: the scene itself, which reaches the goal        the others: the numbers that harm its own plan most, each moved by its size both ways
    least  mean over the copies of their cost  +  weight * cost of the plan for the scene alone * mean of (miss/limit)^2

Numbers are parameters, gains of the inputs and the start, sizes those of models.scene.uncertainty. The copies are bodies that never meet, so they are one scene:
`mpcc` plans for the scene alone, and `strict_lcp` for all from what the inputs of that plan do in each world, where every contact law is met; so contacts begin in the modes of
the exact plan. Noise and delay are left out: no input is known in advance that would be better against them. Where the end is free, what is averaged is the cost alone.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from time import monotonic
from typing import Any

import numpy as np
import sympy as sp

from formulations.contact_modes.method import why_not
from formulations.method import Clock, Kind, Method, Options, Session, option
from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from models.codegen.kernel import Rollout, load_kernel
from models.scene import Scene
from models.scene.goal import goal_state, miss
from models.scene.uncertainty import GAIN, START, size_of
from models.trajectory import Trajectory

_ENDS = ("replay_terminal_position_error", "replay_terminal_velocity_error")


@dataclass(frozen=True, kw_only=True)
class RobustOptions(Options):
    """Options of `robust`."""

    pairs: int = option(
        2, "numbers that are otherwise, each both ways: those that harm most; the work grows faster than their number", lower=1, upper=32
    )
    weight: float = option(3.0, "what a mean miss of its limit costs, as a share of the cost of the plan for the scene alone", lower=0.0)
    scale: float = option(1.0, "by how many of their sizes they are otherwise", lower=0.0, upper=10.0)
    # Where it solved a scene it took 83 (hopper) to 390 (cart_chain) of these; acrobot_limits had no plan after 1,000, in 153 CPU s.
    max_iterations: int = option(500, "most Ipopt iterations of the plan for all worlds", lower=1, upper=10**9)


def ensemble(scene: Scene, points: np.ndarray, weight: float) -> Scene:
    """The scene and other worlds as one scene of the same inputs, the scene's own coordinates and contacts first.

    Parameters
    ----------
    points : (worlds, np + nu + 2*nq) by how many sizes parameters, gains and start of each world are otherwise [-]
    weight : of the mean of (miss/limit)^2 over the worlds [unit of the cost]

    Raises
    ------
    SceneError : where they do not fit into one scene.
    ValueError : for points of another width.
    """
    copies = [_copy(scene, number, point, weight) for number, point in enumerate([np.zeros(_width(scene)), *points])]
    both = partial(_joined, copies)
    mean = {name: sum(copy[name] for copy in copies) / len(copies) for name in ("running_cost", "final_cost")}
    task = replace(scene.task, start=both("q0") + both("v0"), goal=both("q_goal") + both("v_goal"), **mean)
    return replace(
        scene, name=f"{scene.name}_in_{len(copies)}_worlds", coordinates=both("coordinates"), contacts=both("contacts"), forces=both("forces"), task=task,
        kinetic_energy=sum(copy["kinetic_energy"] for copy in copies), potential_energy=sum(copy["potential_energy"] for copy in copies), answers=(), shapes=(),
    )  # fmt: skip


def harmful(scene: Scene, plan: Trajectory, pairs: int) -> np.ndarray:
    """The worlds in which the plan's inputs miss most where one number is otherwise: of so many numbers, each moved by its size both ways.

    Returns
    -------
    points : (2*pairs, np + nu + 2*nq) as `ensemble` takes them [-]

    Raises
    ------
    ValueError : if the plan's inputs are not the scene's.
    """
    ways = np.eye(_width(scene))
    harm = [max(_harm(scene, plan, point), _harm(scene, plan, -point)) for point in ways]
    return np.array([sign * ways[place] for place in np.argsort(harm)[::-1][:pairs] for sign in (1.0, -1.0)])


def _harm(scene: Scene, plan: Trajectory, point: np.ndarray) -> float:
    """How far the inputs of a plan end from the goal in a world, in squares of limits; where the end is free, what they cost; by the scene's own time step."""
    motion = _driven(scene, point, plan.u)
    if motion.diverged:
        return np.inf
    if not scene.task.has_goal:
        return load_kernel(scene).cost(motion.q, motion.v, plan.u)
    missed = miss(np.concatenate([motion.q[-1], motion.v[-1]]), goal_state(scene.task))
    return sum(float(part @ part) / limit**2 for part, limit in zip(np.split(missed, 2), _limits(scene), strict=True) if limit)


def _driven(scene: Scene, point: np.ndarray, u: np.ndarray) -> Rollout:
    """What inputs (steps, nu) do in a world, by the scene's own time step."""
    values, gains, moved = _otherwise(scene, point)
    return load_kernel(scene.with_parameters(**values)).rollout(np.array(scene.task.start) + moved, u * gains, scene.task.step)


def _width(scene: Scene) -> int:
    return len(scene.parameters) + scene.nu + 2 * scene.nq


def _limits(scene: Scene) -> list[float | None]:
    """How far positions and velocities may end from the goal; None where that is not limited."""
    return [limit.value if (limit := scene.limit(name)) is not None else None for name in _ENDS]


def _otherwise(scene: Scene, point: np.ndarray) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """Values of the parameters by name, gains (nu,), and by how much the start (2*nq,) is moved."""
    moved, gains, start = np.split(point, [len(scene.parameters), len(scene.parameters) + scene.nu])
    values = {item.name: item.value + size_of(item) * float(by) for item, by in zip(scene.parameters, moved, strict=True)}
    return values, 1.0 + GAIN * gains, START * np.tile([item.nominal for item in scene.coordinates], 2) * start


def _joined(copies: list[dict[str, Any]], name: str) -> tuple[Any, ...]:
    return tuple(item for copy in copies for item in copy[name])


def _copy(scene: Scene, number: int, point: np.ndarray, weight: float) -> dict[str, Any]:
    """The parts of one world; number 0 is the scene itself."""
    values, gains, moved = _otherwise(scene, point)
    own: dict[sp.Basic, sp.Basic] = {item.symbol: sp.Float(values[item.name]) for item in scene.parameters} if number else {}
    for item in scene.coordinates if number else ():
        own |= {symbol: sp.Symbol(f"{symbol.name}_{number}", **symbol.assumptions0) for symbol in (item.symbol, item.velocity)}
    driven = {item.symbol: gain * item.symbol for item, gain in zip(scene.inputs, gains, strict=True)} if number else {}

    def here(expression: sp.Expr) -> Any:
        return sp.sympify(expression).xreplace(own)

    coordinates = [
        replace(item, symbol=own.get(item.symbol, item.symbol), velocity=own.get(item.velocity, item.velocity))
        for item in scene.coordinates
    ]
    start, goal, nq = np.array(scene.task.start) + moved, scene.task.goal, scene.nq
    final = here(scene.task.final_cost)
    for limit, symbols, wanted in zip(
        _limits(scene),
        ([item.symbol for item in coordinates], [item.velocity for item in coordinates]),
        (goal[:nq], goal[nq:]),
        strict=True,
    ):
        if number and limit:
            final += weight * sum(
                ((symbol - value) / limit) ** 2 for symbol, value in zip(symbols, wanted, strict=True) if value is not None
            )
    return {
        "coordinates": coordinates, "forces": [here(force.xreplace(driven)) for force in scene.forces], "running_cost": here(scene.task.running_cost), "final_cost": final,
        "kinetic_energy": here(scene.kinetic_energy), "potential_energy": here(scene.potential_energy),
        "contacts": [
            replace(
                item, name=f"{item.name}_{number}" if number else item.name, penetration=here(item.penetration), stiffness=here(item.stiffness), depth=here(item.depth)
            )
            for item in scene.contacts
        ],
        "q0": tuple(start[:nq]), "v0": tuple(start[nq:]), "q_goal": (None,) * nq if number else goal[:nq], "v_goal": (None,) * nq if number else goal[nq:],
    }  # fmt: skip


class RobustSession(Session):
    """Plans for the scene alone, then for all worlds from there."""

    def __init__(self, method: Robust, scene: Scene, options: RobustOptions) -> None:
        self._method, self._scene, self._options = method, scene, options

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        """Find the plan; where none is found for all worlds, that for the scene alone is handed back, and is not called solved. Raises TrajectoryError for a plan of another grid."""
        self._method.check_stage(eps, time_limit)
        scene, options, ends = self._scene, self._options, monotonic() + time_limit
        with load_method("mpcc").open(scene, {}) as session:
            alone = session.solve(eps=None, warm_start=warm_start, time_limit=time_limit)
        own = {"method": self._method.name, "options": asdict(options)}
        if alone.trajectory is None or alone.cost is None or monotonic() >= ends:
            return replace(alone, **own)
        weight = options.weight * abs(alone.cost)
        points = options.scale * harmful(scene, alone.trajectory, options.pairs)
        whole = ensemble(scene, points, weight)
        with load_method("strict_lcp").open(whole, {"max_iterations": options.max_iterations}) as session:
            found = session.solve(eps=None, warm_start=_in_all(scene, points, alone.trajectory), time_limit=max(1e-3, ends - monotonic()))
        seconds = {name: value + getattr(alone.seconds, name) for name, value in asdict(found.seconds).items()}
        spent = {"seconds": replace(found.seconds, **seconds), "iterations": alone.iterations + found.iterations}
        if found.trajectory is None:
            message = f"No plan was found for {len(points)} worlds at once ({found.message.rstrip('.')}): this is that for the scene alone."
            return replace(
                alone, **own, **spent, outcome=Outcome.STALLED if found.outcome is Outcome.SOLVED else found.outcome, message=message
            )
        plan = found.trajectory
        plan = replace(plan, q=plan.q[:, : scene.nq], v=plan.v[:, : scene.nq], lam=plan.lam[:, : scene.nl])
        cost = load_kernel(scene).cost(plan.q, plan.v, plan.u)
        message = (
            f"For {len(points)} worlds beside the scene's own; it costs {cost / alone.cost - 1.0:+.1%} of the plan for the scene alone. {found.message}"
            if alone.cost
            else found.message
        )
        # Residuals, history and size are those of all worlds together.
        return replace(
            found, **own, **spent, trajectory=plan, cost=cost, message=message, size=None, paper_size=None, bound=None, starts=()
        )


def _in_all(scene: Scene, points: np.ndarray, plan: Trajectory) -> Trajectory | None:
    """What the inputs of a plan do in the scene and in all worlds, as a plan of `ensemble`; None where that diverges."""
    motions = [_driven(scene, point, plan.u) for point in points]
    if any(motion.diverged for motion in motions):
        return None
    return replace(
        plan, **{name: np.hstack([getattr(plan, name), *(getattr(motion, name) for motion in motions)]) for name in ("q", "v", "lam")}
    )


class Robust(Method[RobustOptions]):
    """Exact contact in several worlds at once."""

    name = "robust"
    title = "Exact contact in several worlds at once"
    kind = Kind.DIRECT
    needs_eps = False
    options = RobustOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse what mpcc refuses, and scenes that need feedback whatever their plan."""
        if scene.unstable:
            return f"scene {scene.name} needs feedback whatever its plan ({scene.unstable.rstrip('.')}), so no inputs alone are robust."
        return why_not(scene)

    def session(self, scene: Scene, options: RobustOptions, clock: Clock) -> Session:
        """Open a session, which opens mpcc when it is solved."""
        clock.stop()
        return RobustSession(self, scene, options)


METHOD = Robust()

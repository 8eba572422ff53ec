"""Plans that must hold: inputs that reach the goal, with the motion that they truly give, written in every way a stranger may write it.

The motion is that of `motion`, which is known to satisfy the scene before the judge is asked;
inputs are those of the best plans of our methods. On three carts beside them the motions of other
integrators: Runge-Kutta, Radau and a semi-implicit Euler at a small step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.verdicts.plans import (
    Case,
    NoPlanError,
    Plan,
    as_plan,
    exact,
    found,
    motion_of,
    reaches,
    scene_of,
)
from tests.oracles.scene_motion import Path as Motions

# Whose inputs: those of a pipeline whose last plan reaches the goal in continuous time and in the
# open loop.
BASES = {
    "three_cart": "mpcc",
    "wall_pendulum": "mpcc",
    "cart_chain": "collocation",
    "hopper": "collocation",
    "two_discs": "softplus_dc+lbfgs",
    "transport": "lbfgs",
}
FORCES = ("start", "end", "mean")


def base(reference: str) -> tuple[np.ndarray, np.ndarray]:
    """(t, u) of a plan known to reach the goal."""
    plan = found(reference, BASES[reference])[-1]
    return np.array(plan.t), np.array(plan.u)


def truly(reference: str, t: np.ndarray, u: np.ndarray, **how: Any) -> Motions:
    """The motion, which must be what the scene asks for.

    Raises NoPlanError, else nothing could be expected.
    """
    path = motion_of(reference).run(t, u, **how)
    held = (
        u if len(path.t) == len(t) else u[np.searchsorted(t, path.t[:-1] + 1e-12, side="right") - 1]
    )
    why_not = reaches(scene_of(reference), path, held)
    if why_not:
        raise NoPlanError(f"by our own integration {why_not}")
    return path


@cache
def based(reference: str) -> tuple[np.ndarray, np.ndarray, Motions]:
    t, u = base(reference)
    return t, u, truly(reference, t, u)


def _written(reference: str) -> dict[str, Callable[[], Plan]]:
    """The one motion, by how it is written."""

    def say(forces: str = "mean", **changes: Any) -> Callable[[], Plan]:
        def make() -> Plan:
            t, u, path = based(reference)
            return exact(path, t, u, forces).but(**changes)

        return make

    def inputs(last_row: bool, **changes: object) -> Callable[[], Plan]:
        def make() -> Plan:
            t, u, _ = based(reference)
            return Plan(t=t if last_row else t[:-1], u=u).but(**changes)

        return make

    no_forces: dict[str, Any] = {"lam": None, "friction": None}
    written = {f"true forces at the {word}": say(word) for word in FORCES[:2]} | {
        "forces averaged over the step": say()
    }
    written |= {f"4 decimals, forces {word}": say(word, digits=4) for word in FORCES}
    written |= {
        "without force columns": say(**no_forces),
        "without velocities": say(v=None),
        "without velocities and forces": say(v=None, **no_forces),
        "4 decimals without forces": say(digits=4, **no_forces),
        "4 decimals without velocities": say(v=None, digits=4, **no_forces),
        "4 decimals of everything, t too": say(digits=4, t_digits=4),
        "inputs alone": inputs(True),
        "inputs alone, no final time": inputs(False),
        "inputs alone, 4 decimals": inputs(True, digits=4),
        "hold declared": say(hold="zero"),
    }
    return written


def _on_other_grids(reference: str) -> dict[str, Callable[[], Plan]]:
    def finer() -> Plan:
        t, u, _ = based(reference)
        nodes = np.unique(
            np.concatenate([t, *(t[:-1] + part * np.diff(t) for part in (0.25, 0.5, 0.75))])
        )
        return exact(truly(reference, t, u, nodes=nodes), nodes, np.repeat(u, 4, axis=0))

    def irregular(smallest: float) -> Plan:
        """Half of the steps cut in two, anywhere but for the smallest share of the step at its ends."""
        t, u, _ = based(reference)
        share = np.random.default_rng(5).uniform(smallest, 1.0 - smallest, len(u))
        share[len(u) // 3] = smallest
        nodes = np.sort(
            np.concatenate(
                [t, (t[:-1] + share * np.diff(t))[::2], [t[len(u) // 3] + smallest * (t[1] - t[0])]]
            )
        )
        nodes = nodes[np.concatenate([[True], np.diff(nodes) > 1e-9])]
        return exact(
            truly(reference, t, u, nodes=nodes),
            nodes,
            u[np.searchsorted(t, nodes[:-1] + 1e-12, side="right") - 1],
        )

    def coarser(by: int) -> Plan:
        t, u, _ = based(reference)
        count = (len(t) - 1) // by * by
        if count != len(t) - 1:
            raise NoPlanError(f"its {len(t) - 1} steps are not a multiple of {by}")
        wide = u.reshape(-1, by, u.shape[1]).mean(axis=1)
        return exact(truly(reference, t[::by], wide), t[::by], wide)

    def linear(**changes: object) -> Plan:
        t, u, _ = based(reference)
        corners = np.vstack([u[:1], (u[1:] + u[:-1]) / 2, u[-1:]])
        path = truly(reference, t, corners[:-1], linear_to=corners[-1])
        return exact(path, t, corners[:-1], hold="linear", u_last=corners[-1]).but(**changes)

    no_claims: dict[str, object] = {"q": None, "v": None, "lam": None, "friction": None}
    return {
        "a grid four times finer": finer,
        "an irregular grid": lambda: irregular(0.1),
        "an irregular grid, a step of a ten thousandth": lambda: irregular(1e-4),
        "a grid twice as coarse": lambda: coarser(2),
        "a grid five times coarser": lambda: coarser(5),
        "linear hold": linear,
        "linear hold, inputs alone": lambda: linear(**no_claims),
    }


def _by_others() -> dict[str, Callable[[], Plan]]:
    """Three carts by other integrators.

    Forces are what the contact law gives at the start of each step.
    """
    name = "three_cart"
    motion = motion_of(name)

    def said(t: np.ndarray, u: np.ndarray, states: np.ndarray) -> Plan:
        q, v = states[:, : motion.nq], states[:, motion.nq :]
        return Plan(t=t, u=u, q=q, v=v, lam=motion.forces(q)[:-1])

    def stepped(
        step: Callable[[np.ndarray, np.ndarray, float], np.ndarray], parts: int, keep: int
    ) -> Plan:
        """parts: steps in each of the plan's; keep: every which of them is written."""
        t, u, _ = based(name)
        fine = np.repeat(u, parts, axis=0)
        state = np.array(scene_of(name).task.start)
        states = [state]
        h = (t[1] - t[0]) / parts
        for held in fine:
            state = step(state, held, h)
            states.append(state)
        times = t[0] + h * np.arange(len(fine) + 1)
        return said(times[::keep], fine[::keep], np.array(states)[::keep])

    def rk4(x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        a = motion.rates(x, u)
        b = motion.rates(x + h / 2 * a, u)
        c = motion.rates(x + h / 2 * b, u)
        return x + h / 6 * (a + 2 * b + 2 * c + motion.rates(x + h * c, u))

    def euler(x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        v = x[motion.nq :] + h * motion.rates(x, u)[motion.nq :]
        return np.concatenate([x[: motion.nq] + h * v, v])

    def radau() -> Plan:
        t, u, _ = based(name)
        states = [np.array(scene_of(name).task.start)]
        for low, high, held in zip(t[:-1], t[1:], u, strict=True):
            run = solve_ivp(
                lambda _, x, held=held: motion.rates(x, held),
                (low, high),
                states[-1],
                method="Radau",
                rtol=1e-6,
                atol=1e-9,
            )
            states.append(run.y[:, -1])
        return said(t, u, np.array(states))

    return {
        "Runge-Kutta 4 at the task's step": lambda: stepped(rk4, 1, 1),
        "Runge-Kutta 4 at half the step": lambda: stepped(rk4, 2, 1),
        "Radau at rtol 1e-6": radau,
        "semi-implicit Euler of 1 ms, every step": lambda: stepped(euler, 10, 1),
        "semi-implicit Euler of 1 ms, every tenth": lambda: stepped(euler, 10, 10),
    }


def cases(scenes: tuple[str, ...]) -> Iterator[Case]:
    """Every way to write every motion."""
    for name in (name for name in BASES if name in scenes):
        made = {**_written(name), **_on_other_grids(name)}
        if name == "three_cart":
            made |= _by_others()
        for words, plan in made.items():
            yield Case(name=f"{name}: {words}", scene=name, plan=plan, expected=("holds",))
        own = partial(_own, name)  # a plan is made when it is its turn
        yield Case(
            name=f"{name}: the method's own plan, its scheme declared",
            scene=name,
            plan=own,
            expected=("holds",),
        )


def _own(name: str) -> Plan:
    """The plan of the scene's base pipeline, as its method declares it."""
    return as_plan(found(name, BASES[name])[-1], scene_of(name))

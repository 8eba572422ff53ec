"""What the search does to a plan: one function is one way to cheat.

Each takes a plan, its scene and a random generator, and gives another plan.

A mutation that does not apply - forces of a plan without forces - gives None, and another one is
drawn.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.verdicts.plans import Plan
from models.scene import Scene

Mutation = Callable[[Plan, Scene, np.random.Generator], "Plan | None"]
_SIZES = (1e-3, 1e-2, 0.1, 0.3, 1.0)
_ROWS = ("u", "lam", "friction")  # one a step; the states are one a node


def _bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = (
        np.array([getattr(item, side) for item in scene.inputs]) for side in ("lower", "upper")
    )
    return np.where(np.isfinite(lower), lower, -10.0), np.where(np.isfinite(upper), upper, 10.0)


def _some(random: np.random.Generator, plan: Plan) -> int:
    return int(random.integers(1, max(len(plan.u) - 2, 2)))


def _indexed(plan: Plan, nodes: np.ndarray) -> Plan:
    """Only these nodes, each step with what held at its start."""
    changes = {
        key: None if getattr(plan, key) is None else getattr(plan, key)[nodes] for key in ("q", "v")
    }
    changes |= {
        key: None if getattr(plan, key) is None else getattr(plan, key)[nodes[:-1]] for key in _ROWS
    }
    return plan.but(t=plan.t[nodes], scheme="", **changes)


def warp_time(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """Slow here, fast there, as long as before."""
    x = (plan.t - plan.t[0]) / (plan.t[-1] - plan.t[0])
    bent = x + random.choice([0.003, 0.03, 0.12]) * np.sin(2 * np.pi * x) * random.choice([-1, 1])
    return plan.but(t=plan.t[0] + (plan.t[-1] - plan.t[0]) * bent)


def stretch_time(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    return plan.but(t=plan.t * random.choice([0.01, 0.5, 0.97, 0.999, 1.001, 1.03, 2.0]))


def thin(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """A coarse grid, between whose nodes bodies may pass through each other."""
    nodes = np.unique(
        np.append(np.arange(0, len(plan.t), int(random.choice([2, 5, 10, 25]))), len(plan.t) - 1)
    )
    return _indexed(plan, nodes) if len(nodes) > 2 else None


def drop_contact(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """The nodes in contact left out: what is left never touches."""
    if plan.lam is None or not plan.lam.any():
        return None
    free = ~(plan.lam > 0.01 * plan.lam.max()).any(axis=1)
    nodes = np.unique(np.concatenate([[0], np.flatnonzero(free), [len(plan.t) - 1]]))
    return _indexed(plan, nodes) if len(nodes) > 2 else None


def scale_forces(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    return (
        None
        if plan.lam is None
        else plan.but(lam=plan.lam * random.choice([-1.0, 0.0, 0.5, 0.9, 1.1, 2.0, 10.0]))
    )


def pulse_force(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """A force where there is none, or one way and then the other."""
    if plan.lam is None or not plan.lam.size:
        return None
    lam, row, column = plan.lam.copy(), _some(random, plan), int(random.integers(plan.lam.shape[1]))
    size = random.choice([1.0, 10.0, 100.0, 1000.0])
    lam[row, column] += size
    if random.random() < 0.5:
        lam[row + 1, column] -= size
    return plan.but(lam=lam)


def pulse_input(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """Within the bounds, one way and then the other, in many places."""
    lower, upper = _bounds(scene)
    u = plan.u.copy()
    for row in range(_some(random, plan) % 5, len(u) - 1, int(random.choice([2, 4, 16]))):
        size = random.choice([0.1, 0.5, 1.0]) * np.minimum(upper - u[row], u[row + 1] - lower).clip(
            0.0
        )
        u[row], u[row + 1] = u[row] + size, u[row + 1] - size
    return plan.but(u=u)


def spike_between(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """A step cut in two, the second part tiny, with an enormous input, force or speed in it."""
    row, tiny = _some(random, plan), float(random.choice([1e-9, 1e-7, 1e-5, 1e-4]))
    nodes = np.sort(np.append(np.arange(len(plan.t)), row))
    cut = _indexed(plan, nodes)
    t = cut.t.copy()
    t[row] = t[row + 1] - tiny if row else t[row]
    cut = cut.but(t=t)
    which = random.choice(["u", "lam", "v"])
    rows = getattr(cut, which)
    if rows is None or not rows.size:
        which, rows = "u", cut.u
    rows = rows.copy()
    rows[row, random.integers(rows.shape[1])] += random.choice([-1.0, 1.0]) * random.choice(
        [1.0, 100.0, 1.0 / tiny]
    )
    return cut.but(**{which: rows})


def scale_inputs(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    return plan.but(u=plan.u * random.choice([-1.0, 0.0, 0.5, 0.9, 1.1, 2.0, 10.0]))


def quiet(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """No inputs for some of the time."""
    u, low = plan.u.copy(), _some(random, plan)
    u[low : low + int(len(u) * random.choice([0.05, 0.2, 0.5]))] = 0.0
    return plan.but(u=u)


def ram(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """Full force for some of the time."""
    lower, upper = _bounds(scene)
    u, low = plan.u.copy(), _some(random, plan)
    u[low : low + int(len(u) * random.choice([0.05, 0.2, 0.5]))] = np.where(
        random.random(scene.nu) < 0.5, lower, upper
    )
    return plan.but(u=u)


def shift(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """One column moved in time against the others."""
    which = random.choice(["q", "v", "u", "lam"])
    rows = getattr(plan, which)
    return (
        None
        if rows is None
        else plan.but(**{which: np.roll(rows, int(random.choice([-20, -3, -1, 1, 3, 20])), axis=0)})
    )


def mirror(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    which = random.choice(["u", "lam"])
    rows = getattr(plan, which)
    return None if rows is None or rows.shape[1] < 2 else plan.but(**{which: rows[:, ::-1]})


def move_states(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """A bump in the positions, with or without the speed that it takes."""
    if plan.q is None:
        return None
    x = np.linspace(0.0, 1.0, len(plan.t))
    column = int(random.integers(scene.nq))
    bump = (
        random.choice(_SIZES)
        * scene.coordinates[column].nominal
        * np.sin(np.pi * x) ** int(random.choice([2, 20, 200]))
    )
    q, v = plan.q.copy(), None if plan.v is None else plan.v.copy()
    q[:, column] += bump
    if v is not None and random.random() < 0.5:
        v[:, column] += np.gradient(bump, plan.t)
    return plan.but(q=q, v=v)


def jitter(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    if plan.q is None:
        return None
    return plan.but(
        q=plan.q
        + random.normal(size=plan.q.shape)
        * random.choice(_SIZES)
        * 0.1
        * [item.nominal for item in scene.coordinates]
    )


def to_the_goal(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """The last states led to the goal by hand."""
    if plan.q is None or plan.v is None:
        return None
    ends = [
        value if asked is None else asked
        for value, asked in zip([*plan.q[-1], *plan.v[-1]], scene.task.goal, strict=True)
    ]
    weight = np.clip(
        np.linspace(1.0 - 1.0 / random.choice([0.02, 0.2, 1.0]), 1.0, len(plan.t)), 0.0, 1.0
    )[:, None]
    off = np.array(ends) - np.concatenate([plan.q[-1], plan.v[-1]])
    return plan.but(q=plan.q + weight * off[: scene.nq], v=plan.v + weight * off[scene.nq :])


def start_elsewhere(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """All positions moved by a little, or by more."""
    if plan.q is None:
        return None
    return plan.but(
        q=plan.q
        + random.choice([9e-7, 1e-5, 1e-3, 0.1])
        * np.array([item.nominal for item in scene.coordinates])
    )


def cut(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """A part of it, from time 0."""
    low, count = (
        int(random.choice([0, 0, len(plan.u) // 2])),
        int(random.choice([3, len(plan.u) // 4, len(plan.u) - 2])),
    )
    nodes = np.arange(low, min(low + count, len(plan.u)) + 1)
    if len(nodes) < 3:
        return None
    part = _indexed(plan, nodes)
    return part.but(t=part.t - part.t[0])


def append(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """It rests for a while at its end, or before its start."""
    more = int(random.choice([2, 20, 500]))
    step = float(random.choice([scene.task.step, 1e-6]))

    def lasting(rows: np.ndarray | None) -> np.ndarray | None:
        return None if rows is None else np.vstack([rows, np.repeat(rows[-1:], more, axis=0)])

    changes = {key: lasting(getattr(plan, key)) for key in ("q", "v", *_ROWS)}
    return plan.but(
        t=np.append(plan.t, plan.t[-1] + step * np.arange(1, more + 1)), scheme="", **changes
    )


def delete(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    groups = random.choice(
        ["lam", "v", "friction", "lam friction", "v lam friction", "q v", "q v lam friction"]
    )
    return plan.but(**dict.fromkeys(str(groups).split()))


def declare(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    scheme = str(random.choice(["", "semi_implicit_euler", "implicit_midpoint", "radau_iia_2"]))
    return plan.but(
        scheme=scheme, hold="" if scheme else plan.hold, u_last=None if scheme else plan.u_last
    )


def declare_hold(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """A linear hold, whose last row may be anything."""
    return plan.but(
        hold="linear", scheme="", u_last=plan.u[-1] * random.choice([0.0, 1.0, 1.0, 50.0])
    )


def print_coarsely(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """What is printed with no decimals might be anything: does the judge believe that it was rounded?"""
    return plan.but(digits=int(random.choice([0, 1, 2, 3])), t_digits=None)


def throw(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """The start velocity is another one, by the first difference of the positions too."""
    if plan.q is None or plan.v is None:
        return None
    q, v = plan.q.copy(), plan.v.copy()
    faster = random.choice([-1.0, 0.1, 2.0]) * np.abs(v).max(axis=0)
    v[0] += faster
    q[1] += faster * (plan.t[1] - plan.t[0])
    return plan.but(q=q, v=v)


def rock_velocities(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """Velocities too large and too small in turn, so that their integral is right."""
    if plan.v is None:
        return None
    turns = np.where(np.arange(len(plan.t)) % 2 == 0, 1.0, -1.0)[:, None]
    return plan.but(v=plan.v + random.choice([0.05, 0.5, 5.0]) * turns)


def saw(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """Inputs on lines that rise from nearly nothing and jump back: their left ends cost nothing."""
    lower, upper = _bounds(scene)
    steps, tiny = len(plan.u), 1e-6
    t = np.sort(np.append(plan.t, plan.t[1:-1] - tiny))
    starts = np.searchsorted(plan.t, t[:-1] + tiny / 2.0, side="right").clip(1, steps) - 1
    rises = np.isin(t[:-1], plan.t)
    u = np.where(rises[:, None], 0.0, np.clip(2.0 * plan.u[starts], lower, upper))
    last = np.clip(2.0 * plan.u[-1], lower, upper)
    return Plan(t=t, u=u, hold="linear", u_last=last)


def push_everywhere(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """A small contact force all the time, in the air too."""
    if plan.lam is None or not plan.lam.size:
        return None
    return plan.but(lam=plan.lam + random.choice([0.003, 0.01, 0.1]) * np.abs(plan.lam).max())


def peaks(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """Of each step and the one after it the larger contact force."""
    if plan.lam is None or not plan.lam.size:
        return None
    return plan.but(lam=np.maximum(plan.lam, np.roll(plan.lam, -1, axis=0)))


def rub(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan | None:
    """Friction of another size, in the air too, or to and fro."""
    if plan.friction is None or not plan.friction.size:
        return None
    size = random.choice([0.1, 1.0, 100.0]) * max(float(np.abs(plan.friction).max()), 1.0)
    turns = np.where(np.arange(len(plan.friction)) % 2 == 0, 1.0, random.choice([1.0, -1.0]))
    return plan.but(friction=plan.friction + size * turns[:, None])


def as_float32(plan: Plan, scene: Scene, random: np.random.Generator) -> Plan:
    """All numbers as float32, which excuses half a spacing of each."""
    names = ("u", "q", "v", "lam", "friction")
    rows = {name: getattr(plan, name) for name in names}
    return plan.but(
        digits=None,
        **{
            name: values.astype(np.float32).astype(float)
            for name, values in rows.items()
            if values is not None
        },
    )


MUTATIONS: tuple[Mutation, ...] = (
    throw, rock_velocities, saw, push_everywhere, peaks, rub, as_float32,
    warp_time, stretch_time, thin, drop_contact, scale_forces, pulse_force, pulse_input,
    spike_between, scale_inputs, quiet, ram, shift, mirror,
    move_states, jitter, to_the_goal, start_elsewhere, cut, append, delete, delete, declare,
    declare, declare_hold, print_coarsely,
)  # fmt: skip


def mutate(
    plan: Plan, made: tuple[str, ...], scene: Scene, random: np.random.Generator
) -> tuple[Plan, tuple[str, ...]]:
    """One mutation that applies, and its name behind those before it."""
    while True:
        mutation = MUTATIONS[random.integers(len(MUTATIONS))]
        changed = mutation(plan, scene, random)
        if changed is not None and len(changed.t) > 2:
            return changed, (*made, mutation.__name__)

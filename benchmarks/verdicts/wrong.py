"""Plans that must not hold, each with the cause that its sentence has to name.

What is wrong is made on purpose and is the only thing wrong, as far as that can be: the rest of
each plan is the exact motion of its inputs, or a method's plan that holds. On the scenes of
`exact`, on relaxed plans of four scenes, and on unstable scenes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np

from benchmarks.verdicts.exact import BASES, based
from benchmarks.verdicts.plans import (
    BOUNDS,
    DEEP,
    DURATION,
    FORCES,
    FRICTION,
    GOAL,
    MOTION,
    REFUSED,
    START,
    Case,
    NoPlanError,
    Plan,
    as_plan,
    cost,
    exact,
    found,
    miss,
    motion_of,
    reaches,
    scene_of,
)

EXPECTED = ("violates", REFUSED)
# Advice that mends no plan whose motion is not that of its inputs.
ELSEWHERE = ("tighten eps", "# hold: linear")
UNSTABLE = {"cart_pole_walls": "strict", "acrobot_limits": "strict"}


def _astray(reference: str, plan: Plan) -> Plan:
    """The plan, if its inputs truly lead elsewhere than it says.

    Raises NoPlanError if they hardly matter.
    """
    scene = scene_of(reference)
    stated, path = scene.limit("replay_error"), motion_of(reference).run(plan.t, plan.u)
    allowed = max(
        1e-2 * max(item.nominal for item in scene.coordinates),
        (stated.value or 0.0) if stated is not None else 0.0,
    )
    if path.ended and plan.q is not None and np.abs(path.q - plan.q).max() < 2.0 * allowed:
        raise NoPlanError("its inputs hardly matter")
    return plan


def _goes(reference: str, u: np.ndarray, start: np.ndarray | None = None) -> Plan:
    """Inputs on the task's grid and the exact motion they give."""
    t, _, _ = based(reference)
    path = motion_of(reference).run(t, u, start=start)
    if not path.ended:
        raise NoPlanError("its motion runs away")
    return exact(path, t, u)


def _cut(plan: Plan, low: int, high: int) -> Plan:
    """Its steps from low to high, from time 0 on."""

    def part(rows: np.ndarray | None, more: int = 0) -> np.ndarray | None:
        return None if rows is None else rows[low : high + more]

    return plan.but(
        t=plan.t[low : high + 1] - plan.t[low], q=part(plan.q, 1), v=part(plan.v, 1),
        u=part(plan.u), lam=part(plan.lam), friction=part(plan.friction)
    )  # fmt: skip


def common(reference: str) -> dict[str, tuple[Callable[[], Plan], tuple[str, ...]]]:
    """What can be wrong with a plan of any scene: how it is made, and its cause."""
    scene = scene_of(reference)
    steps, lower, upper = (
        scene.task.steps,
        *(np.array([getattr(item, side) for item in scene.inputs]) for side in ("lower", "upper")),
    )

    def good() -> Plan:
        t, u, path = based(reference)
        return exact(path, t, u)

    def stated(group: str) -> np.ndarray:
        return np.asarray(getattr(good(), group))

    def appended() -> Plan:
        u = based(reference)[1]
        more = round(5.0 / scene.task.step)
        times = scene.task.step * np.arange(steps + more + 1)
        inputs = np.vstack([u, np.zeros((more, scene.nu))])
        return exact(motion_of(reference).run(times, inputs), times, inputs)

    def too_strong() -> Plan:
        ten = 10.0 * based(reference)[1]
        if (ten <= upper).all() and (ten >= lower).all():
            raise NoPlanError("ten times its inputs are within their bounds")
        return _goes(reference, ten)

    def once_too_strong() -> Plan:
        """Beyond the bound in one step only, by a tenth of the range: the motion is as good as before."""
        more = based(reference)[1].copy()
        more[steps // 2] = upper + 0.1 * (upper - lower)
        return _goes(reference, more)

    def elsewhere(share: float) -> Plan:
        moved = np.array(scene.task.start)
        moved[0] -= share * scene.coordinates[0].nominal
        return _goes(reference, based(reference)[1], start=moved)

    def at_the_goal() -> Plan:
        if any(value is None for value in scene.task.goal[: scene.nq]):
            raise NoPlanError("its goal is free")
        state = np.array([0.0 if value is None else value for value in scene.task.goal])
        return _goes(reference, np.zeros((steps, scene.nu)), start=state)

    def forces(change: Callable[[np.ndarray], np.ndarray], **declared: str) -> Plan:
        plan = good()
        assert plan.lam is not None
        return plan.but(lam=change(plan.lam.copy()), **declared)

    def once(rows: np.ndarray, row: int, value: float) -> np.ndarray:
        rows[row] = rows[row] + value
        return rows

    def mirrored(rows: np.ndarray) -> np.ndarray:
        if rows.shape[1] < 2 or np.abs(rows - rows[:, ::-1]).sum() < 0.1 * np.abs(rows).sum():
            raise NoPlanError("its forces are their own mirror image")
        return rows[:, ::-1]

    def turned(rows: np.ndarray) -> np.ndarray:
        if not rows.any():
            raise NoPlanError("it has no contact")
        return -rows

    def kinked(group: str, size: float) -> Plan:
        plan = good()
        rows = getattr(plan, group).copy()
        rows[steps // 3, 0] += size
        return plan.but(**{group: rows})

    zero = np.zeros((steps, scene.nu))
    wide = 0.3 * max(item.nominal for item in scene.coordinates)
    made: dict[str, tuple[Callable[[], Plan], tuple[str, ...]]] = {
        f"3 of {steps} steps": (lambda: _cut(good(), 0, 3), DURATION),
        f"the last 3 of {steps} steps": (
            lambda: _cut(good(), steps - 3, steps),
            (*DURATION, *START),
        ),
        f"3 of {steps} inputs": (lambda: Plan(t=good().t[:4], u=good().u[:3]), DURATION),
        "one step too few": (lambda: _cut(good(), 0, steps - 1), DURATION),
        "5 s appended": (appended, DURATION),
        "ten times the inputs": (too_strong, BOUNDS),
        "one step beyond the bounds": (once_too_strong, BOUNDS),
        "another start, a tenth off": (lambda: elsewhere(0.1), START),
        "another start, 1e-4 off": (lambda: elsewhere(1e-4), START),
        "at the goal from the start on": (at_the_goal, START),
        "nothing done": (lambda: _goes(reference, zero), GOAL),
        "nothing done, inputs alone": (lambda: Plan(t=good().t, u=zero), GOAL),
        "nothing done, states of a plan that does": (
            lambda: _astray(reference, good().but(u=zero)),
            MOTION,
        ),
        "nothing done, positions of a plan that does": (
            lambda: _astray(reference, good().but(u=zero, v=None, lam=None, friction=None)),
            MOTION,
        ),
        "inputs turned round": (
            lambda: _astray(reference, good().but(u=np.clip(-good().u, lower, upper))),
            MOTION,
        ),
        "inputs a fifth of the plan late": (
            lambda: _astray(reference, good().but(u=np.roll(good().u, steps // 5, axis=0))),
            MOTION,
        ),
        "a spike of one velocity": (lambda: kinked("v", 5.0), (*MOTION, "velocit")),
        "a spike of one position": (lambda: kinked("q", wide), MOTION),
        "positions all moved": (
            lambda: good().but(
                q=stated("q") + np.linspace(0, wide, steps + 1)[:, None] ** 2 / wide
            ),
            (*MOTION, *GOAL),
        ),
        "velocities doubled": (
            lambda: good().but(
                v=np.vstack([stated("v")[:1], 2 * stated("v")[1:-1], stated("v")[-1:]])
            ),
            (*MOTION, "velocit"),
        ),
    }
    if scene.nu > 1:
        made["inputs mirrored"] = (
            lambda: _astray(reference, good().but(u=good().u[:, ::-1])),
            MOTION,
        )
    if scene.nc:
        made |= {
            "invented forces of 100 N": (lambda: forces(lambda rows: rows + 100.0), FORCES),
            "invented forces of 100 N, a scheme declared": (
                lambda: forces(lambda rows: rows + 100.0, scheme="semi_implicit_euler"),
                FORCES,
            ),
            "an invented force in one step": (
                lambda: forces(lambda rows: once(rows, 1, 100.0)),
                FORCES,
            ),
            "a spike of force, there and back": (
                lambda: forces(
                    lambda rows: once(once(rows, steps // 3, 50.0), steps // 3 + 1, -50.0)
                ),
                FORCES,
            ),
            "forces mirrored": (lambda: forces(mirrored), FORCES),
            "forces pull": (lambda: forces(turned), FORCES),
            "forces doubled": (lambda: forces(lambda rows: 2.0 * turned(-rows)), FORCES),
            "forces left at zero": (lambda: forces(lambda rows: 0.0 * turned(rows)), FORCES),
            "forces a tenth of the plan late": (
                lambda: forces(lambda rows: np.roll(-turned(rows), steps // 10, axis=0)),
                FORCES,
            ),
        }
    if scene.nf:
        made["friction works with the slip"] = (
            lambda: good().but(friction=-stated("friction")),
            FRICTION,
        )
        made["friction ten times too large"] = (
            lambda: good().but(friction=10.0 * stated("friction")),
            FRICTION,
        )
    return made


def by_feedback(reference: str) -> dict[str, tuple[Callable[[], Plan], tuple[str, ...]]]:
    """A perfect trajectory of an unstable scene, and inputs that do not make it."""

    def plan(change: Callable[[np.ndarray], np.ndarray], **more: object) -> Callable[[], Plan]:
        def make() -> Plan:
            scene = scene_of(reference)
            its = found(reference, UNSTABLE[reference])[-1]
            path = motion_of(reference).run(its.t, its.u)
            if not path.ended:
                raise NoPlanError("its motion runs away")
            stated = as_plan(its, scene)
            lower, upper = (
                np.array([getattr(item, side) for item in scene.inputs])
                for side in ("lower", "upper")
            )
            return stated.but(u=np.clip(change(stated.u.copy()), lower, upper), **more)

        return make

    noise = np.random.default_rng(2)
    bare: dict[str, object] = {"lam": None, "friction": None, "scheme": ""}
    return {
        "no inputs, a perfect trajectory": (plan(lambda u: 0.0 * u), MOTION),
        "no inputs, a perfect trajectory, undeclared": (plan(lambda u: 0.0 * u, scheme=""), MOTION),
        "no inputs, a perfect trajectory, without forces": (
            plan(lambda u: 0.0 * u, **bare),
            MOTION,
        ),
        "half the inputs, a perfect trajectory": (plan(lambda u: 0.5 * u, **bare), MOTION),
        "inputs turned round, a perfect trajectory": (plan(lambda u: -u, **bare), MOTION),
        "noise for inputs, a perfect trajectory": (
            plan(lambda u: noise.uniform(-1, 1, u.shape) * np.abs(u).max(), **bare),
            MOTION,
        ),
    }


def _costly(reference: str) -> Plan:
    """A constant input on a grid five times coarser that costs twice the limit, as a sum over steps of the task's length, but a fifth as one over its own."""
    scene, motion = scene_of(reference), motion_of(reference)
    limit = scene.limit("replay_cost")
    t = based(reference)[0][::5]
    for share in np.linspace(0.0, 1.0, 81):
        u = np.tile([share * item.lower for item in scene.inputs], (len(t) - 1, 1))
        path = motion.run(t, u)
        if (
            limit is not None
            and limit.value is not None
            and 2.0 * limit.value < cost(scene, path, u) < 4.0 * limit.value
        ):
            return exact(path, t, u)
    raise NoPlanError("no constant input costs so much")


def cases(scenes: tuple[str, ...]) -> Iterator[Case]:
    """Every wrong plan, with the cause that the judge must name."""

    def of(
        reference: str, made: dict[str, tuple[Callable[[], Plan], tuple[str, ...]]]
    ) -> Iterator[Case]:
        for words, (plan, causes) in made.items():
            never = ELSEWHERE if MOTION[0] in causes and "relaxed" not in words else ()
            yield Case(
                name=f"{reference}: {words}",
                scene=reference,
                plan=plan,
                expected=EXPECTED,
                causes=causes,
                never=never,
            )

    for reference in (name for name in BASES if name in scenes):
        rams = {"at full force into each other": (partial(rammed, reference), (*DEEP, *GOAL))}
        yield from of(reference, common(reference) | rams)
    for reference in (name for name in RELAXED if name in scenes):
        yield from of(reference, relaxed(reference))
    for reference in (name for name in UNSTABLE if name in scenes):
        yield from of(reference, by_feedback(reference))
    for reference in (name for name in _ALONE if name in scenes):
        yield from of(reference, _ALONE[reference])


def _without_forces(reference: str) -> Plan:
    t, u, path = based(reference)
    return exact(path, t, u).but(lam=None)


def _written_for(other: str) -> Plan:
    t, u, path = based(other)
    return exact(path, t, u, columns_of=other)


# Plans of a relaxed contact law

RELAXED = {
    "three_cart": "softplus_dc+strict",
    "hopper": "softplus_dc+strict",
    "cart_chain": "softplus_dc+strict",
    "wall_pendulum": "softplus_dc+strict",
}


def relaxed(reference: str) -> dict[str, tuple[Callable[[], Plan], tuple[str, ...]]]:
    """A softplus plan, whose forces act from a distance, and what is left of it without the columns that show it."""

    def plan(**changes: object) -> Callable[[], Plan]:
        def make() -> Plan:
            first = as_plan(
                found(reference, RELAXED[reference])[0],
                scene_of(reference),
            )
            return first.but(**changes)

        return make

    none: dict[str, object] = {"lam": None, "friction": None, "scheme": ""}
    astray = (*MOTION, *GOAL)
    return {
        "relaxed, as its method declares it": (plan(), (*FORCES, *astray)),
        "relaxed, its scheme not declared": (plan(scheme=""), (*FORCES, *astray)),
        "relaxed, its forces deleted": (plan(lam=None, friction=None), astray),
        "relaxed, forces and scheme deleted": (plan(**none), astray),
        "relaxed, velocities deleted": (plan(v=None, scheme=""), (*FORCES, *astray)),
        "relaxed, velocities and forces deleted": (plan(v=None, **none), astray),
        "relaxed, states deleted": (plan(q=None, v=None, scheme=""), (*FORCES, *astray)),
        "relaxed, inputs alone": (
            lambda: _that_fails(plan(q=None, v=None, **none)(), reference),
            astray,
        ),
        "relaxed, printed with two decimals": (plan(digits=2, scheme=""), (*FORCES, *astray)),
        "relaxed, true forces of its states": (lambda: _law(plan(scheme="")(), reference), astray),
    }


def _that_fails(plan: Plan, reference: str) -> Plan:
    """The plan, if its inputs do not reach what the scene asks for after all: inputs alone that do are no relaxed plan any more."""
    if not reaches(scene_of(reference), motion_of(reference).run(plan.t, plan.u), plan.u):
        raise NoPlanError("by an integration of its own its inputs do what the scene asks for")
    return plan


def _law(plan: Plan, reference: str) -> Plan:
    """Its forces replaced by those that the true law gives at its own positions."""
    assert plan.q is not None
    return plan.but(lam=motion_of(reference).forces(plan.q)[:-1])


# Bodies through each other: exact motions that the model does not mean, of inputs within their
# bounds


@cache
def through() -> Plan:
    """Three carts: the outer ones squeeze the middle one until two carts are inside each other, and all of them end at the goal.

    The squeeze is 10 N for a second; the inputs after it are steered home by Gauss and Newton's
    steps on a semi-implicit Euler of all their changes at once.
    """
    scene, (t, u, _) = scene_of("three_cart"), based("three_cart")
    u, h, pieces = u.copy(), scene.task.step, 20
    squeezed, start, goal = (
        round(1.2 / h),
        np.array(scene.task.start),
        np.array(scene.task.goal, dtype=float),
    )
    u[:squeezed] = (10.0, -10.0)
    u[squeezed:] = u[squeezed:][:, :] * 0.0
    wide = (len(u) - squeezed) // pieces

    def ends(knobs: np.ndarray) -> np.ndarray:
        """knobs (k, 2 pieces) -> states (k, 6)."""
        x = np.tile(start, (len(knobs), 1))
        q, v = x[:, :3], x[:, 3:]
        for step in range(len(u)):
            force = np.zeros_like(q)
            held = np.tile(u[step], (len(knobs), 1))
            if step >= squeezed:
                piece = min((step - squeezed) // wide, pieces - 1)
                held = held + knobs[:, 2 * piece : 2 * piece + 2]
            force[:, 0] += held[:, 0]
            force[:, 2] += held[:, 1]
            push = 30.0 * np.maximum(0.5 - np.diff(q, axis=1), 0.0)
            force[:, :2] -= push
            force[:, 1:] += push
            v = v + h * (force - 2.0 * v)
            q = q + h * v
        return np.hstack([q, v])

    knobs = np.zeros(2 * pieces)
    knobs[0::2] = 0.5
    for _ in range(60):
        rows = ends(np.vstack([knobs, knobs + 1e-6 * np.eye(len(knobs))]))
        error, jacobian = rows[0] - goal, (rows[1:] - rows[0]).T / 1e-6
        if np.abs(error).max() < 1e-4:
            break
        change = -np.linalg.lstsq(jacobian, error, rcond=1e-6)[0]
        knobs = np.clip(knobs + change * min(1.0, 2.0 / np.abs(change).max()), -9.9, 9.9)
    for piece in range(pieces):
        low = squeezed + piece * wide
        u[low : (low + wide if piece < pieces - 1 else len(u))] += knobs[2 * piece : 2 * piece + 2]
    path = motion_of("three_cart").run(t, u)
    off = miss(scene, np.concatenate([path.q[-1], path.v[-1]]))
    if path.depth.max() < 0.51 or max(off) > 0.05:
        raise NoPlanError(
            f"the carts are {path.depth.max():.3g} m inside each other and end {off[0]:.3g} m from the goal"
        )
    return exact(path, t, u)


def rammed(reference: str) -> Plan:
    """All inputs at their bounds, against each other.

    Raises NoPlanError where the model allows it.
    """
    scene = scene_of(reference)
    signs = np.array([1.0] + [-1.0] * (scene.nu - 1))
    t, u = (
        based(reference)[0],
        np.tile(signs * np.array([item.upper for item in scene.inputs]), (scene.task.steps, 1)),
    )
    path = motion_of(reference).run(t, u)
    depth = path.depth
    if not (depth > np.array(scene.depths)).any():
        raise NoPlanError(
            f"at full force the bodies are {depth.max():.3g} m deep, which the model allows"
        )
    return exact(path, t, u)


# Wrong plans of one scene alone.
_ALONE: dict[str, dict[str, tuple[Callable[[], Plan], tuple[str, ...]]]] = {
    "three_cart": {
        "bodies through each other, to the goal": (through, DEEP),
        "without forces": (lambda: through().but(lam=None), DEEP),
        "inputs alone through each other": (lambda: Plan(t=through().t, u=through().u), DEEP),
        "the plan of wall_pendulum": (partial(_written_for, "wall_pendulum"), ("column",)),
        "the plan of hopper": (partial(_written_for, "hopper"), ("column",)),
        "the plan of cart_chain": (partial(_written_for, "cart_chain"), ("column",)),
    },
    "wall_pendulum": {
        "too costly, on a coarse grid": (partial(_costly, "wall_pendulum"), GOAL),
    },
    "two_discs_wall": {
        "the plan of two_discs": (
            partial(_without_forces, "two_discs"),
            (*START, *MOTION, *GOAL),
        ),
    },
}

"""MuJoCo: a scene as bodies that slide and tendons between them, by Runge-Kutta 4 at a fixed step.

A frictionless, undamped contact is a tendon with a dead band, whose force is k max(phi, 0) exactly. A damped one is a tendon with a limit, and one that
rubs a pair of geoms: constraints, which MuJoCo makes of acceleration units at an impedance d, so that k and c are weighed with the inverse mass that it
takes for the constraint. At the smallest impedance that it takes, d = 1e-4, the force is max(k phi + c phi', 0) but for 1e-4 of what else acts on the
bodies; at its default of 0.9 a depth is 3 to 51 % wrong. Friction is a constraint on the slip, regularised whatever is asked: it creeps.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from models.scene import Scene
from models.scene.contacts import DampingLaw
from validate.judge.engines._mechanism import Mechanism, axes_of_bodies, mechanism_of
from validate.judge.simulator import CannotExpressError, Drive, SimulatedMotion, Simulator, stepped

mujoco: Any = importlib.import_module("mujoco")  # a checker without the package takes this file for it

ENGINE = Simulator(
    title="MuJoCo, Runge-Kutta 4",
    package="mujoco",
    law="tendons with a dead band; damped or rubbing contact: constraints at impedance 1e-4; elliptic cone, regularised",
    softens="how much its friction gives way",
)
# The smallest and largest impedance that MuJoCo takes, in its order.
_SOFT, _HARD = 1e-4, 0.9999
# Constraint force of friction over that of the normal at the same violation: 1e8 leaves friction with 1e-4 of the inverse mass as compliance, as _HARD does.
_RATIO = 1e8
# Slip decays by this share of itself in a step: Runge-Kutta 4 bears 2.7.
_DECAY = 0.5
# Lengths of geoms that nothing depends on [m]: of a rubbing ball, and of the block under it, which no motion leaves.
_BALL, _BLOCK = 0.1, 100.0
_FAR, _TINY = 1e6, 1e-12


def simulate(drive: Drive) -> SimulatedMotion:
    """The motion of a drive. Raises CannotExpressError."""
    scene, h = drive.scene, float(np.diff(drive.plan.t).mean()) / drive.parts
    tree = _TREES.get(scene.name)
    mechanism = mechanism_of(scene, bodies=tree is None)
    model = mujoco.MjModel.from_xml_string(_text(scene, mechanism, tree))
    model.opt.timestep = h
    _set_constraints(model, scene, mechanism, h, drive.soft)
    data = mujoco.MjData(model)
    places = np.array([model.joint(coordinate.name).qposadr[0] for coordinate in scene.coordinates])
    data.qpos[places], data.qvel[places] = np.split(drive.start, 2)

    def advance(interval: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (nq,) [m, m/s] after the interval. Raises nothing."""
        held = drive.plan.u_end is None and drive.plan.hold.value == "zero_order"
        for part in range(1 if held else drive.parts):
            u = drive.inputs(interval, 0.0 if held else (part + 0.5) / drive.parts)
            data.qfrc_applied[places] = mechanism.constant + mechanism.drive @ u
            mujoco.mj_step(model, data, drive.parts if held else 1)
        return data.qpos[places].copy(), data.qvel[places].copy()

    return stepped(drive, advance, steps=drive.plan.steps * drive.parts)


def _text(scene: Scene, mechanism: Mechanism, tree: Callable[[Scene], tuple[str, str, float]] | None) -> str:
    """The model as MJCF, but for the constraints' numbers, which need its inverse masses."""
    bodies, pairs, gravity = _sliders(scene, mechanism) if tree is None else tree(scene)
    names = [coordinate.name for coordinate in scene.coordinates]
    tendons = []
    for link in mechanism.springs:
        tendons.append(_fixed(names, link.direction, f'stiffness="{link.strength!r}" springlength="0 0"'))
    for link in mechanism.dampers:
        tendons.append(_fixed(names, link.direction, f'damping="{link.strength!r}"'))
    rubbing = {rub.touch for rub in mechanism.rubs}
    for place, touch in enumerate(mechanism.touches):
        band = f'stiffness="{touch.stiffness!r}" springlength="{touch.offset!r} {_FAR}"'
        if touch.damping and touch.law is DampingLaw.HUNT_CROSSLEY:
            raise CannotExpressError(f"contact {touch.name}: MuJoCo has no damping that grows with the depth (Hunt and Crossley's)")
        if touch.centres is not None:
            if touch.damping or place in rubbing:
                raise CannotExpressError(f"contact {touch.name}: a damped or rubbing contact of two discs is not built here")
            ends = "".join(f'<site site="centre_{centre[0]}"/>' for centre in touch.centres)
            tendons.append(f"<spatial {band}>{ends}</spatial>")
        elif place not in rubbing:
            limit = f'limited="true" range="{touch.offset!r} {_FAR}" solimplimit="{_impedance(_SOFT)}"'
            tendons.append(_fixed(names, touch.normal, f'name="{touch.name}" {limit if touch.damping else band}'))
    for rub in mechanism.rubs:
        if rub.touch is None:
            tendons.append(_fixed(names, rub.direction, f'name="rub_{rub.name}" frictionloss="{rub.coefficient * rub.pressed!r}"'))
    return (
        f'<mujoco><option integrator="RK4" cone="elliptic" iterations="200" tolerance="1e-15" gravity="0 0 {-gravity}">'
        '<flag refsafe="disable" autoreset="disable"/></option>'
        f"<worldbody>{bodies}</worldbody><contact>{pairs}</contact><tendon>{''.join(tendons)}</tendon></mujoco>"
    )


def _fixed(names: list[str], direction: np.ndarray, what: str) -> str:
    """A tendon whose length is direction @ q."""
    ends = "".join(f'<joint joint="{names[place]}" coef="{float(direction[place])!r}"/>' for place in np.flatnonzero(direction))
    return f"<fixed {what}>{ends}</fixed>"


def _impedance(value: float) -> str:
    return f"{value} {value} .001 .5 1"


def _sliders(scene: Scene, mechanism: Mechanism) -> tuple[str, str, float]:
    """Bodies on slides, all from the origin, and pairs of those geoms that rub; no gravity: what is constant is applied."""
    assert mechanism.masses is not None
    axes = dict.fromkeys(range(scene.nq), "1 0 0")
    geoms: dict[int | None, str] = {}
    pairs = ""
    for touch in mechanism.touches:
        axes |= {centre[1]: "0 1 0" for centre in touch.centres or ()}
    for rub in mechanism.rubs:
        if rub.touch is not None:
            touch = mechanism.touches[rub.touch]
            pressed, below = int(np.flatnonzero(touch.normal)[0]), np.flatnonzero(rub.direction < 0.0)
            under = int(below[0]) if len(below) else None  # the ground
            axes[pressed] = "0 0 1"
            side = float(touch.normal[pressed])
            face = side * touch.offset
            loose = 'mass="0" contype="0" conaffinity="0"'
            geoms[pressed] = f'<geom name="on_{rub.name}" type="sphere" size="{_BALL}" pos="0 0 {side * _BALL}" {loose}/>'
            geoms[under] = geoms.get(under, "") + (
                f'<geom name="under_{rub.name}" type="box" size="{_BLOCK} {_BLOCK} 1" pos="0 0 {face - side}" {loose}/>'
            )
            pairs += (
                f'<pair name="{touch.name}" geom1="under_{rub.name}" geom2="on_{rub.name}" condim="3" solimp="{_impedance(_SOFT)}" '
                f'friction="{rub.coefficient!r} {rub.coefficient!r} 0 0 0"/>'
            )
    bodies = geoms.pop(None, "")
    for body in axes_of_bodies(mechanism):
        mass = float(mechanism.masses[body[0]])
        if not np.allclose(mechanism.masses[list(body)], mass, rtol=1e-12):
            raise CannotExpressError("a body has another mass in each direction")
        joints = "".join(f'<joint name="{scene.coordinates[place].name}" type="slide" axis="{axes[place]}"/>' for place in body)
        own = "".join(geoms.get(place, "") for place in body)
        bodies += f'<body>{joints}<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/><site name="centre_{body[0]}"/>{own}</body>'
    return bodies, pairs, 0.0


def _set_constraints(model: Any, scene: Scene, mechanism: Mechanism, h: float, soft: float) -> None:
    """Stiffness, damping and the give of friction in MuJoCo's units: of acceleration, by the inverse mass that it takes for each constraint."""
    values = scene.parameter_values
    model.opt.impratio = _RATIO / soft
    for contact in scene.contacts:
        pull = np.array([float(contact.stiffness.subs(values)), float(contact.damping.subs(values))])
        pair = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PAIR, contact.name)
        tendon = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TENDON, contact.name)
        if pair >= 0:
            bodies = model.geom_bodyid[[model.pair_geom1[pair], model.pair_geom2[pair]]]
            model.pair_solref[pair] = -pull * model.body_invweight0[bodies, 0].sum()
            model.pair_solreffriction[pair] = -_TINY, -_DECAY / h * _SOFT
        elif tendon >= 0:  # of one with a dead band, which has no limit, nobody reads it
            model.tendon_solref_lim[tendon] = -pull * model.tendon_invweight0[tendon]
    for rub in mechanism.rubs:
        tendon = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TENDON, f"rub_{rub.name}")
        if tendon >= 0:
            model.tendon_solimp_fri[tendon, :2] = 1.0 - (1.0 - _HARD) * soft
            model.tendon_solref_fri[tendon] = -_TINY, -_DECAY / h


def _cart_pole(scene: Scene) -> tuple[str, str, float]:
    """A cart on a slide, a point at the end of a rod on it, and two planes that the tip alone touches."""
    w, length = _number(scene, "w"), _number(scene, "l")
    loose = 'mass="0" contype="0" conaffinity="0"'
    walls = pairs = ""
    for name, side in (("right", 1.0), ("left", -1.0)):
        walls += f'<geom name="wall_{name}" type="plane" size="1 1 1" pos="{side * (w + _BALL)!r} 0 0" zaxis="{-side} 0 0" {loose}/>'
        pairs += f'<pair name="{name}" geom1="wall_{name}" geom2="tip" condim="1" solimp="{_impedance(_SOFT)}"/>'
    pole = (
        f'<body><joint name="theta" type="hinge" axis="0 1 0"/>{_point(_number(scene, "m_p"), length)}'
        f'<geom name="tip" type="sphere" size="{_BALL}" pos="0 0 {length!r}" {loose}/></body>'
    )
    cart = f'<body><joint name="x" type="slide" axis="1 0 0"/>{_point(_number(scene, "m_c"), 0.0)}{pole}</body>'
    return walls + cart, pairs, _number(scene, "g")


def _acrobot(scene: Scene) -> tuple[str, str, float]:
    """Two points at the ends of rods, each on a hinge; the stops are tendons of the shoulder."""
    second = f'<joint name="theta2" type="hinge" axis="0 1 0"/>{_point(_number(scene, "m2"), _number(scene, "l2"))}'
    first = f'<joint name="theta1" type="hinge" axis="0 1 0"/>{_point(_number(scene, "m1"), _number(scene, "l1"))}'
    return f'<body>{first}<body pos="0 0 {_number(scene, "l1")!r}">{second}</body></body>', "", _number(scene, "g")


def _point(mass: float, height: float) -> str:
    """A point mass above the joint of its body; MuJoCo wants some inertia of each."""
    return f'<inertial pos="0 0 {height!r}" mass="{mass!r}" diaginertia="{_TINY} {_TINY} {_TINY}"/>'


def _number(scene: Scene, name: str) -> float:
    """A parameter's value."""
    return next(parameter.value for parameter in scene.parameters if parameter.name == name)


# Scenes whose bodies turn, by name: bodies, pairs of geoms, gravity.
_TREES = {"cart_pole_walls": _cart_pole, "acrobot_limits": _acrobot}

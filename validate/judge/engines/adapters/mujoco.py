"""MuJoCo: bodies on joints and tendons, by Runge-Kutta 4 at a fixed step.

- Undamped contact: a tendon with a dead band, whose force is exactly k max(phi, 0). Its friction:
  a tendon along the slip; the friction loss follows the contact force at each stage.
- Damped contact: a tendon with a limit, or else a pair of geoms. Both are constraints in units of
  acceleration, scaled by MuJoCo's inverse mass. At the smallest impedance, d = 1e-4, the force is
  max(k phi + c phi', 0) except for 1e-4 of the other forces. At the default 0.9 depths are 3 to
  51 % wrong.
- Friction is always regularised, so it creeps. Smooth forces act on the joints at each stage.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from models.scene.contacts import DampingLaw
from validate.judge.engines.adapters._mechanism import Mechanism, Pad, Touch, mechanism_of
from validate.judge.engines.simulator import (
    CannotExpressError,
    Drive,
    SimulatedMotion,
    Simulator,
    stepped,
)

mujoco: Any = importlib.import_module("mujoco")  # dynamic: pyright would take this file for it

ENGINE = Simulator(
    title="MuJoCo, Runge-Kutta 4",
    package="mujoco",
    law="tendons with a dead band, and tendons that rub as those press; damped contact and turning bodies: constraints at impedance 1e-4; friction regularised",
)
# MuJoCo's smallest impedance.
_SOFT = 1e-4
# MuJoCo's largest impedance.
_HARD = 0.9999

_IMPEDANCE = [_SOFT, _SOFT, 0.001, 0.5, 1.0]
# Friction's constraint force over the normal's at equal violation: 1e8 leaves 1e-4 of the inverse
# mass as compliance, as _HARD does.
_RATIO = 1e8
# Largest decay of slip per step, as a fraction; Runge-Kutta 4 is stable up to 2.7.
_DECAY = 0.5
# Largest decay rate of slip on pads [1/s]; faster decay separates sliding bodies.
_RATE = 1e3
# Half the size of the block for a plane, beyond any motion [m]; MuJoCo's planes cannot move.
_BLOCK = 100.0
# Half the depth of that block [m].
_DEPTH = 1.0
# Upper end of a one-sided range.
_FAR = 1e6
# Stiffness of a constraint that only damps; MuJoCo wants a negative number.
_TINY = 1e-12


def simulate(drive: Drive) -> SimulatedMotion:
    """Return the motion of a drive. Raises CannotExpressError."""
    scene, mechanism = drive.scene, mechanism_of(drive.scene)
    names = [coordinate.name for coordinate in scene.coordinates]
    model = _model(mechanism, names)
    _set_constraints(model, mechanism, drive.step)
    data = mujoco.MjData(model)
    places = np.array([model.joint(name).qposadr[0] for name in names])
    joints, back = mechanism.joints, np.linalg.inv(mechanism.joints)
    data.qpos[places], data.qvel[places] = (joints @ part for part in np.split(drive.start, 2))
    forces, u_now = mechanism.smooth(), np.zeros(scene.nu)

    # Each pressing dead band: friction row, tendon, friction per metre of depth, offset.
    bands = [touch for touch in mechanism.touches if _band_rubs(touch)]
    pressed = [
        (row, model.tendon(touch.name).id, touch.friction * touch.stiffness, touch.offset)
        for row, touch in enumerate(bands)
    ]

    def passive(_: Any, now: Any) -> None:
        if not mechanism.steady:
            now.qfrc_passive[places] += forces(
                *now.qpos[places].tolist(), *now.qvel[places].tolist(), *u_now.tolist()
            )
        for row, band, rate, offset in pressed:
            now.efc_frictionloss[now.ne + row] = rate * max(offset - now.ten_length[band], 0.0)

    def advance(
        u: np.ndarray, slope: np.ndarray, count: int, h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return q, v (nq,) [m, rad, m/s, rad/s] after count steps of h [s]. Raises nothing.

        u: (nu,) [N, N m]; slope: (nu,) [N/s, N m/s].
        """
        model.opt.timestep = h
        for part in range(count if slope.any() else 1):
            u_now[:] = u + slope * h * (part + 0.5)
            if mechanism.steady:
                data.qfrc_applied[places] = forces(*[0.0] * (2 * scene.nq), *u_now.tolist())
            mujoco.mj_step(model, data, 1 if slope.any() else count)
        return back @ data.qpos[places], back @ data.qvel[places]

    mujoco.set_mjcb_passive(None if mechanism.steady and not pressed else passive)
    try:
        return stepped(drive, advance)
    finally:
        mujoco.set_mjcb_passive(None)


def _model(mechanism: Mechanism, names: list[str]) -> Any:
    """Return the model without constraint parameters, which need its inverse masses."""
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><option integrator="RK4" cone="elliptic" iterations="200" tolerance="1e-15" gravity="0 0 {-mechanism.gravity}">'
        '<flag refsafe="disable" autoreset="disable" island="disable"/></option><compiler angle="radian"/>'
        f"<worldbody>{mechanism.bodies}</worldbody></mujoco>"
    )
    for touch in mechanism.touches:
        if touch.damping and touch.law is DampingLaw.HUNT_CROSSLEY:
            raise CannotExpressError(
                f"contact {touch.name}: MuJoCo has no damping that grows with the depth (Hunt and Crossley's)"
            )
        band = {
            "name": touch.name,
            "stiffness": touch.stiffness,
            "springlength": [touch.offset, _FAR],
        }
        if touch.normal.any() and (not touch.friction or _band_rubs(touch)):
            limit = {
                "name": touch.name,
                "limited": True,
                "range": [touch.offset, _FAR],
                "solimp_limit": _IMPEDANCE,
            }
            _fixed(spec, names, touch.normal, **(limit if touch.damping else band))
        elif touch.centres is not None and not (touch.friction or touch.damping):
            tendon = spec.add_tendon(**band)
            for centre in touch.centres:
                tendon.wrap_site(
                    spec.body(names[centre[0]])
                    .add_site(name=f"{touch.name}_{names[centre[0]]}")
                    .name
                )
        elif touch.pads is None:
            raise CannotExpressError(f"contact {touch.name}: {touch.why}")
        else:
            _add_pair(spec, touch, touch.pads)
    # Friction rows follow the order of these tendons; `passive` sets the limits of bands.
    for name, direction, limit in _rubs(mechanism):
        _fixed(spec, names, direction, name=f"rub_{name}", frictionloss=limit)
    return spec.compile()


def _band_rubs(touch: Touch) -> bool:
    """Return whether a dead band makes the contact and another tendon its friction."""
    return bool(
        touch.friction and not touch.damping and touch.normal.any() and touch.slip is not None
    )


def _rubs(mechanism: Mechanism) -> list[tuple[str, np.ndarray, float]]:
    """Return the rubbing tendons: name, direction (nq,), limit [N]; those of bands first."""
    bands = [
        (touch.name, touch.slip, 1.0)
        for touch in mechanism.touches
        if touch.slip is not None and _band_rubs(touch)
    ]
    return bands + [
        (rub.name, rub.direction, rub.coefficient * rub.pressed) for rub in mechanism.rubs
    ]


def _add_pair(spec: Any, touch: Touch, pads: tuple[Pad, Pad]) -> None:
    names = [f"{touch.name}_{place}" for place in range(2)]
    for name, pad in zip(names, pads, strict=True):
        body = spec.body(pad.body) if pad.body else spec.worldbody
        shape, at, turn = (
            mujoco.mjtGeom.mjGEOM_SPHERE,
            np.array(pad.at),
            np.array([1.0, 0.0, 0.0, 0.0]),
        )
        if not pad.radius:
            shape, at = mujoco.mjtGeom.mjGEOM_BOX, at - _DEPTH * np.array(pad.normal)
            mujoco.mju_quatZ2Vec(turn, np.array(pad.normal))
        size = (pad.radius, 0.0, 0.0) if pad.radius else (_BLOCK, _BLOCK, _DEPTH)
        body.add_geom(
            name=name, type=shape, size=size, pos=at, quat=turn, mass=0.0, contype=0, conaffinity=0
        )
    rubs = [touch.friction, touch.friction, 0.0, 0.0, 0.0]
    condim = 3 if touch.friction else 1
    spec.add_pair(
        name=touch.name,
        geomname1=names[0],
        geomname2=names[1],
        condim=condim,
        solimp=_IMPEDANCE,
        friction=rubs,
    )


def _fixed(spec: Any, names: list[str], direction: np.ndarray, **what: Any) -> None:
    tendon = spec.add_tendon(**what)
    for place in np.flatnonzero(direction):
        tendon.wrap_joint(names[place], direction[place])


def _set_constraints(model: Any, mechanism: Mechanism, h: float) -> None:
    """Set stiffness, damping and friction compliance, scaled by MuJoCo's inverse masses."""
    model.opt.impratio = _RATIO
    for touch in mechanism.touches:
        pull = np.array([touch.stiffness, touch.damping])
        pair = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PAIR, touch.name)
        tendon = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TENDON, touch.name)
        if pair >= 0:
            bodies = model.geom_bodyid[[model.pair_geom1[pair], model.pair_geom2[pair]]]
            model.pair_solref[pair] = (
                -pull * touch.steepness**2 * model.body_invweight0[bodies, 0].sum()
            )
            model.pair_solreffriction[pair] = -_TINY, -min(_DECAY / h, _RATE) * _SOFT
        elif tendon >= 0:  # unused by a tendon with a dead band, which has no limit
            model.tendon_solref_lim[tendon] = -pull * model.tendon_invweight0[tendon]
    for name, _, _ in _rubs(mechanism):
        tendon = model.tendon(f"rub_{name}").id
        model.tendon_solimp_fri[tendon, :2] = _HARD
        model.tendon_solref_fri[tendon] = -_TINY, -_DECAY / h

"""The table of variables of a MuJoCo model, from which C, XML, documentation and map are written.

    q_J, v_J                            position and velocity of joint J
    q_J_x .. q_J_z, q_J_qw .. q_J_qz    position and quaternion of a free joint
    v_J_x .. v_J_z, v_J_wx .. v_J_wz    its velocity, and angular velocity in body axes
    u_A, act_A                          input and activation of actuator A
    s_S, mass_B                         sensor, mass of a body
    lam_A_B, gap_A_B                    a requested contact

Characters that FMI's structured names do not allow become `_`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import MachineError, TouchstoneError, did_you_mean
from models.fmu.variables import SMALLEST_INTERNAL_STEP, Variable, VariableKind, numbered


class RobotError(TouchstoneError):
    """A file that is no MuJoCo model, or one that an FMU cannot represent."""


# Indexed by MuJoCo's numbers + 1, as in equations.h.
INTEGRATORS = (
    ("euler", "semi-implicit Euler, joint damping implicit"),
    ("rk4", "Runge-Kutta of order 4, contacts are not located"),
    ("implicit", "implicit in the velocities"),
    ("implicitfast", "implicit in the velocities, without the derivatives of Coriolis forces"),
    ("discrete", "constraints solved in the metric of the time step"),
)
# Scales of all contacts: name, scaled quantity, smallest value.
_SCALES = (
    ("friction_scale", "the friction coefficients of all geoms and pairs", 0.0),
    (
        "contact_stiffness_scale",
        "the stiffness of all contacts, at the same damping ratio (solref)",
        1e-12,
    ),
    (
        "contact_give_scale",
        "1 - d, by which all contacts give way, of the impedances d0 and dmax (solimp)",
        1e-12,
    ),
)
# The range of an unlimited control.
_UNCUT = (-math.inf, math.inf)
# Largest measured gap [m].
FARTHEST = 10.0
_FREE = 0
_BALL = 1
_SLIDE = 2
_AXES = ("x", "y", "z")
_QUATERNION = ("qw", "qx", "qy", "qz")
_TURNS = ("wx", "wy", "wz")
# Units of sensors by the suffix of MuJoCo's type name; other types have any unit.
_SENSOR_UNITS = {
    "TOUCH": "N", "ACCELEROMETER": "m/s^2", "VELOCIMETER": "m/s", "GYRO": "rad/s", "FORCE": "N",
    "TORQUE": "N m", "RANGEFINDER": "m", "TENDONPOS": "m",
    "TENDONVEL": "m/s", "TENDONACTFRC": "N", "BALLANGVEL": "rad/s", "FRAMEPOS": "m",
    "FRAMELINVEL": "m/s", "FRAMEANGVEL": "rad/s", "FRAMELINACC": "m/s^2",
    "FRAMEANGACC": "rad/s^2", "SUBTREECOM": "m", "SUBTREELINVEL": "m/s", "GEOMDIST": "m",
    "GEOMFROMTO": "m", "E_POTENTIAL": "J", "E_KINETIC": "J", "CLOCK": "s",
}  # fmt: skip


def mujoco() -> Any:
    """Return the package; raise MachineError without it."""
    try:
        import mujoco  # 0.1 s, and an extra
    except ImportError as error:
        raise MachineError(
            "an MJCF needs MuJoCo, which is not installed; install it with: pip install mujoco"
        ) from error
    return mujoco


def _plain(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


@dataclass(frozen=True, kw_only=True)
class GeomPair:
    """A requested contact: names of both sides (geoms or bodies), and their geoms."""

    names: tuple[str, str]
    geoms: tuple[range, range]

    @property
    def name(self) -> str:
        """Return the name in names of variables."""
        return "_".join(map(_plain, self.names))


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A compiled model with its file, start, and requested contacts.

    The start is the number of a keyframe, or -1 for the default.
    """

    path: Path
    model: Any
    start: Any
    keyframe: int = -1
    contacts: tuple[GeomPair, ...] = ()

    @property
    def identifier(self) -> str:
        """Return the FMU's identifier: the file's name as a C identifier."""
        name = _plain(self.path.stem)
        return name if name[:1].isalpha() else f"robot_{name}"

    @cached_property
    def table(self) -> tuple[Variable, ...]:
        """Return the variables; the position in the table is the value reference.

        Raises RobotError for equal names.
        """
        time = Variable(name="time", kind=VariableKind.TIME, unit="s", description="time")
        table = (time, *_states(self), *_inputs(self), *_outputs(self), *_settings(self))
        seen: dict[str, Variable] = {}
        for variable in table:
            other = seen.setdefault(variable.name, variable)
            if other is not variable:
                raise RobotError(
                    f"{self.path}: {other.description} and {variable.description} would both be called {variable.name!r}, as FMI's names have letters, "
                    "digits and _ alone; rename one of them."
                )
        return table

    def of(self, *kinds: VariableKind) -> list[Variable]:
        """Return the variables of these kinds."""
        return [variable for variable in self.table if variable.kind in kinds]

    @cached_property
    def masses(self) -> tuple[int, ...]:
        """Return the bodies with a mass."""
        return tuple(
            body for body in range(1, self.model.nbody) if self.model.body_mass[body] > 0.0
        )

    @cached_property
    def no_exchange(self) -> str | None:
        """Return the reason why the FMU has no Model Exchange, or None."""
        model = self.model
        touching = (model.geom_contype | model.geom_conaffinity) != 0
        rubs = (
            (model.geom_condim[touching] > 1).any() or (model.pair_dim > 1).any() or model.nflex > 0
        )
        if rubs and not model.opt.disableflags & int(mujoco().mjtDisableBit.mjDSBL_CONTACT):
            # A ball that slides at 2 m/s is pushed up by 80 m/s^2 at zero depth, where its force
            # jumps: LSODA took 430,000 evaluations for 5 ms of a hopper's foot.
            return "contacts have friction, and MuJoCo pushes what slides off the ground at no depth at all, where the force jumps: integrators get stuck"
        if model.nhistory:
            return "an actuator or a sensor has a delay, which is no state that an integrator could move"
        if model.nplastic:
            return "a spring or a flex is plastic, which changes within MuJoCo's steps alone"
        if model.nactuator and (model.actuator_actlimited.any() or model.actuator_actearly.any()):
            return "an activation is cut at its range, or used a step early, within MuJoCo's steps alone"
        return None

    @property
    def notes(self) -> list[str]:
        """Return remarks on the FMU, one sentence each."""
        free = [
            variable.name
            for variable in self.of(VariableKind.INPUT)
            if variable.upper == float("inf")
        ]
        cut = [
            f"{variable.name} {command:g} to {variable.start:g}"
            for variable, command in zip(
                self.of(VariableKind.INPUT), self.start.ctrl.tolist(), strict=True
            )
            if command != variable.start
        ]
        source = (
            "the default control"
            if self.keyframe < 0
            else f"keyframe {self.model.key(self.keyframe).name!r}"
        )
        remarks = {
            f"{source} is beyond the ctrlrange, and is cut as MuJoCo cuts it: {', '.join(cut[:5])}{' ..' * (len(cut) > 5)}.": cut,
            "the model has no actuators, so the FMU has no inputs: it can be simulated, but no plan can drive it.": not self.model.nu,
            f"no ctrlrange is in force for {', '.join(free[:5])}{' ..' * (len(free) > 5)}: bounds of these inputs are not asked of a plan.": free,
            f"no Model Exchange: {self.no_exchange}.": self.no_exchange is not None,
            "bodies that follow a motion capture stay where they start: the FMU has no inputs for them.": self.model.nmocap,
        }
        return [text for text, applies in remarks.items() if applies]

    @cached_property
    def dofs(self) -> tuple[int | None, ...]:
        """Return (nq,) the degree of freedom of each position's rate, None for quaternions."""
        dofs: list[int | None] = [None] * self.model.nq
        for first, dof, moves in self._joints():
            dofs[first : first + moves] = range(dof, dof + moves)
        return tuple(dofs)

    @cached_property
    def quaternions(self) -> tuple[tuple[int, int], ...]:
        """Return for each free and ball joint the places of quaternion and angular velocity."""
        kinds = self.model.jnt_type
        return tuple(
            (first + moves, dof + moves)
            for (first, dof, moves), kind in zip(self._joints(), kinds, strict=True)
            if kind in (_FREE, _BALL)
        )

    def _joints(self) -> Iterator[tuple[int, int, int]]:
        """Yield first position, first velocity and number of simple positions of each joint."""
        model = self.model
        for first, dof, kind in zip(
            model.jnt_qposadr, model.jnt_dofadr, model.jnt_type, strict=True
        ):
            yield int(first), int(dof), {_FREE: 3, _BALL: 0}.get(int(kind), 1)

    @property
    def turns(self) -> list[Variable]:
        """Return the angular velocities of free and ball joints, three per joint."""
        velocities = self.of(VariableKind.VELOCITY)
        return [item for _, dof in self.quaternions for item in velocities[dof : dof + 3]]

    @property
    def velocities(self) -> list[tuple[Variable, str, str]]:
        """Return variable, variable of the rate, and the rate's column in a plan, by position."""
        velocities, rows = self.of(VariableKind.VELOCITY), []
        for variable, dof in zip(self.of(VariableKind.POSITION), self.dofs, strict=True):
            rate = f"der({variable.name})" if dof is None else velocities[dof].name
            rows.append((variable, rate, f"v_{variable.name.removeprefix('q_')}"))
        return rows

    @property
    def map_text(self) -> str:
        """Return MAP.toml for a plan whose columns have the FMU's names."""

        def same(variables: list[Variable]) -> list[str]:
            return [f'{variable.name} = "{variable.name}"' for variable in variables]

        sections = {
            "inputs": same(self.of(VariableKind.INPUT)),
            "positions": same(self.of(VariableKind.POSITION)),
            "velocities": [
                f'{of.name} = {{ variable = "{rate}", column = "{column}" }}'
                for of, rate, column in self.velocities
            ],
            **{
                f"contacts.{pair.name}": [f'force = "lam_{pair.name}"', f'gap = "gap_{pair.name}"']
                for pair in self.contacts
            },
            # Angular velocities have columns of their own; without these lines they are zero.
            "start": same(self.turns),
            "uncertainty": [
                f"gravity_{axis} = {{ value = 0.0, reason = 'it is known' }}" for axis in "xyz"
            ],
        }
        title = f"# {self.path.name} as an FMU: maps the columns of a plan to its variables. docs/replay.md describes all entries."
        body = [
            "\n".join(["", f"[{name}]", *lines])
            for name, lines in sections.items()
            if lines or name != "start"
        ]
        return "\n".join([title, 'internal_step = "timestep"', *body]) + "\n"


def read_robot(path: Path, contacts: Sequence[str] = (), keyframe: str | None = None) -> Robot:
    """Read a robot from an MJCF, URDF or MJB file; contacts: `A:B`, names of geoms or bodies.

    Raises RobotError, MachineError.
    """
    package = mujoco()
    if not path.is_file():
        raise RobotError(
            f"{path}: there is no such file; give an MJCF or URDF (.xml, .urdf) or a compiled model (.mjb)."
        )
    load = (
        package.MjModel.from_binary_path
        if path.suffix.lower() == ".mjb"
        else package.MjModel.from_xml_path
    )
    warnings, before = list[str](), package.get_mju_user_warning()
    # MuJoCo would write warnings to a file here, and to stderr.
    package.set_mju_user_warning(warnings.append)
    try:
        model = load(str(path))
    except (ValueError, package.FatalError, package.UnexpectedError) as error:
        details = "; ".join(" ".join(text.split()).rstrip(".") for text in (str(error), *warnings))
        raise RobotError(
            f"{path}: MuJoCo {package.__version__} does not read it ({details}); correct it, or, if it was made for another version, install that one."
        ) from error
    finally:
        package.set_mju_user_warning(before)
    lost = _lost(package, model)
    if lost is not None:
        raise RobotError(f"{path}: {lost}.")
    start, key = package.MjData(model), -1
    if keyframe is not None:
        names = [model.key(number).name for number in range(model.nkey)]
        if keyframe not in names:
            raise RobotError(
                f"{path}: it has no keyframe {keyframe!r}; {did_you_mean(keyframe, names, 'it has ' + (', '.join(names) or 'none'))}."
            )
        key = names.index(keyframe)
        package.mj_resetDataKeyframe(model, start, key)
    return Robot(
        path=path,
        model=model,
        start=start,
        keyframe=key,
        contacts=tuple(_contact(path, model, text) for text in contacts),
    )


def _lost(package: Any, model: Any) -> str | None:
    """Return the feature that an FMU would lose, or that is not in its state."""
    if model.nplugin:
        return "it uses a plugin of MuJoCo, which an FMU does not carry; take <extension> and what uses it out"
    if not model.opt.timestep >= SMALLEST_INTERNAL_STEP:
        return f"its timestep is {model.opt.timestep:g} s; give it one of at least {SMALLEST_INTERNAL_STEP:g} s in <option>"
    for word in ("sleep", "ipc"):
        if model.opt.enableflags & getattr(package.mjtEnableBit, f"mjENBL_{word.upper()}"):
            return f"it enables {word}, whose bookkeeping is not in the state that MuJoCo saves; take the flag out of <option>"
    dyn, gain, bias, sensor = package.mjtDyn, package.mjtGain, package.mjtBias, package.mjtSensor
    users = {
        "actuators": ((model.actuator_dyntype, dyn.mjDYN_USER),
                      (model.actuator_gaintype, gain.mjGAIN_USER),
                      (model.actuator_biastype, bias.mjBIAS_USER)),
        "sensors": ((model.sensor_type, sensor.mjSENS_USER),),
    }  # fmt: skip
    for what, parts in users.items():
        if any((types == int(user)).any() for types, user in parts):
            return f"{what} of the type 'user' are computed by a program around MuJoCo, which an FMU does not have; take them out"
    return None


def _contact(path: Path, model: Any, text: str) -> GeomPair:
    """Return the contact `A:B`; names may contain colons."""
    geoms = {
        name: range(number, number + 1)
        for number in range(model.ngeom)
        if (name := model.geom(number).name)
    }
    for body in range(model.nbody):
        first = int(model.body_geomadr[body])
        geoms.setdefault(model.body(body).name, range(first, first + int(model.body_geomnum[body])))
    parts = text.split(":")
    for cut in range(1, len(parts)):
        one, other = names = ":".join(parts[:cut]), ":".join(parts[cut:])
        sides = geoms.get(one, range(0)), geoms.get(other, range(0))
        if all(sides) and not set(sides[0]) & set(sides[1]):
            return GeomPair(names=names, geoms=sides)
    known = [name for name, found in geoms.items() if name and found]
    missing = next((name for name in parts if name not in known), text)
    advice = did_you_mean(missing, known, f"it has {', '.join(known[:8])} ...")
    raise RobotError(
        f"{path}: the contact {text!r} is not of two geoms, or bodies with geoms, written A:B; {advice}"
    )


def _named(
    count: int, name_of: Callable[[int], str], fallback: Callable[[int], str]
) -> list[tuple[str, str]]:
    """Return for each the name in variables, and the original name.

    Without a name it is `fallback`, with a number if that is taken.
    """
    names = [name_of(number) for number in range(count)]
    for number, name in enumerate(names):
        if not name:
            candidate = fallback(number)
            names[number] = (
                candidate if candidate and candidate not in names else f"{candidate}{number}"
            )
    return [(_plain(name), name) for name in names]


def _joint_names(model: Any) -> list[tuple[str, str]]:
    bodies = [model.body(int(body)).name or "joint" for body in model.jnt_bodyid]
    return _named(model.njnt, lambda number: model.joint(number).name, bodies.__getitem__)


def _states(robot: Robot) -> list[Variable]:
    """Return positions, velocities and activations in MuJoCo's order, then their rates."""
    model, data = robot.model, robot.start
    positions: list[tuple[str, str, str]] = []
    velocities: list[tuple[str, str, str]] = []
    for (name, original), kind in zip(_joint_names(model), model.jnt_type, strict=True):
        if kind in (_FREE, _BALL):
            moves = _AXES if kind == _FREE else ()
            positions += [
                (f"q_{name}_{axis}", "m", f"position {axis} of joint {original}") for axis in moves
            ]
            positions += [
                (f"q_{name}_{part}", "1", f"orientation {part} of joint {original} (quaternion)")
                for part in _QUATERNION
            ]
            velocities += [
                (f"v_{name}_{axis}", "m/s", f"velocity {axis} of joint {original}")
                for axis in moves
            ]
            velocities += [
                (
                    f"v_{name}_{axis}",
                    "rad/s",
                    f"angular velocity {axis} of joint {original}, in the body's axes",
                )
                for axis in _TURNS
            ]
        else:
            unit = "m" if kind == _SLIDE else "rad"
            positions.append((f"q_{name}", unit, f"position of joint {original}"))
            velocities.append((f"v_{name}", f"{unit}/s", f"velocity of joint {original}"))
    for actuator, (name, original) in enumerate(_actuator_names(model)):
        count = int(model.actuator_actnum[actuator])
        velocities += [
            (f"act_{name}{f'_{k}' * (count > 1)}", "1", f"activation of actuator {original}")
            for k in range(count)
        ]
    kinds, starts, states = (
        VariableKind,
        iter([*data.qpos, *data.qvel, *data.act]),
        list[Variable](),
    )
    for kind, rows in ((kinds.POSITION, positions), (kinds.VELOCITY, velocities)):
        states += numbered(kind, [(*row, float(next(starts))) for row in rows], len(states))
    for kind, rows in ((kinds.POSITION_RATE, positions), (kinds.VELOCITY_RATE, velocities)):
        rates = [
            (
                f"der({name})",
                f"{unit.removesuffix('/s')}/s{'^2' * unit.endswith('/s')}",
                f"rate of {text}",
            )
            for name, unit, text in rows
        ]
        states += numbered(kind, rates, 0 if kind is kinds.POSITION_RATE else len(positions))
    return states


def _actuator_names(model: Any) -> list[tuple[str, str]]:
    kinds = mujoco().mjtTrn

    def target(actuator: int) -> str:
        kind, number = model.actuator_trntype[actuator], int(model.actuator_trnid[actuator, 0])
        on_joint = kind in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT))
        return (
            _joint_names(model)[number][1]
            if on_joint
            else model.tendon(number).name
            if kind == int(kinds.mjTRN_TENDON)
            else "actuator"
        )

    return _named(model.nactuator, lambda number: model.actuator(number).name, target)


def _input_unit(model: Any, actuator: int) -> str:
    """Return the unit of an input: a joint's force, or a servo's target; "1" if unclear."""
    package, joint = (
        mujoco(),
        (int(mujoco().mjtTrn.mjTRN_JOINT), int(mujoco().mjtTrn.mjTRN_JOINTINPARENT)),
    )
    gear, factor = list(model.actuator_gear[actuator]), float(model.actuator_gainprm[actuator, 0])
    on_joint = (
        model.actuator_trntype[actuator] in joint
        and model.jnt_type[model.actuator_trnid[actuator, 0]] >= _SLIDE
    )
    fixed = (
        model.actuator_gaintype[actuator] == int(package.mjtGain.mjGAIN_FIXED)
        and not model.actuator_actnum[actuator]
    )
    if not on_joint or not fixed or gear != [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]:
        return "1"
    length, force = (
        ("m", "N")
        if model.jnt_type[model.actuator_trnid[actuator, 0]] == _SLIDE
        else ("rad", "N m")
    )
    kind, bias = (
        int(model.actuator_biastype[actuator]),
        model.actuator_biasprm[actuator, :3] / (factor or 1.0),
    )
    if kind == int(package.mjtBias.mjBIAS_NONE):
        return force if factor == 1.0 else "1"
    servo = {(0.0, -1.0): length, (0.0, 0.0): f"{length}/s" if bias[2] == -1.0 else "1"}
    return servo.get((bias[0], bias[1]), "1") if kind == int(package.mjtBias.mjBIAS_AFFINE) else "1"


def _range_of(model: Any, control: int) -> tuple[float, float]:
    """Return the range in which MuJoCo clips a control, or an infinite one."""
    uncut = model.opt.disableflags & int(mujoco().mjtDisableBit.mjDSBL_CLAMPCTRL)
    if uncut or not model.actuator_ctrllimited[control]:
        return _UNCUT
    lower, upper = map(float, model.actuator_ctrlrange[control])
    return lower, upper


def _inputs(robot: Robot) -> list[Variable]:
    model, package, rows = robot.model, mujoco(), list[tuple]()
    for actuator, (name, original) in enumerate(_actuator_names(model)):
        first, count = int(model.actuator_ctrladr[actuator]), int(model.actuator_ctrlnum[actuator])
        for part in range(count):
            suffix = (
                f"_{package.mj_actuatorInputName(model, actuator, part) or part}"
                if count > 1
                else ""
            )
            unit = _input_unit(model, actuator) if count == 1 else "1"
            lower, upper = _range_of(model, first + part)
            bounds = (lower, upper) if (lower, upper) != _UNCUT else ()
            text = f"control of actuator {original}{', cut at its range' if bounds else ''}"
            start = min(max(float(robot.start.ctrl[first + part]), lower), upper)
            rows.append((f"u_{name}{suffix}", unit, text, start, *bounds))
    return numbered(VariableKind.INPUT, rows)


def _outputs(robot: Robot) -> list[Variable]:
    """Return sensors, then forces, then gaps of the requested contacts."""
    model, package, rows = robot.model, mujoco(), list[tuple]()
    names = _named(
        model.nsensor, lambda number: model.sensor(number).name, lambda number: f"sensor{number}"
    )
    for sensor, (name, original) in enumerate(names):
        kind = package.mjtSensor(int(model.sensor_type[sensor])).name.removeprefix("mjSENS_")
        size, unit = int(model.sensor_dim[sensor]), _SENSOR_UNITS.get(kind, "1")
        if kind in ("JOINTPOS", "JOINTVEL"):
            length = "m" if model.jnt_type[int(model.sensor_objid[sensor])] == _SLIDE else "rad"
            unit = length if kind == "JOINTPOS" else f"{length}/s"
        rows += [
            (f"s_{name}{f'_{part}' * (size > 1)}", unit, f"sensor {original} ({kind.lower()})")
            for part in range(size)
        ]
    sides = [(pair.name, " and ".join(pair.names)) for pair in robot.contacts]
    rows += [
        (f"lam_{name}", "N", f"sum of the normal forces between {text}") for name, text in sides
    ]
    far = f"negative where they overlap, at most {FARTHEST:g} m"
    rows += [(f"gap_{name}", "m", f"smallest distance of {text}, {far}") for name, text in sides]
    return numbered(VariableKind.OUTPUT, rows)


def _settings(robot: Robot) -> list[Variable]:
    model, kinds, settings = robot.model, VariableKind, list[Variable]()
    bodies = _named(model.nbody, lambda number: model.body(number).name, lambda number: "body")
    step = "longest time step; equal steps divide each communication step"
    groups = (
        (kinds.TUNABLE,
         [(f"gravity_{axis}", "m/s^2", f"gravity along {axis}", float(value)) for axis,
          value in zip(_AXES, model.opt.gravity, strict=True)]),
        (kinds.TUNABLE,
         [(name, "1", f"multiplies {text}", 1.0, lower) for name, text, lower in _SCALES]),
        (kinds.INTERNAL_STEP,
         [("timestep", "s", step, float(model.opt.timestep), SMALLEST_INTERNAL_STEP)]),
        (kinds.INTEGRATOR,
         [("integrator", "", "method of the time step", 1.0 + model.opt.integrator, 1.0,
           float(len(INTEGRATORS)))]),
        (kinds.TUNABLE,
         [(f"mass_{bodies[body][0]}", "kg",
           f"mass of body {bodies[body][1]}, with its inertia in proportion",
           float(model.body_mass[body]), 1e-12) for body in robot.masses]),
    )  # fmt: skip
    for kind, rows in groups:
        settings += numbered(kind, rows, len(settings))
    return settings


class Recorder:
    """Record a MuJoCo simulation as a plan for the FMU's map.

    Call `record` before each `mj_step` and after the last one; model is an `mujoco.MjModel`.
    """

    def __init__(self, model: Any) -> None:
        self._package = mujoco()
        robot = Robot(path=Path("robot"), model=model, start=self._package.MjData(model))
        self._quaternions = robot.quaternions
        self._turns = [dof + part for _, dof in robot.quaternions for part in range(3)]
        # Velocities of a quaternion are computed.
        self._velocities = [0 if dof is None else dof for dof in robot.dofs]
        columns = [
            variable.name
            for kind in (VariableKind.INPUT, VariableKind.POSITION)
            for variable in robot.of(kind)
        ]
        self.columns = [
            "t",
            *columns,
            *(column for _, _, column in robot.velocities),
            *(variable.name for variable in robot.turns),
        ]
        self.rows: list[list[float]] = []

    def record(self, data: Any) -> None:
        """Store time [s], controls, positions and velocities of an MjData."""
        velocities, turns = data.qvel[self._velocities], data.qvel[self._turns]
        for (at, _), turn in zip(self._quaternions, turns.reshape(-1, 3), strict=True):
            self._package.mju_mulQuatAxis(
                velocities[at : at + 4], data.qpos[at : at + 4], turn / 2.0
            )  # dq/dt = q (0, w) / 2
        self.rows.append(
            np.concatenate([[data.time], data.ctrl, data.qpos, velocities, turns]).tolist()
        )

    def write(self, path: Path | str) -> None:
        """Write a CSV whose numbers read back bit for bit."""
        lines = [",".join(self.columns), *(",".join(map(repr, row)) for row in self.rows)]
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")

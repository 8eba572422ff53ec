"""A model of MuJoCo as a table of variables, from which C, XML, the documentation and the map of the FMU are written.

Names: `q_J` the position and `v_J` the velocity of joint J; of a free joint `q_J_x` .. `q_J_z`, `q_J_qw` .. `q_J_qz` (its quaternion) and `v_J_x` .. `v_J_z`,
`v_J_wx` .. `v_J_wz` (its angular velocity, in the axes of the body); `u_A` the input of actuator A, `act_A` its activation, `s_S` a sensor, `lam_A_B` and
`gap_A_B` a contact that was asked for, `mass_B` of a body. Signs that FMI's structured names do not have become `_`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from models.errors import MachineError, TouchstoneError, did_you_mean
from models.fmu.variables import SMALLEST_INTERNAL_STEP, Variable, VariableKind


class RobotError(TouchstoneError):
    """A file is no model of MuJoCo, or one that an FMU cannot carry."""


# By MuJoCo's numbers + 1, as in equations.h.
INTEGRATORS = (
    ("euler", "semi-implicit Euler, joint damping implicit"),
    ("rk4", "Runge-Kutta of order 4, contacts are not located"),
    ("implicit", "implicit in the velocities"),
    ("implicitfast", "implicit in the velocities, without the derivatives of Coriolis forces"),
    ("discrete", "constraints solved in the metric of the time step"),
)
GRAVITY_AXES = ("x", "y", "z")
# Scales of all contacts: name, meaning.
SCALES = (
    ("friction_scale", "multiplies the friction coefficients of all geoms and pairs"),
    ("contact_stiffness_scale", "multiplies the stiffness of all contacts, at the same damping ratio (solref)"),
    ("contact_give_scale", "multiplies 1 - d, by which all contacts give way, of the impedances d0 and dmax (solimp)"),
)
# Gaps are measured up to here [m].
FARTHEST = 10.0
_FREE, _BALL, _SLIDE = 0, 1, 2
_QUATERNION = ("qw", "qx", "qy", "qz")
_TURNS = ("wx", "wy", "wz")
# Of a sensor by the end of MuJoCo's name for its type; what is not here may be in anything.
_SENSOR_UNITS = {
    "TOUCH": "N", "ACCELEROMETER": "m/s^2", "VELOCIMETER": "m/s", "GYRO": "rad/s", "FORCE": "N", "TORQUE": "N m", "RANGEFINDER": "m", "TENDONPOS": "m",
    "TENDONVEL": "m/s", "TENDONACTFRC": "N", "BALLANGVEL": "rad/s", "FRAMEPOS": "m", "FRAMELINVEL": "m/s", "FRAMEANGVEL": "rad/s", "FRAMELINACC": "m/s^2",
    "FRAMEANGACC": "rad/s^2", "SUBTREECOM": "m", "SUBTREELINVEL": "m/s", "GEOMDIST": "m", "GEOMFROMTO": "m", "E_POTENTIAL": "J", "E_KINETIC": "J", "CLOCK": "s",
}  # fmt: skip


def mujoco() -> Any:
    """The package. Raises MachineError without it."""
    try:
        import mujoco  # 0.1 s, and an extra
    except ImportError as error:
        raise MachineError("an MJCF needs MuJoCo, which is not installed; install it with: pip install mujoco") from error
    return mujoco


@dataclass(frozen=True, kw_only=True)
class GeomPair:
    """Two sides whose contact is asked for: of each its name, whether it is a body (all its geoms), its number."""

    names: tuple[str, str]
    is_body: tuple[bool, bool]
    ids: tuple[int, int]

    @property
    def name(self) -> str:
        """In names of variables."""
        return "_".join(_plain(name) for name in self.names)


def _plain(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A compiled model, where it came from, where it starts (a keyframe's number, -1: its default), and which contacts are asked for."""

    path: Path
    model: Any
    start: Any
    keyframe: int
    contacts: tuple[GeomPair, ...]

    @property
    def identifier(self) -> str:
        """Of the FMU: the file's name as C may have it."""
        name = _plain(self.path.stem)
        return name if name[:1].isalpha() else f"robot_{name}"

    @cached_property
    def table(self) -> tuple[Variable, ...]:
        """Every variable; the position in the table is the value reference. Raises RobotError where two have one name."""
        time = Variable(name="time", kind=VariableKind.TIME, unit="s", description="time")
        states = _states(self)
        rates = [_rate(variable) for variable in states]
        table = (time, *states, *rates, *_inputs(self), *_outputs(self), *_settings(self))
        seen: dict[str, Variable] = {}
        for variable in table:
            other = seen.setdefault(variable.name, variable)
            if other is not variable:
                raise RobotError(
                    f"{self.path}: {other.description} and {variable.description} would both be called {variable.name!r}, as FMI's names have letters, "
                    "digits and _ alone; rename one of them."
                )
        return table

    @cached_property
    def masses(self) -> tuple[int, ...]:
        """Bodies that have a mass."""
        return tuple(body for body in range(1, self.model.nbody) if self.model.body_mass[body] > 0.0)

    @cached_property
    def no_exchange(self) -> str | None:
        """Why the FMU has no Model Exchange; None where it has."""
        model = self.model
        touching = (model.geom_contype | model.geom_conaffinity) != 0
        rubs = (model.geom_condim[touching] > 1).any() or (model.pair_dim > 1).any() or model.nflex > 0
        if rubs and not model.opt.disableflags & int(mujoco().mjtDisableBit.mjDSBL_CONTACT):
            # A ball that slides at 2 m/s is pushed up by 80 m/s^2 at a depth of nothing, where its force jumps: LSODA took 430,000 evaluations
            # for 5 ms of a hopper's foot.
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
        """What is to be said of the FMU, a sentence each."""
        model, found = self.model, []
        if not model.nu:
            found.append("the model has no actuators, so the FMU has no inputs: it can be simulated, but no plan can drive it.")
        free = [variable.name for variable in self.table if variable.kind is VariableKind.INPUT and variable.upper == float("inf")]
        if free:
            found.append(
                f"no ctrlrange is set for {', '.join(free[:5])}{' ..' * (len(free) > 5)}: bounds of these inputs are not asked of a plan."
            )
        if self.no_exchange is not None:
            found.append(f"no Model Exchange: {self.no_exchange}.")
        if model.nmocap:
            found.append("bodies that follow a motion capture stay where they start: the FMU has no inputs for them.")
        return found

    @property
    def map_text(self) -> str:
        """MAP.toml: a plan whose columns have the FMU's names."""
        return _map(self)


def read_robot(path: Path, contacts: Sequence[str] = (), keyframe: str | None = None) -> Robot:
    """A robot of an MJCF, URDF or MJB file; contacts: `A:B`, names of geoms or bodies. Raises RobotError, MachineError."""
    package = mujoco()
    if not path.is_file():
        raise RobotError(f"{path}: there is no such file; give an MJCF or URDF (.xml, .urdf) or a compiled model (.mjb).")
    load = package.MjModel.from_binary_path if path.suffix.lower() == ".mjb" else package.MjModel.from_xml_path
    warnings, before = list[str](), package.get_mju_user_warning()
    package.set_mju_user_warning(warnings.append)  # which MuJoCo would write to a file here, and to stderr
    try:
        model = load(str(path))
    except (ValueError, package.FatalError, package.UnexpectedError) as error:
        said = "; ".join(" ".join(text.split()).rstrip(".") for text in (str(error), *warnings))
        raise RobotError(
            f"{path}: MuJoCo {package.__version__} does not read it ({said}); correct it, or, if it was made for another version, install that one."
        ) from error
    finally:
        package.set_mju_user_warning(before)
    _check_carried(package, path, model)
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
        path=path, model=model, start=start, keyframe=key, contacts=tuple(_contact(package, path, model, text) for text in contacts)
    )


def _check_carried(package: Any, path: Path, model: Any) -> None:
    """What would be lost in an FMU, or is not in the state that it saves."""
    if model.nplugin:
        raise RobotError(f"{path}: it uses a plugin of MuJoCo, which an FMU does not carry; take <extension> and what uses it out.")
    flags = package.mjtEnableBit
    for word, flag in (("sleep", flags.mjENBL_SLEEP), ("ipc", flags.mjENBL_IPC)):
        if model.opt.enableflags & flag:
            raise RobotError(
                f"{path}: it enables {word}, whose bookkeeping is not in the state that MuJoCo saves; take the flag out of <option>."
            )
    kinds = [
        ("actuator", model.actuator_dyntype, package.mjtDyn.mjDYN_USER), ("actuator", model.actuator_gaintype, package.mjtGain.mjGAIN_USER),
        ("actuator", model.actuator_biastype, package.mjtBias.mjBIAS_USER), ("sensor", model.sensor_type, package.mjtSensor.mjSENS_USER),
    ]  # fmt: skip
    for what, types, user in kinds:
        if (types == int(user)).any():
            raise RobotError(
                f"{path}: {what}s of the type 'user' are computed by a program around MuJoCo, which an FMU does not have; take them out."
            )


def _contact(package: Any, path: Path, model: Any, text: str) -> GeomPair:
    """`A:B`; names may hold colons themselves."""
    objects = package.mjtObj

    def find(name: str) -> tuple[bool, int] | None:
        for is_body, kind in ((False, objects.mjOBJ_GEOM), (True, objects.mjOBJ_BODY)):
            number = package.mj_name2id(model, kind, name)
            if number >= 0:
                return is_body, number
        return None

    parts = text.split(":")
    for cut in range(1, len(parts)):
        names = ":".join(parts[:cut]), ":".join(parts[cut:])
        sides = [find(name) for name in names]
        if sides[0] is not None and sides[1] is not None and sides[0] != sides[1]:
            return GeomPair(names=names, is_body=(sides[0][0], sides[1][0]), ids=(sides[0][1], sides[1][1]))
    known = [model.geom(number).name for number in range(model.ngeom)] + [model.body(number).name for number in range(model.nbody)]
    missing = next((name for name in parts if find(name) is None), text)
    advice = did_you_mean(missing, [name for name in known if name], f"it has {', '.join([name for name in known if name][:8])} ..")
    raise RobotError(f"{path}: the contact {text!r} is not of two geoms or bodies, written A:B; {advice}.")


def _named(count: int, name_of: Callable[[int], str], fallback: Callable[[int], str]) -> list[tuple[str, str]]:
    """Of each its name in those of variables, and as it is written; of one without a name a fallback, with its number where that is taken."""
    said = [name_of(number) for number in range(count)]
    for number, name in enumerate(said):
        if not name:
            wanted = fallback(number)
            said[number] = wanted if wanted and wanted not in said else f"{wanted}{number}"
    return [(_plain(name), name) for name in said]


def joint_names(model: Any) -> list[tuple[str, str]]:
    """Of each joint its name in those of variables, and as it is written; of one without a name that of its body."""
    return _named(
        model.njnt, lambda number: model.joint(number).name, lambda number: model.body(int(model.jnt_bodyid[number])).name or "joint"
    )


def _states(robot: Robot) -> list[Variable]:
    """Positions, velocities and activations, in MuJoCo's order."""
    model, data = robot.model, robot.start
    positions: list[tuple[str, str, str]] = []
    velocities: list[tuple[str, str, str]] = []
    for (name, said), kind in zip(joint_names(model), model.jnt_type, strict=True):
        if kind in (_FREE, _BALL):
            moves = GRAVITY_AXES if kind == _FREE else ()
            positions += [(f"q_{name}_{axis}", "m", f"position {axis} of joint {said}") for axis in moves]
            positions += [(f"q_{name}_{part}", "1", f"orientation {part} of joint {said} (quaternion)") for part in _QUATERNION]
            velocities += [(f"v_{name}_{axis}", "m/s", f"velocity {axis} of joint {said}") for axis in moves]
            velocities += [(f"v_{name}_{axis}", "rad/s", f"angular velocity {axis} of joint {said}, in the body's axes") for axis in _TURNS]
        else:
            unit = "m" if kind == _SLIDE else "rad"
            positions.append((f"q_{name}", unit, f"position of joint {said}"))
            velocities.append((f"v_{name}", f"{unit}/s", f"velocity of joint {said}"))
    for actuator, (name, said) in enumerate(_actuator_names(robot)):
        count = int(model.actuator_actnum[actuator])
        velocities += [(f"act_{name}{f'_{k}' * (count > 1)}", "1", f"activation of actuator {said}") for k in range(count)]
    starts = [*data.qpos, *data.qvel, *data.act]
    kinds = [VariableKind.POSITION] * model.nq + [VariableKind.VELOCITY] * (model.nv + model.na)
    return [
        Variable(name=name, kind=kind, index=number - (0 if kind is VariableKind.POSITION else model.nq), unit=unit, description=text, start=float(start), nominal=1.0)
        for number, ((name, unit, text), kind, start) in enumerate(zip(positions + velocities, kinds, starts, strict=True))
    ]  # fmt: skip


def _rate(state: Variable) -> Variable:
    is_position = state.kind is VariableKind.POSITION
    unit = {"m/s": "m/s^2", "rad/s": "rad/s^2"}.get(state.unit, f"{state.unit}/s")
    kind = VariableKind.POSITION_RATE if is_position else VariableKind.VELOCITY_RATE
    return Variable(name=f"der({state.name})", kind=kind, index=state.index, unit=unit, description=f"rate of {state.description}")


def _target(robot: Robot, actuator: int) -> tuple[str, str | None]:
    """What an actuator acts on, by name, and the unit of its length: None where that is not known."""
    model, kinds = robot.model, mujoco().mjtTrn
    kind, number = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
    if kind in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)):
        unit = {_SLIDE: "m"}.get(int(model.jnt_type[number]), "rad" if model.jnt_type[number] > _SLIDE else None)
        return joint_names(model)[number][1], unit
    if kind == int(kinds.mjTRN_TENDON):
        return model.tendon(number).name, None
    return "actuator", None


def _actuator_names(robot: Robot) -> list[tuple[str, str]]:
    model = robot.model
    return _named(model.nactuator, lambda number: model.actuator(number).name, lambda number: _target(robot, number)[0])


def _input_unit(robot: Robot, actuator: int) -> str:
    """Of an input that is a force, or what a servo is to come to; "1" where gears and gains make it anything."""
    package, model = mujoco(), robot.model
    _, length = _target(robot, actuator)
    plain = not model.actuator_actnum[actuator] and model.actuator_gaintype[actuator] == int(package.mjtGain.mjGAIN_FIXED)
    if length is None or not plain or list(model.actuator_gear[actuator]) != [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]:
        return "1"
    gain, bias = float(model.actuator_gainprm[actuator, 0]), model.actuator_biasprm[actuator]
    if model.actuator_biastype[actuator] == int(package.mjtBias.mjBIAS_NONE):
        return {"m": "N", "rad": "N m"}[length] if gain == 1.0 else "1"
    if model.actuator_biastype[actuator] != int(package.mjtBias.mjBIAS_AFFINE) or bias[0] != 0.0:
        return "1"
    return length if bias[1] == -gain else f"{length}/s" if bias[1] == 0.0 and bias[2] == -gain else "1"


def _inputs(robot: Robot) -> list[Variable]:
    model, package, found = robot.model, mujoco(), []
    for actuator, (name, said) in enumerate(_actuator_names(robot)):
        first, count = int(model.actuator_ctrladr[actuator]), int(model.actuator_ctrlnum[actuator])
        for part in range(count):
            at = first + part
            suffix = f"_{package.mj_actuatorInputName(model, actuator, part) or part}" if count > 1 else ""
            limited = bool(model.actuator_ctrllimited[at])
            lower, upper = (float(end) for end in model.actuator_ctrlrange[at]) if limited else (float("-inf"), float("inf"))
            found.append(
                Variable(
                    name=f"u_{name}{suffix}",
                    kind=VariableKind.INPUT,
                    index=at,
                    unit=_input_unit(robot, actuator) if count == 1 else "1",
                    lower=lower,
                    upper=upper,
                    start=float(robot.start.ctrl[at]),
                    description=f"control of actuator {said}{', cut at its range' if limited else ''}",
                )
            )
    return found


def _outputs(robot: Robot) -> list[Variable]:
    """Sensors; then forces, then gaps, of the contacts that were asked for."""
    model, package = robot.model, mujoco()
    names = _named(model.nsensor, lambda number: model.sensor(number).name, lambda number: f"sensor{number}")
    rows: list[tuple[str, str, str]] = []
    for sensor, (name, said) in enumerate(names):
        kind = package.mjtSensor(int(model.sensor_type[sensor])).name.removeprefix("mjSENS_")
        size, unit = int(model.sensor_dim[sensor]), _SENSOR_UNITS.get(kind, "1")
        if kind in ("JOINTPOS", "JOINTVEL"):
            length = "m" if model.jnt_type[int(model.sensor_objid[sensor])] == _SLIDE else "rad"
            unit = length if kind == "JOINTPOS" else f"{length}/s"
        rows += [(f"s_{name}{f'_{part}' * (size > 1)}", unit, f"sensor {said} ({kind.lower()})") for part in range(size)]
    sides = [" and ".join(contact.names) for contact in robot.contacts]
    rows += [
        (f"lam_{item.name}", "N", f"sum of the normal forces between {text}") for item, text in zip(robot.contacts, sides, strict=True)
    ]
    far = f"negative where they overlap, at most {FARTHEST:g} m"
    rows += [(f"gap_{item.name}", "m", f"smallest distance of {text}, {far}") for item, text in zip(robot.contacts, sides, strict=True)]
    return [
        Variable(name=name, kind=VariableKind.OUTPUT, index=number, unit=unit, description=text)
        for number, (name, unit, text) in enumerate(rows)
    ]


def _settings(robot: Robot) -> list[Variable]:
    """Parameters that may change between steps."""
    model = robot.model
    bodies = _named(model.nbody, lambda number: model.body(number).name, lambda number: "body")
    given = [
        *((f"gravity_{axis}", "m/s^2", float(value), f"gravity along {axis}", float("-inf")) for axis, value in zip(GRAVITY_AXES, model.opt.gravity, strict=True)),
        *((name, "1", 1.0, text, 0.0 if name == "friction_scale" else 1e-12) for name, text in SCALES),
        *((f"mass_{bodies[body][0]}", "kg", float(model.body_mass[body]), f"mass of body {bodies[body][1]}, with its inertia in proportion", 1e-12) for body in robot.masses),
    ]  # fmt: skip
    tunable = [
        Variable(name=name, kind=VariableKind.TUNABLE, index=number, unit=unit, start=value, lower=lower, description=text)
        for number, (name, unit, value, text, lower) in enumerate(given)
    ]
    step = "longest time step; equal steps divide each communication step"
    methods = "method of the time step"
    return [
        *tunable,
        Variable(name="timestep", kind=VariableKind.INTERNAL_STEP, unit="s", start=float(model.opt.timestep), lower=SMALLEST_INTERNAL_STEP, description=step),
        Variable(name="integrator", kind=VariableKind.INTEGRATOR, unit="", start=1.0 + model.opt.integrator, lower=1.0, upper=float(len(INTEGRATORS)), description=methods),
    ]  # fmt: skip


def _velocity_of(robot: Robot) -> list[tuple[Variable, str, str]]:
    """Of each position: its variable, the variable of its rate, the column of that in a plan."""
    velocities = {variable.name for variable in robot.table if variable.kind is VariableKind.VELOCITY}
    found = []
    for variable in robot.table:
        if variable.kind is VariableKind.POSITION:
            column = f"v_{variable.name.removeprefix('q_')}"
            found.append((variable, column if column in velocities else f"der({variable.name})", column))
    return found


def _map(robot: Robot) -> str:
    kinds = {kind: [variable for variable in robot.table if variable.kind is kind] for kind in VariableKind}
    lines = [
        f"# {robot.path.name} as an FMU: how the columns of a plan are its variables. docs/replay.md tells all that may stand here.",
        'internal_step = "timestep"',
        "",
        "[inputs]",
        *(f'{variable.name} = "{variable.name}"' for variable in kinds[VariableKind.INPUT]),
        "",
        "[positions]",
        *(f'{variable.name} = "{variable.name}"' for variable in kinds[VariableKind.POSITION]),
        "",
        "[velocities]",
        *(f'{of.name} = {{ variable = "{rate}", column = "{column}" }}' for of, rate, column in _velocity_of(robot)),
    ]
    for contact in robot.contacts:
        lines += ["", f"[contacts.{contact.name}]", f'force = "lam_{contact.name}"', f'gap = "gap_{contact.name}"']
    turning = [variable.name for variable in kinds[VariableKind.VELOCITY] if variable.name.endswith(_TURNS)]
    if turning:
        lines += [
            "",
            "[start]",
            "# The angular velocities at the start, which the plan has in columns of their own, or numbers; without these lines they are zero.",
        ]
        lines += [f'{name} = "{name}"' for name in turning]
    return "\n".join(lines) + "\n"


class Recorder:
    """A simulation with MuJoCo itself, recorded as a plan for the map that the FMU has: `record` before each `mj_step` and after the last.

    model: MjModel of the package `mujoco`.
    """

    def __init__(self, model: Any) -> None:
        self._package = mujoco()
        robot = Robot(path=Path("robot"), model=model, start=self._package.MjData(model), keyframe=-1, contacts=())
        kinds = {kind: [variable for variable in robot.table if variable.kind is kind] for kind in VariableKind}
        self._turns = [(variable.name, variable.index) for variable in kinds[VariableKind.VELOCITY] if variable.name.endswith(_TURNS)]
        self._quaternions = [variable.index for variable in kinds[VariableKind.POSITION] if variable.name.endswith("_qw")]
        inputs, positions = ([variable.name for variable in kinds[kind]] for kind in (VariableKind.INPUT, VariableKind.POSITION))
        self.columns = ["t", *inputs, *positions, *(column for _, _, column in _velocity_of(robot)), *(name for name, _ in self._turns)]
        self._of_velocity = {variable.name: variable.index for variable in kinds[VariableKind.VELOCITY]}
        self._rates = [column for _, _, column in _velocity_of(robot)]
        self.rows: list[list[float]] = []

    def record(self, data: Any) -> None:
        """Keep time [s], controls, positions and velocities of an MjData."""
        rates = {}
        for at, (_, turn) in zip(self._quaternions, self._turns[::3], strict=True):
            rate = np.zeros(4)
            self._package.mju_mulQuatAxis(rate, data.qpos[at : at + 4], data.qvel[turn : turn + 3])  # dq/dt = q (0, w) / 2
            rates |= {at + part: value / 2.0 for part, value in enumerate(rate)}
        velocities = [rates[at] if at in rates else data.qvel[self._of_velocity[name]] for at, name in enumerate(self._rates)]
        turns = [data.qvel[at] for _, at in self._turns]
        self.rows.append([float(value) for value in (data.time, *data.ctrl, *data.qpos, *velocities, *turns)])

    def write(self, path: Path | str) -> None:
        """As a CSV, each number so that it reads back bit for bit."""
        lines = [",".join(self.columns), *(",".join(map(repr, row)) for row in self.rows)]
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def unknowns_of(table: Iterable[Variable], kinds: Iterable[VariableKind]) -> list[int]:
    """Places in the table of the variables of these kinds."""
    wanted = set(kinds)
    return [place for place, variable in enumerate(table) if variable.kind in wanted]

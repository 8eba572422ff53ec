"""Builds somebody else's FMU for the tests from foreign_cart.c: well-behaved, or going wrong in one of twenty-nine ways."""

import os
import subprocess
import zipfile
from pathlib import Path

import numpy as np
from killed_campaigns import numbers_of

from models.codegen.compiler import find_compiler

MODES = {
    name: number
    for number, name in enumerate(
        [
            "good", "hang", "segfault", "exit", "abort", "nan", "garbage", "fork", "memory",
            "fatal", "chdir", "closes", "kills_parent",
            "kills_group", "overflow", "signals", "environment", "rounding", "trap", "stops",
            "alarm", "daemon", "fills", "leaves_at_once",
            "killed", "descriptors", "file", "thread", "mask", "shell",
        ]
    )
}  # fmt: skip
DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="foreign" guid="{{cart}}" numberOfEventIndicators="1">
  {kinds}
  <ModelVariables>
    <ScalarVariable name="body.pos" valueReference="10" causality="output" variability="continuous" initial="exact"><Real unit="mm" start="0"/></ScalarVariable>
    <ScalarVariable name="body.vel" valueReference="11" causality="output" variability="continuous" initial="exact"><Real unit="mm/s" start="0"/></ScalarVariable>
    <ScalarVariable name="der(body.pos)" valueReference="12"><Real unit="mm/s" derivative="1"/></ScalarVariable>
    <ScalarVariable name="der(body.vel)" valueReference="13"><Real unit="mm/s2" derivative="2"/></ScalarVariable>
    <ScalarVariable name="drive.force" valueReference="20" causality="input" variability="continuous"><Real unit="kN" start="0" min="-1" max="1"/></ScalarVariable>
    <ScalarVariable name="stop.push" valueReference="30" causality="output" variability="continuous"><Real unit="N"/></ScalarVariable>
    <ScalarVariable name="stop.gap" valueReference="31" causality="output" variability="continuous"><Real unit="mm"/></ScalarVariable>
    <ScalarVariable name="body.mass" valueReference="40" causality="parameter" variability="fixed" initial="exact"><Real unit="kg" start="2" min="0"/></ScalarVariable>
    <ScalarVariable name="label" valueReference="1" causality="local" variability="constant"><String start="cart"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="1"/><Unknown index="2"/><Unknown index="6"/><Unknown index="7"/></Outputs>
    <Derivatives><Unknown index="3"/><Unknown index="4"/></Derivatives>
  </ModelStructure>
</fmiModelDescription>
"""
EXCHANGE = '<ModelExchange modelIdentifier="cart" completedIntegratorStepNotNeeded="true"/>'
COSIMULATION = (
    '<CoSimulation modelIdentifier="cart" canHandleVariableCommunicationStepSize="true"/>'
)
FULL_MAP = """
[inputs]
F = { variable = "drive.force", scale = 0.001, unit = "N" }
[positions]
x = { variable = "body.pos", scale = 0.001, unit = "m" }
[velocities]
x = { variable = "body.vel", scale = 0.001, unit = "m/s" }
[contacts.stop]
force = "stop.push"
gap = { variable = "stop.gap", scale = 0.001, unit = "m" }
[start]
"body.pos" = 300
"body.vel" = 2000
[goal]
x = 0.2
[limits]
replay_error = { value = 1e-2, reason = "a centimetre" }
ghost_impulse = 0.1
replay_terminal_position_error = { value = 1.0, reason = "anywhere near" }
"""
MASS = 2.0
STIFFNESS = 1000.0
STOP = 0.5


def left(place: Path) -> list[str]:
    """What is still there of children that were given this folder for temporary files, and TEST_MARK with its name: files, and numbers of processes."""
    numbers = set(numbers_of(f"TEST_MARK={place}\0".encode())) - {os.getpid()}
    return [str(path) for path in place.iterdir()] + [str(number) for number in numbers]


def compile_cart(folder: Path, mode: str = "good", defines: tuple[str, ...] = ()) -> bytes:
    library = folder / f"{mode}.so"
    compiler = find_compiler()
    source = Path(__file__).with_name("foreign_cart.c")
    command = [*compiler.command, "-O1", "-w", "-shared", "-fPIC", f"-DMISBEHAVE={MODES[mode]}"]
    command += [*(f"-D{define}" for define in defines), "-o", str(library), str(source), "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    return library.read_bytes()


def build_foreign(
    path: Path,
    mode: str = "good",
    kinds: str = EXCHANGE + COSIMULATION,
    defines: tuple[str, ...] = (),
) -> Path:
    """A foreign FMU at `path`.

    Its library is compiled beside it, with these macros defined (foreign_cart.c).
    """
    library = compile_cart(path.parent, mode, defines)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION.format(kinds=kinds))
        archive.writestr("binaries/linux64/cart.so", library)
    return path


def foreign_plan(steps: int = 40, step: float = 0.01) -> np.ndarray:
    """(steps + 1, 5) t, x, v_x, F, lam_stop: thrown at the stop with 2 m/s from 0.3 m, under a constant 4 N; contact by the closed form."""
    force, omega = 4.0, np.sqrt(STIFFNESS / MASS)
    a, sag = force / MASS, force / STIFFNESS
    speed = np.sqrt(4.0 + 2 * a * (STOP - 0.3))
    meets = (speed - 2.0) / a
    swing = np.hypot(sag, speed / omega)
    phase = np.arctan2(sag, speed / omega)
    leaves = meets + (np.pi + 2 * phase) / omega
    rows = []
    for t in step * np.arange(steps + 1):
        if t < meets:
            x, v, lam = 0.3 + 2 * t + a * t * t / 2, 2 + a * t, 0.0
        elif t < leaves:
            angle = omega * (t - meets) - phase
            x, v = STOP + sag + swing * np.sin(angle), swing * omega * np.cos(angle)
            lam = STIFFNESS * (x - STOP)
        else:
            x, v, lam = (
                STOP - speed * (t - leaves) + a * (t - leaves) ** 2 / 2,
                -speed + a * (t - leaves),
                0.0,
            )
        rows.append([t, x, v, force, lam])
    return np.array(rows)


def write_plan(
    path: Path, columns: str = "t,x,v_x,F,lam_stop", plan: np.ndarray | None = None
) -> Path:
    plan = foreign_plan() if plan is None else plan
    order = ["t", "x", "v_x", "F", "lam_stop"]
    chosen = plan[:, [order.index(name) for name in columns.split(",")]]
    lines = [",".join(repr(float(value)) for value in row) for row in chosen]
    path.write_text("\n".join([columns, *lines]) + "\n", encoding="utf-8")
    return path

"""Other people's tools on the FMUs of every scene: no complaint, and our numbers.

Each runs in a child process, because some of them crash.

They come with `pip install -e '.[fmu-check]'`; without them these tests are skipped. With `pytest
-s` the largest difference of each scene and tool is printed as a table.
"""

import importlib.util
import json
import re
import subprocess
import sys
import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from models.catalog import load_scene, scene_names
from models.fmu import build_fmu
from validate.processes.isolated import Limits, run_isolated
from validate.truth.exact_motion import Equations, Piece, _leaving, true_motion

pytestmark = pytest.mark.peer

_BESIDE = sorted((Path(__file__).parents[2] / "scenes").glob("*.py"))
SCENES = [*scene_names(), *map(str, _BESIDE)]
VERSIONS = ("2.0", "3.0")
# What other tools' numbers may differ from ours, in SI units; of numbers above 1, as a share: a
# finger turns at 145 rad/s.
AGREE = 1e-6
STEPS = 100
# CasADi: simulated seconds at most, and until a contact must close; how far short of the first
# event it ends (as a share), and how far beyond it goes to be past it [s].
LONGEST = 0.5
LATEST = 2.0
CLEAR = 0.9
PAST = 1e-9

DAE = """
import json, sys
import casadi as ca
import numpy as np
folder, end, u = sys.argv[1], float(sys.argv[2]), json.loads(sys.argv[3])
dae = ca.DaeBuilder("model", folder)
n, m = len(dae.x()), len(dae.u())
f = dae.create("f", ["x", "u"] if m else ["x"], ["ode"])
x, p = ca.MX.sym("x", n), ca.MX.sym("p", m)
flow = ca.integrator("flow", "cvodes", {"x": x, "p": p, "ode": f(x, p) if m else f(x)}, 0, end, {"reltol": 1e-11, "abstol": 1e-12})
start = np.array(dae.start(dae.x())).ravel()
adjoint = f.factory("adjoint", [*f.name_in(), "adj:ode"], ["adj:x"])
jacobian = f.factory("jacobian", f.name_in(), ["jac:ode:x"])
point, w = ([start, u] if m else [start]), np.arange(1.0, n + 1)
print("RESULT", json.dumps({
    "x": np.array(flow(x0=start, p=u)["xf"]).ravel().tolist(),
    "backward": np.array(adjoint(*point, w)).ravel().tolist(),
    "forward": (np.array(jacobian(*point)).T @ w).tolist(),
}))
"""


def held(scene, first, last, share):
    """Constant inputs from `first` to `last`, each at most this share of its bound."""
    bound = share * np.array([item.upper for item in scene.inputs])
    return np.clip(np.linspace(first, last, scene.nu), -bound, bound)


def needs(*modules):
    for module in modules:
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed; it comes with the extra [fmu-check]")


def child(code, *arguments):
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(
        next(line for line in done.stdout.splitlines() if line.startswith("RESULT")).removeprefix(
            "RESULT"
        )
    )


def asked(importer, **job):
    """Return the answer of an importer that runs in a child process."""
    done = run_isolated(
        "tests.models.fmu.importers:run_importer",
        {"importer": importer, **job},
        limits=Limits(seconds=60.0, memory=2**32),
    )
    assert done.ok, done.sentence
    return done.value["values"]


@pytest.fixture(params=SCENES, ids=lambda name: Path(name).stem, scope="module")
def scene(request):
    return load_scene(
        request.param
    ).continuous()  # as its FMU has it: a quasi-static scene's relaxation time is its grid's before


@pytest.fixture(scope="module")
def agree():
    """agree(scene, tool, got, want) fails beyond AGREE.

    What was found is printed as a table at the end.
    """
    found = {}

    def compare(scene, tool, got, want):
        assert len(got) == len(want) > 0
        difference = float(
            (np.abs(np.asarray(got) - np.asarray(want)) / np.maximum(np.abs(want), 1.0)).max()
        )
        found[scene.name, tool] = difference
        assert difference <= AGREE, (scene.name, tool, got, want)

    yield compare
    tools = sorted({tool for _, tool in found})
    print(
        "\nlargest difference from ours (SI; above 1 relative)\n"
        + " ".join(f"{title:>20}" for title in ("scene", *tools))
    )
    for name in dict.fromkeys(name for name, _ in found):
        cells = (f"{found[name, tool]:.1e}" if (name, tool) in found else "-" for tool in tools)
        print(" ".join(f"{cell:>20}" for cell in (name, *cells)))


@pytest.mark.slow
def test_checkers_find_no_problem(scene):
    """FMPy's validation and fmutool's, FMI 2.0 and 3.0."""
    needs("fmu_manipulation_toolbox")
    for version in VERSIONS:
        path = build_fmu(scene, version)
        assert validate_fmu(str(path)) == []
        assert asked("fmutool", path=str(path), fmi=version) == []


@pytest.mark.parametrize(
    ("tool", "version"), [("fmuloader", "2.0"), ("fmuloader", "3.0"), ("libcosimpy", "2.0")]
)
def test_other_importers_get_our_numbers(scene, drive, agree, tool, version):
    """1 s of Co-Simulation, or the scene's horizon, in 100 steps with constant inputs, through contact where the scene has one on the way.

    The steps are told to the last bit: the fingers of `two_finger` make an error of rounding as
    large as themselves within that second.
    """
    needs(tool)
    u, end = held(scene, 8.0, -5.0, 0.8), min(1.0, scene.task.horizon)
    ours = drive(scene, "cs", version).initialise(u=u).run(end, STEPS)
    points = [end * n / STEPS for n in range(STEPS + 1)]
    steps = [(begin, after - begin) for begin, after in pairwise(points)]
    outputs = (
        *ours.names.q,
        *ours.names.v,
        *ours.names.lam,
        *ours.names.gap,
        ours.names.kinetic_energy,
    )
    token = ours.description.guid if version == "2.0" else ours.description.instantiationToken
    inputs = [
        ["u", reference, float(value)]
        for reference, value in zip(ours.vr(ours.names.u), u, strict=True)
    ]
    fmu = {
        "path": str(build_fmu(scene, version)),
        "identifier": scene.name,
        "token": token,
        "fmi": version,
    }
    got = asked(tool, **fmu, references=ours.vr(outputs), inputs=inputs, steps=steps)
    agree(scene, f"{tool}, FMI {version}", got, ours.get(*outputs))


def modes(equations, x, u):
    """What is closed, what slips and how, at x, as numbers."""
    return [np.asarray(part).tolist() for part in vars(equations.modes(x, u)).values()]


def first_change(scene, u, latest):
    """(equations, end, after): end [s] lies before the first change of a contact or a friction, `after` just after it; None if there is none by `latest`."""
    equations, x = Equations(scene), np.array(scene.task.start, dtype=float)
    stay = equations.modes(x, u)
    found = solve_ivp(
        lambda _, y: equations.rate(y, u, stay), (0, latest), x, "DOP853", rtol=1e-12, atol=1e-13,
        max_step=0.02,
        events=_leaving(equations, stay, u),
    )  # fmt: skip
    assert found.success
    return (
        (equations, CLEAR * found.t[-1], found.t[-1] + PAST)
        if found.status == 1
        else (equations, latest, None)
    )


def by_casadi(folder, end, u):
    return child(DAE, folder, end, json.dumps(u.tolist()))


@pytest.mark.parametrize("version", VERSIONS)
def test_casadi_integrates_and_differentiates_the_model_exchange(scene, unpacked, agree, version):
    """CVODES on DaeBuilder's function until before the first event.

    J' w forwards, and (FMI 3.0) by our own adjoint.
    """
    needs("casadi")
    u = held(scene, 2.0, -1.0, 0.2)
    equations, end, _ = first_change(scene, u, LONGEST)
    got = by_casadi(unpacked(scene, version), end, u)
    agree(
        scene,
        f"casadi, FMI {version}",
        got["x"],
        true_motion(equations, [Piece(end, u)], np.array([end]))[0],
    )
    np.testing.assert_allclose(got["backward"], got["forward"], rtol=1e-12, atol=1e-12)


def test_casadi_goes_through_contact(scene, unpacked, agree):
    """CasADi 3.8 imports event indicators, but never takes an imported FMU to Event Mode, where contacts close. So the event is made by hand: CasADi
    goes on to just after it (its force is missed for PAST s), and an FMU that starts in the state
    CasADi reached goes on.

    Not for friction: what has come to rest sticks only if it starts at rest exactly.
    """
    needs("casadi")
    u = held(scene, 2.0, -1.0, 0.2)
    equations, _, after = first_change(scene, u, LATEST)
    if after is None or scene.nf or not scene.nc:
        pytest.skip(
            "friction sticks in Event Mode only"
            if scene.nf
            else f"no contact closes within {LATEST} s"
        )
    reached = by_casadi(unpacked(scene), after, u)["x"]
    inside = scene.with_task(start=tuple(reached))
    _, end, _ = first_change(inside, u, min(LONGEST, scene.task.horizon / 4))
    assert modes(equations, np.array(reached), u) != modes(
        equations, np.array(scene.task.start, dtype=float), u
    )
    got = by_casadi(unpacked(inside), end, u)["x"]
    agree(
        scene,
        "casadi, in contact",
        got,
        true_motion(equations, [Piece(after + end, u)], np.array([after + end]))[0],
    )


@pytest.mark.parametrize("version", VERSIONS)
def test_a_robot_of_mujoco_moves_in_their_hands_as_in_mujoco(version: str, tmp_path: Path):
    needs("mujoco", "fmuloader", "libcosimpy", "fmu_manipulation_toolbox", "xmlschema")
    import mujoco

    mjcf = pytest.importorskip("models.fmu.mjcf")

    path = tmp_path / "ball.xml"
    path.write_text(
        """<mujoco><worldbody><geom type="plane" size="5 5 .1"/><body pos="0 0 .2"><freejoint name="ball"/><geom size=".1"/>
        <body><joint name="arm" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 .1" size=".03"/></body></body></worldbody>
        <actuator><motor name="arm" joint="arm" ctrlrange="-2 2"/></actuator></mujoco>"""
    )
    robot, steps = mjcf.read_robot(path), [(0.002 * step, 0.002) for step in range(200)]
    fmu, data = mjcf.build_robot(robot, version), mujoco.MjData(robot.model)
    data.ctrl[:] = 0.5
    mujoco.mj_step(robot.model, data, len(steps))
    assert data.ncon > 0
    places = {variable.name: place for place, variable in enumerate(robot.table)}
    states = [place for name, place in places.items() if name.startswith(("q_", "v_"))]
    token = re.search(r'(?:guid|instantiationToken)="(\w+)"', _description(fmu))
    assert token is not None
    given = {
        "path": str(fmu),
        "identifier": robot.identifier,
        "token": token[1],
        "fmi": version,
        "references": states,
        "steps": steps,
    }
    for tool in (
        ("fmuloader", "libcosimpy") if version == "2.0" else ("fmuloader",)
    ):  # libcosim reads FMI 2.0 alone
        assert asked(tool, **given, inputs=[["u_arm", places["u_arm"], 0.5]]) == [
            *data.qpos.tolist(),
            *data.qvel.tolist(),
        ]
    assert asked("fmutool", path=str(fmu), fmi=version) == []


def _description(fmu: Path) -> str:
    with zipfile.ZipFile(fmu) as archive:
        return archive.read("modelDescription.xml").decode()

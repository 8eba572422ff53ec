"""Other people's tools on our FMUs: no complaint, and our numbers. Each runs in a child process, because some of them crash.

They come with `pip install 'touchstone-contact[fmu-check]'`; without them these tests are skipped.
"""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from models.fmu import build_fmu, variable_names
from models.fmu.reference import Equations, Piece, true_motion

versions = pytest.mark.parametrize("version", ["2.0", "3.0"])

LOADER = """
import json, sys
path, identifier, token, names, inputs = sys.argv[1], sys.argv[2], sys.argv[3], json.loads(sys.argv[4]), json.loads(sys.argv[5])
if sys.argv[6] == "2.0":
    from fmuloader.fmi2 import Fmi2Slave as Slave, Fmi2Type
    fmu = Slave(path, model_identifier=identifier)
    fmu.instantiate("it", Fmi2Type.CO_SIMULATION, guid=token)
    fmu.setup_experiment(0.0)
    fmu.enter_initialization_mode()
    get, put = fmu.get_real, fmu.set_real
else:
    from fmuloader.fmi3 import Fmi3Slave as Slave
    fmu = Slave(path, model_identifier=identifier)
    fmu.instantiate_co_simulation("it", instantiation_token=token)
    fmu.enter_initialization_mode(start_time=0.0)
    get, put = fmu.get_float64, fmu.set_float64
if inputs:
    put([row[0] for row in inputs], [row[1] for row in inputs])
fmu.exit_initialization_mode()
for n in range(100):
    fmu.do_step(n * 0.01, 0.01)
print("RESULT", json.dumps(get(names)))
fmu.terminate()
fmu.free_instance()
"""

MASTER = """
import json, sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
path, names, inputs = sys.argv[1], json.loads(sys.argv[4]), json.loads(sys.argv[5])
execution = CosimExecution.from_step_size(10_000_000)
index = execution.add_local_slave(CosimLocalSlave(fmu_path=path, instance_name="it"))
for reference, value in inputs:
    execution.real_initial_value(index, reference, value)
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
execution.simulate_until(1_000_000_000)
print("RESULT", json.dumps(list(observer.last_real_values(index, names))))
"""

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


def needs(*modules):
    for module in modules:
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed; it comes with the extra [fmu-check]")


def child(code, *arguments, **options):
    done = subprocess.run([sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(next(line for line in done.stdout.splitlines() if line.startswith("RESULT")).removeprefix("RESULT"))


@versions
def test_fmutool_finds_no_problem(any_scene, version):
    needs("fmu_manipulation_toolbox")
    tool = Path(sys.executable).with_name("fmutool")
    done = subprocess.run([tool, "-input", build_fmu(any_scene, version), "-check"], capture_output=True, text=True, check=False)
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert f"compliant with FMI-{version}" in said
    assert "No semantic error" in said
    assert "WARNING" not in said


@pytest.mark.parametrize(("tool", "version"), [("fmuloader", "2.0"), ("fmuloader", "3.0"), ("libcosimpy", "2.0")])
def test_other_importers_get_our_numbers(any_scene, drive, tool, version):
    """1 s of Co-Simulation in 100 steps with constant inputs, through contact where the scene has one on the way."""
    needs(tool)
    u = np.linspace(8.0, -5.0, any_scene.nu)
    ours = drive(any_scene, "cs", version).initialise(u=u).run(1.0, 100)
    outputs = (*ours.names.q, *ours.names.v, *ours.names.lam, *ours.names.gap, ours.names.kinetic_energy)
    token = ours.description.guid if version == "2.0" else ours.description.instantiationToken
    inputs = [[reference, value] for reference, value in zip(ours.vr(ours.names.u), u, strict=True)]
    code = LOADER if tool == "fmuloader" else MASTER
    got = child(code, build_fmu(any_scene, version), any_scene.name, token, json.dumps(ours.vr(outputs)), json.dumps(inputs), version)
    np.testing.assert_allclose(got, ours.get(*outputs), rtol=0, atol=1e-6)


@versions
def test_casadi_integrates_and_differentiates_the_model_exchange(any_scene, unpacked, version):
    """CVODES on DaeBuilder's function until before the first contact; J' w forwards, and (FMI 3.0) by our own adjoint."""
    needs("casadi")
    end, u = {"two_body_collision": 0.1, "bouncing_mass": 0.2}.get(any_scene.name, 0.25), np.linspace(2.0, -1.0, any_scene.nu)
    got = child(DAE, unpacked(any_scene, version), end, json.dumps(u.tolist()))
    want = true_motion(Equations(any_scene), [Piece(end, u)], np.array([end]))[0]
    np.testing.assert_allclose(got["x"], want, rtol=0, atol=1e-6)
    np.testing.assert_allclose(got["backward"], got["forward"], rtol=1e-12, atol=1e-12)
    assert len(variable_names(any_scene).q) * 2 == len(want)

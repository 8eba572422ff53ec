"""The FMUs of a split scene, stepped by the plainest master, on a head-on impact whose motion is known."""

import json
import math
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

from models.catalog import load_scene
from models.fmu.coupled import build_part, build_ssp, split
from models.scene import Scene

STIFFNESS = 1e4
RADIUS = 0.1
HORIZON = 0.1


def head_on() -> Scene:
    """Two masses of 1 kg; the left one meets the right one, at rest, with 2 m/s."""
    scene = load_scene("two_body_collision").with_task(start=(0.0, 0.2731, 2.0, 0.0))
    return scene.with_parameters(m1=1.0, m2=1.0, k=STIFFNESS, r=RADIUS)


def jacobi(scene: Scene, h: float, steps: int, folder: Path) -> np.ndarray:
    """(steps + 1, 2 nq) motion: in each step all parts advance with the outputs of the step before."""
    parts = split(scene)
    sources = {part.name: part for part in (*parts.bodies, *parts.contacts)}
    fmus, references = {}, {}
    for name, part in sources.items():
        place = fmpy.extract(str(build_part(part)), str(folder / name))
        description = fmpy.read_model_description(place)
        references[name] = {item.name: item.valueReference for item in description.modelVariables}
        fmus[name] = FMU2Slave(
            guid=description.guid,
            unzipDirectory=place,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        fmus[name].instantiate()
        fmus[name].setupExperiment(startTime=0.0)
        fmus[name].enterInitializationMode()
        fmus[name].exitInitializationMode()

    def read(name: str, variable: str) -> float:
        return fmus[name].getReal([references[name][variable]])[0]

    def state() -> list[float]:
        home = {item.name: body.name for body in parts.bodies for item in body.coordinates}
        items = scene.coordinates
        return [read(home[item.name], item.name) for item in items] + [
            read(home[item.name], item.velocity_name) for item in items
        ]

    motion = [state()]
    for number in range(steps):
        outputs = [read(item.source, item.output) for item in parts.connections]
        for item, value in zip(parts.connections, outputs, strict=True):
            fmus[item.target].setReal([references[item.target][item.input]], [value])
        for fmu in fmus.values():
            fmu.doStep(currentCommunicationPoint=number * h, communicationStepSize=h)
        motion.append(state())
    for fmu in fmus.values():
        fmu.terminate()
        fmu.freeInstance()
    return np.array(motion)


def test_coupled_impact_same_as_its_recursion(tmp_path: Path):
    """Free masses under a force that is constant within a step: v += a h, q += v h + a h^2/2."""
    scene, h = head_on(), 1e-3
    motion = jacobi(scene, h, round(HORIZON / h), tmp_path)
    q, v = motion[0, :2], motion[0, 2:]
    before = 0.0
    for row in motion[1:]:
        a = before * np.array([-1.0, 1.0])
        before = STIFFNESS * max(2 * RADIUS - (q[1] - q[0]), 0.0)
        q, v = q + v * h + a * h**2 / 2, v + a * h
        np.testing.assert_allclose(row, [*q, *v], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(("h", "share"), [(2e-4, 0.04), (1e-4, 0.02)])
def test_coupled_impact_gains_the_predicted_energy(h: float, share: float, tmp_path: Path):
    """A force 1.5 h late multiplies the energy of the relative motion, which is half of all, by exp(1.5 pi omega h).

    Momentum shows nothing of it.
    """
    motion = jacobi(head_on(), h, round(HORIZON / h), tmp_path)
    energy = (motion[-1, 2:] ** 2).sum() / 2.0
    predicted = (math.exp(1.5 * math.pi * math.sqrt(2 * STIFFNESS) * h) - 1.0) / 2.0
    assert energy / 2.0 - 1.0 == pytest.approx(predicted, rel=share)
    assert motion[:, 2:].sum(axis=1) == pytest.approx(2.0, abs=1e-13)


SSP = """
import json, sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
execution, observer = CosimExecution.from_ssp_file(sys.argv[1], 1_000_000), CosimObserver.create_last_value()
execution.add_observer(observer)
execution.simulate_until(600_000_000)
bodies = [execution.slave_index_from_instance_name(name) for name in sys.argv[2:]]
print("RESULT", json.dumps([list(observer.last_real_values(body, [1, 2])) for body in bodies]))
"""


@pytest.mark.peer
def test_libcosim_runs_our_ssp(tmp_path: Path):
    """What a user does with the file: unpack it, open PartsOnly.ssd, step."""
    pytest.importorskip("libcosimpy")
    scene = load_scene("two_body_collision")
    with zipfile.ZipFile(build_ssp(scene)) as archive:
        archive.extractall(tmp_path)
    names = ["two_body_collision_q1", "two_body_collision_q2"]
    command = [sys.executable, "-c", SSP, str(tmp_path / "PartsOnly.ssd"), *names]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    line = next(line for line in done.stdout.splitlines() if line.startswith("RESULT"))
    last = jacobi(scene, 1e-3, 600, tmp_path / "parts")[-1]
    np.testing.assert_allclose(np.array(json.loads(line[6:])).T.ravel(), last, rtol=1e-8)

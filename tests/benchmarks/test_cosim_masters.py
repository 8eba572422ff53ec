"""Masters on the head-on impact, whose motion is known: two masses exchange their velocities, and no energy is lost."""

import json
import math
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from benchmarks.cosim import study as studies
from benchmarks.cosim.libcosim import FIXED, libcosim_refusal, run_libcosim
from benchmarks.cosim.masters import MASTERS, jacobi
from benchmarks.cosim.study import cases, contact_frequency, energy, exact_motion, momentum, study
from benchmarks.cosim.system import coupled, whole
from models.catalog import load_scene
from models.fmu.coupled import build_ssp

START = np.array([0.0, 0.2731, 2.0, 0.0])
HORIZON = 0.1
HEAD_ON = next(case for case in cases() if case.name == "head_on")
OMEGA = math.sqrt(2e4)


@pytest.fixture(scope="module")
def run():
    """(master, h) -> (steps + 1, 4) motion of the impact; each is made once."""
    made = {}

    def motion(name, h):
        if (name, h) not in made:
            make = whole if name == "whole" else coupled
            with make(HEAD_ON.scene, h / 10) as system:
                system.begin(START, np.empty(0))
                made[name, h] = MASTERS.get(name, jacobi)(system, h, round(HORIZON / h))
        return made[name, h]

    return motion


@pytest.fixture(scope="module")
def energy_error(run):
    total = energy(HEAD_ON.scene)
    return lambda name, h: float(total(run(name, h)[-1:])[0]) / 2.0 - 1.0


@pytest.mark.slow
def test_the_reference_is_the_closed_form():
    after = exact_motion(HEAD_ON.scene, START, (), np.array([0.01, HORIZON]))[-1]
    touch = (START[1] - 0.2) / 2.0
    duration = math.pi / OMEGA
    # The centre of mass goes on at 1 m/s; the relative velocity turns round after half a period.
    left = 2.0 * touch + 1.0 * duration
    right = START[1] + 1.0 * duration + 2.0 * (HORIZON - touch - duration)
    np.testing.assert_allclose(after, [left, right, 0.0, 2.0], rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "late"), [("jacobi", 1.5), ("contact_first", 0.5)])
def test_a_late_force_adds_energy_as_predicted(energy_error, name, late):
    """tau late for half a period: the relative motion, which has half of the energy, is multiplied by exp(pi omega tau)."""
    for h, share in ((2e-4, 0.04), (1e-4, 0.02), (5e-5, 0.01)):
        predicted = (math.exp(math.pi * OMEGA * late * h) - 1.0) / 2.0
        assert energy_error(name, h) == pytest.approx(predicted, rel=share)


@pytest.mark.parametrize(
    ("name", "h", "known", "share"),
    [
        ("jacobi", 1e-3, 0.47, 0.02),
        ("contact_first", 1e-3, 0.13, 0.06),
        ("jacobi", 1e-4, 0.035, 0.03),
    ],
)
def test_errors_are_those_measured_elsewhere(energy_error, name, h, known, share):
    """Relative energy errors of the same impact with other FMUs, printed to two digits.

    Where in a step the masses meet moves the second.
    """
    assert energy_error(name, h) == pytest.approx(known, rel=share)


@pytest.mark.slow
def test_orders_of_convergence(energy_error):
    """Slopes over a decade: 1 with forces held, 2 with forces that are lines - and nothing to converge inside one FMU."""
    for name, order in (("jacobi", 1.0), ("contact_first", 1.0)):
        slope = math.log10(energy_error(name, 5e-4) / energy_error(name, 5e-5))
        assert slope == pytest.approx(order, abs=0.15)
    for name in ("extrapolated", "iterated"):
        assert max(abs(energy_error(name, h)) / h**2 for h in (1e-3, 5e-4, 2e-4, 1e-4)) < 5e3
        assert abs(energy_error(name, 1e-4)) < 1e-2 * abs(energy_error("contact_first", 1e-4))
    assert abs(energy_error("whole", 1e-3)) < 1e-9


@pytest.mark.parametrize("name", [*MASTERS, "whole"])
def test_momentum_shows_nothing(run, name):
    motion = run(name, 1e-3)
    assert np.abs(momentum(HEAD_ON.scene)(motion) - 2.0).max() < 1e-13


@pytest.mark.parametrize(("name", "late"), [("jacobi", 1), ("contact_first", 0)])
def test_against_the_same_master_without_fmus(run, name, late):
    """Free masses under a force that is constant within a step move exactly as v += a h, q += v h + a h^2/2."""
    h, k, q, v = 1e-3, 1e4, START[:2].copy(), START[2:].copy()
    forces = [0.0]
    for n in range(round(HORIZON / h)):
        forces.append(k * max(0.2 - (q[1] - q[0]), 0.0))
        a = forces[n + 1 - late] * np.array([-1.0, 1.0])
        q, v = q + v * h + a * h**2 / 2, v + a * h
        np.testing.assert_allclose(run(name, h)[n + 1], [*q, *v], rtol=1e-10, atol=1e-12)


def test_iterated_equals_the_implicit_step_without_fmus(run):
    """With the force a line from lam_n to lam_(n+1): v += (a_n + a_(n+1)) h/2, q += v h + (2 a_n + a_(n+1)) h^2/6."""
    h, k, q, v = 1e-3, 1e4, START[:2].copy(), START[2:].copy()
    way = np.array([-1.0, 1.0])

    def force(q):
        return k * max(0.2 - (q[1] - q[0]), 0.0)

    for n in range(round(HORIZON / h)):
        here = there = force(q)
        for _ in range(200):
            new = q + v * h + way * (2 * here + there) * h**2 / 6
            there = force(new)
        q, v = new, v + way * (here + there) * h / 2
        np.testing.assert_allclose(run("iterated", h)[n + 1], [*q, *v], rtol=1e-7, atol=1e-8)


def test_frequencies():
    found = {case.name: contact_frequency(case.scene) for case in cases()}
    assert found["head_on"] == pytest.approx(OMEGA)
    assert found["three_cart"] == pytest.approx(math.sqrt(3 * 30.0))
    assert found["three_cart_stiff"] == pytest.approx(math.sqrt(3 * 1e4))


@pytest.mark.peer
def test_libcosim_steps_as_our_jacobi(run):
    if (refusal := libcosim_refusal()) is not None:
        pytest.skip(refusal)
    h = 1e-3
    told = run_libcosim(
        HEAD_ON.scene, START, np.empty(0), h, np.array([0.05, HORIZON]), h / 10, FIXED
    )
    assert not isinstance(told, str), told
    np.testing.assert_allclose(told[1], run("jacobi", h)[[50, 100]], rtol=1e-12, atol=1e-12)


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
def test_libcosim_runs_our_ssp(tmp_path):
    """What a user does with the file: unpack it, open PartsOnly.ssd, step."""
    if (refusal := libcosim_refusal()) is not None:
        pytest.skip(refusal)
    scene = load_scene("two_body_collision")
    with zipfile.ZipFile(build_ssp(scene)) as archive:
        archive.extractall(tmp_path)
    names = ["two_body_collision_q1", "two_body_collision_q2"]
    command = [sys.executable, "-c", SSP, str(tmp_path / "PartsOnly.ssd"), *names]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    line = next(line for line in done.stdout.splitlines() if line.startswith("RESULT"))
    with coupled(scene, scene.task.step / 100) as system:
        system.begin(np.array(scene.task.start), np.empty(0))
        last = jacobi(system, 1e-3, 600)[-1]
    np.testing.assert_allclose(np.array(json.loads(line[6:])).T.ravel(), last, rtol=1e-8)


@pytest.mark.slow
def test_a_study_without_libcosim_says_so(monkeypatch):
    """One macro step of the paper's carts: all masters of ours, the whole scene best, the missing one with a reason."""
    monkeypatch.setattr(studies, "libcosim_refusal", lambda: "libcosimpy is not installed")
    case = next(case for case in cases() if case.name == "three_cart")
    lines = []
    told = study(case, [1e-2], lines.append)
    by_name = {master["name"]: master for master in told["masters"]}
    assert set(by_name) == {*MASTERS, "whole", "libcosim", "libcosim_ecco"}
    assert by_name["libcosim"]["failed"] == "libcosimpy is not installed"
    errors = {
        name: abs(master["rows"][0]["energy_error"])
        for name, master in by_name.items()
        if master["rows"]
    }
    assert (
        errors["jacobi"]
        > errors["contact_first"]
        > errors["extrapolated"]
        > errors["iterated"]
        > 1e5 * errors["whole"]
    )
    assert all(
        master["rows"][0]["momentum_error"] < 1e-9 for master in by_name.values() if master["rows"]
    )
    assert len(lines) == 5

"""Tracking on an FMU of which nothing is known but its description: our own unstable pendulum as a stranger, and one that cannot be tracked."""

from pathlib import Path

import numpy as np
import pytest
from foreign_fmu import FULL_MAP, build_foreign, write_plan
from scipy.linalg import expm

from models.catalog import load_scene
from models.fmu import build_fmu
from validate.judge.judgement import wire_fmu
from validate.judge.replay.run import replay_foreign
from validate.judge.replay.tracking import TrackingError, linearised

STEPS = 50
H = 0.05
# Degrees and newton metres to what the FMU has: so that every scale and offset counts.
MAP = """
[inputs]
torque = { variable = "u", scale = -0.5, offset = 0.25 }
[positions]
angle = { variable = "theta", scale = 57.29577951308232, offset = 3.0 }
[velocities]
angle = { variable = "omega", scale = 57.29577951308232, column = "speed" }
[parameters]
w = 1e4
[start]
theta = "angle"
omega = "speed"
"""


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def fmu(request: pytest.FixtureRequest) -> Path:
    return build_fmu(load_scene("wall_pendulum"), version=request.param)


@pytest.mark.slow
def test_a_stranger_is_caught_in_its_own_units(fmu: Path, tmp_path: Path):
    """The plan says: upright from the second node on; it starts 0.1 rad away."""
    degrees = 57.29577951308232
    rows = [
        f"{H * node!r},{3.0 + (0.1 * degrees if node == 0 else 0.0)!r},0.0,0.5"
        for node in range(STEPS + 1)
    ]
    (tmp_path / "plan.csv").write_text(
        "t,angle,speed,torque\n" + "\n".join(rows) + "\n", encoding="utf-8"
    )
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    wired = wire_fmu(fmu, tmp_path / "plan.csv", map_path=tmp_path / "map.toml")
    found = replay_foreign(
        wired.foreign, wired.package, wired.plan, limits=wired.limits, track=True
    )
    tracked = found.tracked
    # theta'' = 10 theta + u with u = -0.5 torque + 0.25, in radians; 0.5 is the torque that holds.
    whole = expm(H * np.array([[0.0, 1.0, 0.0], [10.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    x = np.array([0.1, 0.0])
    states = [x]
    for step in range(STEPS):
        torque = tracked.applied[step, 0]
        told = np.array([3.0, 0.0]) - np.array([3.0, 0.0]) - degrees * x
        wanted = 0.5 + (tracked.feedback.gains[step] @ told)[0] if step else 0.5
        assert torque == pytest.approx(wanted, abs=1e-7)
        x = whole[:2, :2] @ x + whole[:2, 2] * (-0.5 * torque + 0.25)
        states.append(x)
    replayed = np.hstack([(tracked.q - 3.0), tracked.v])[tracked.knots] / degrees
    assert np.abs(replayed - states).max() < 1e-9
    assert np.linalg.norm(replayed[-1]) < 0.02
    assert abs(found.q[-1, 0] - 3.0) > 1000.0  # alone it falls
    assert found.growth.amplification > 1000.0


def test_an_fmu_is_linearised_as_it_is(fmu: Path, tmp_path: Path):
    """Exactly, for a linear FMU; with the wall's spring where the plan touches it."""
    states = np.array([[0.0, 0.8], [0.05, 0.5], [0.2, 0.1], [0.25, 0.0]])
    rows = [
        f"{H * node!r},{angle!r},{speed!r},0.0"
        for node, (angle, speed) in enumerate(states.tolist())
    ]
    (tmp_path / "plan.csv").write_text(
        "t,theta,omega,u\n" + "\n".join(rows) + "\n", encoding="utf-8"
    )
    wired = wire_fmu(fmu, tmp_path / "plan.csv")
    A, B = linearised(
        wired.package,
        wired.foreign.variables,
        wired.plan,
        wired.foreign.start,
        states,
        wired.limits,
    )
    for step, stiffness in enumerate((0.0, 50.0, 100.0)):  # the second step touches at its end only
        whole = expm(H * np.array([[0.0, 1.0, 0.0], [10.0 - stiffness, 0.0, 1.0], [0.0, 0.0, 0.0]]))
        assert A[step] == pytest.approx(whole[:2, :2], abs=1e-12)
        assert B[step, :, 0] == pytest.approx(whole[:2, 2], abs=1e-12)


def test_an_fmu_without_derivatives_is_refused_in_a_sentence(tmp_path: Path):
    (tmp_path / "map.toml").write_text(FULL_MAP, encoding="utf-8")
    wired = wire_fmu(
        build_foreign(tmp_path / "cart.fmu"),
        write_plan(tmp_path / "plan.csv"),
        map_path=tmp_path / "map.toml",
    )
    with pytest.raises(TrackingError, match="it provides no directional derivatives"):
        wired.judge(feedback=True)

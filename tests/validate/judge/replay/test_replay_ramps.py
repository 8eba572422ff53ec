"""A linear hold heads for the plan's last row in the last step: a double integrator under a ramp, against its closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from models.fmu import build_fmu
from models.scene import Coordinate, Input, Limit, Parameter, Scene, Task
from models.trajectory import Hold, Trajectory, read_csv, write_csv
from models.trajectory_netcdf import read_netcdf, write_netcdf
from validate.execution.isolated import Limits
from validate.judge.replay.run import replay
from validate.judge.replay.wiring import HeldInputs

MASS = 2.0
T = np.array([0.0, 0.1, 0.3, 0.5])


@pytest.fixture(scope="module")
def scene() -> Scene:
    q, v, u, m = sp.symbols("x v F m")
    return Scene(
        name="double_integrator",
        title="A free mass",
        source="closed form",
        coordinates=(Coordinate(symbol=q, velocity=v, unit="m"),),
        inputs=(Input(symbol=u, unit="N"),),
        parameters=(Parameter(symbol=m, value=MASS, unit="kg"),),
        kinetic_energy=m * v**2 / 2,
        potential_energy=sp.S.Zero,
        forces=(u,),
        contacts=(),
        task=Task(start=(0.2, -1.0), goal=(None, None), running_cost=u**2, step=0.1, steps=5),
        limits=(Limit(metric="cost", value=1e6, reason="any"),),
    )


def ramp(end: bool = True) -> Trajectory:
    """F = 3 - 10 t; without its end the last step is constant."""
    u = 3 - 10 * T
    empty = np.zeros((4, 1))
    return Trajectory(
        t=T, q=empty + 0.2, v=empty - 1.0, u=u[:-1, None], lam=np.zeros((3, 0)), hold=Hold.LINEAR, u_end=u[-1:] if end else None
    )


@pytest.mark.slow
@pytest.mark.parametrize("limits", [None, Limits(seconds=100.0)], ids=["here", "child"])
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_ramp_is_integrated_to_its_end(scene: Scene, limits: Limits | None, version: str):
    result = replay(scene, build_fmu(scene, version=version), ramp(), limits=limits, track=False)
    assert result.ok, result.message
    t = result.t
    assert result.q[:, 0] == pytest.approx(0.2 - t + (3 * t**2 / 2 - 10 * t**3 / 6) / MASS, abs=1e-11)
    assert result.v[:, 0] == pytest.approx(-1 + (3 * t - 5 * t**2) / MASS, abs=1e-11)
    assert result.error.everyday is not None
    assert result.error.everyday.position < 1e-6, "FMI 3.0 has stairs instead of the line: 2e-7; without the end it would be 7e-3"
    cut = replay(scene, build_fmu(scene, version=version), ramp(end=False), limits=limits, track=False)
    # The last 0.2 s hold 0 N instead of going on to -2 N.
    assert cut.v[-1, 0] - result.v[-1, 0] == pytest.approx(0.2 * 2.0 / 2 / MASS, abs=1e-11)


def test_slopes_end_at_the_last_row():
    held = HeldInputs(ramp())
    assert held.slopes[:, 0] == pytest.approx([-10.0, -10.0, -10.0])
    assert HeldInputs(ramp(end=False)).slopes[:, 0] == pytest.approx([-10.0, -10.0, 0.0])


def test_end_of_a_ramp_is_stored_with_the_plan(scene: Scene, tmp_path: Path):
    write_csv(tmp_path / "plan.csv", ramp(), scene)
    write_netcdf(tmp_path / "plan.nc", ramp(), scene)
    for plan in (read_csv(tmp_path / "plan.csv", scene), read_netcdf(tmp_path / "plan.nc", scene)):
        assert plan.u_end is not None
        assert (plan.hold, plan.u_end.tolist()) == (Hold.LINEAR, [-2.0])


def test_inputs_change_their_units_with_their_end():
    plan = ramp().with_inputs_in(np.array([0.001]), np.array([5.0]))
    assert plan.u_end == pytest.approx([4.998])
    assert plan.u[0] == pytest.approx([5.003])
